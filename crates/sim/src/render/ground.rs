//! What colour is the floor? Each ray's ground point and footprint, looked up in the paint and the light.

use localize::field::Field;
use localize::frame::Pose;

use super::paint::{LEVEL_STEP, Paint, Texture};
use super::rays::Rays;
use crate::film::{RUN, decode};
use crate::light::LightConfig;

/// Farthest ground point that is told apart, metres: beyond any hall.
const FARTHEST: f32 = 60.0;
/// Most lookups along a stretched footprint.
const MOST_SAMPLES: usize = 8;
/// A run of rays keeps its level until the footprint differs by this part of a level's step.
const LEVEL_KEEPS: f32 = 0.75;
/// Cell of the light's texture, metres: light changes slowly.
const LIGHT_CELL: f32 = 0.2;
/// Light that the brightest byte stands for.
const BRIGHTEST: f32 = 2.5;
/// Width of a strip of carpet, metres, and how much strips differ.
const STRIP: f32 = 2.0;
const STRIP_CONTRAST: f32 = 0.025;

/// sRGB of carpet, paint and the hall's floor under white light.
const CARPET: [u8; 3] = [58, 122, 74];
const PAINT: [u8; 3] = [222, 228, 222];
const FLOOR: [u8; 3] = [128, 119, 112];

/// The floor under all rays of a table.
pub(super) struct Ground {
    /// Where each ray meets the ground, robot frame; `FARTHEST` away where it does not.
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    /// The long way across each footprint, robot frame, metres.
    long_x: Vec<f32>,
    long_y: Vec<f32>,
    runs: Vec<Run>,
    paint: Paint,
    light: Texture,
    gloss: Option<Texture>,
    carpet_half: (f32, f32),
}

/// Rays next to each other with footprints alike.
struct Run {
    start: usize,
    count: usize,
    level: usize,
    samples: usize,
    /// One over the footprint, 1/metres.
    sharpness: f32,
}

/// The short and the long side of a footprint, and the direction of the long one.
struct Footprint {
    short: f32,
    long: f32,
    towards: (f32, f32),
}

impl Ground {
    pub(super) fn new(rays: &Rays, field: &Field, light: &LightConfig, blur_px: f32) -> Self {
        let count = rays.count();
        let footprints: Vec<Footprint> = (0..count)
            .map(|ray| footprint(rays, ray, blur_px))
            .collect();
        // The finest texture serves the bulk of the image, not the few rays at its very centre.
        let mut short: Vec<f32> = footprints.iter().map(|footprint| footprint.short).collect();
        let tenth = short.len() / 10;
        let finest = if short.is_empty() {
            1.0
        } else {
            *short.select_nth_unstable_by(tenth, f32::total_cmp).1
        };
        let paint = Paint::new(field, finest);
        let runs = runs(&footprints, &paint);
        let (half_x, half_y) = field.carpet_half_extent();
        let byte = |value: f32| (value / BRIGHTEST * 255.0).round().clamp(0.0, 255.0) as u8;
        let (light_x, light_y) = (half_x + 4.0, half_y + 4.0);
        let lit = Texture::new(light_x, light_y, LIGHT_CELL, |column, row, texture| {
            let (x, y) = texture.point(column, row);
            byte(light.at(x, y).0 * weave(x, y))
        });
        let gloss = light.spots.iter().any(|spot| spot.gloss > 0.0).then(|| {
            Texture::new(light_x, light_y, LIGHT_CELL, |column, row, texture| {
                let (x, y) = texture.point(column, row);
                byte(light.at(x, y).1)
            })
        });
        let mut ground = Ground {
            x: vec![0.0; count],
            y: vec![0.0; count],
            long_x: footprints
                .iter()
                .map(|footprint| footprint.long * footprint.towards.0)
                .collect(),
            long_y: footprints
                .iter()
                .map(|footprint| footprint.long * footprint.towards.1)
                .collect(),
            runs,
            paint,
            light: lit,
            gloss,
            carpet_half: (half_x, half_y),
        };
        for ray in 0..count {
            let way = way_to_ground(rays, ray).min(FARTHEST);
            ground.x[ray] = rays.origin_x[ray] + way * rays.towards_x[ray];
            ground.y[ray] = rays.origin_y[ray] + way * rays.towards_y[ray];
        }
        ground
    }

    /// Writes the floor's light (linear, per colour) for every ray.
    pub(super) fn shade(&self, pose: Pose, light: &mut [Vec<f32>; 3]) {
        let [carpet, paint, floor] = [CARPET, PAINT, FLOOR].map(|colour| colour.map(decode));
        let (sin, cos) = pose.theta.sin_cos();
        let mut buffers = Buffers::default();
        let Buffers {
            x,
            y,
            at_x,
            at_y,
            white,
            part,
            lit,
            gloss,
        } = &mut buffers;
        for run in &self.runs {
            let rays = run.start..run.start + run.count;
            let count = run.count.min(RUN);
            let (ground_x, ground_y) = (&self.x[rays.clone()], &self.y[rays.clone()]);
            for i in 0..count {
                x[i] = pose.x + cos * ground_x[i] - sin * ground_y[i];
                y[i] = pose.y + sin * ground_x[i] + cos * ground_y[i];
            }
            let texture = &self.paint.levels[run.level];
            if run.samples == 1 {
                look_up(texture, &x[..count], &y[..count], white);
            } else {
                white[..count].fill(0.0);
                let (long_x, long_y) = (&self.long_x[rays.clone()], &self.long_y[rays.clone()]);
                let share = 1.0 / run.samples as f32;
                for sample in 0..run.samples {
                    let along = (sample as f32 + 0.5) * share - 0.5;
                    for i in 0..count {
                        at_x[i] = x[i] + along * (cos * long_x[i] - sin * long_y[i]);
                        at_y[i] = y[i] + along * (sin * long_x[i] + cos * long_y[i]);
                    }
                    look_up(texture, &at_x[..count], &at_y[..count], part);
                    for i in 0..count {
                        white[i] += share * part[i];
                    }
                }
            }
            look_up(&self.light, &x[..count], &y[..count], lit);
            match &self.gloss {
                Some(texture) => look_up(texture, &x[..count], &y[..count], gloss),
                None => gloss[..count].fill(0.0),
            }
            let (half_x, half_y) = self.carpet_half;
            for i in 0..count {
                let inside_x = ((half_x - x[i].abs()) * run.sharpness + 0.5).clamp(0.0, 1.0);
                let inside_y = ((half_y - y[i].abs()) * run.sharpness + 0.5).clamp(0.0, 1.0);
                part[i] = inside_x * inside_y;
            }
            for colour in 0..3 {
                let out = &mut light[colour][rays.clone()];
                let (carpet, paint, floor) = (carpet[colour], paint[colour], floor[colour]);
                for i in 0..count {
                    let on_carpet = carpet + white[i] * (1.0 / 255.0) * (paint - carpet);
                    let albedo = floor + part[i] * (on_carpet - floor);
                    out[i] = (BRIGHTEST / 255.0) * (lit[i] * albedo + gloss[i]);
                }
            }
        }
    }
}

struct Buffers {
    x: [f32; RUN],
    y: [f32; RUN],
    at_x: [f32; RUN],
    at_y: [f32; RUN],
    white: [f32; RUN],
    part: [f32; RUN],
    lit: [f32; RUN],
    gloss: [f32; RUN],
}

impl Default for Buffers {
    fn default() -> Self {
        let zero = [0.0; RUN];
        Buffers {
            x: zero,
            y: zero,
            at_x: zero,
            at_y: zero,
            white: zero,
            part: zero,
            lit: zero,
            gloss: zero,
        }
    }
}

/// Bilinear values (0 to 255) at field points; beyond the texture its border goes on.
fn look_up(texture: &Texture, x: &[f32], y: &[f32], out: &mut [f32; RUN]) {
    // Adding 1.5·2²³ leaves the rounded number in the lowest bits: a floor that vectorises.
    const ROUND: f32 = 12_582_912.0;
    const BITS: u32 = 0x3f_ffff;
    let count = x.len().min(RUN);
    let (most_x, most_y) = ((texture.columns - 1) as f32, (texture.rows - 1) as f32);
    let columns = texture.columns as u32;
    let (mut index, mut cell) = ([0u32; RUN], [0u32; RUN]);
    let (mut part_x, mut part_y) = ([0f32; RUN], [0f32; RUN]);
    for i in 0..count {
        let across = ((x[i] - texture.left) * texture.per_metre)
            .max(0.0)
            .min(most_x);
        let up = ((y[i] - texture.bottom) * texture.per_metre)
            .max(0.0)
            .min(most_y);
        let (column, row) = (across - 0.5 + ROUND, up - 0.5 + ROUND);
        part_x[i] = across - (column - ROUND);
        part_y[i] = up - (row - ROUND);
        index[i] = (row.to_bits() & BITS) * columns + (column.to_bits() & BITS);
    }
    for i in 0..count {
        cell[i] = texture.cells[index[i] as usize];
    }
    for i in 0..count {
        let corner = |shift: u32| ((cell[i] >> shift) & 255) as i32 as f32;
        let low = corner(0) + part_x[i] * (corner(8) - corner(0));
        let high = corner(16) + part_x[i] * (corner(24) - corner(16));
        out[i] = low + part_y[i] * (high - low);
    }
}

/// Horizontal way of a ray to the ground, metres; endless where it never comes down.
fn way_to_ground(rays: &Rays, ray: usize) -> f32 {
    let slope = rays.slope[ray];
    if slope < 0.0 {
        rays.origin_z[ray] / -slope
    } else {
        f32::INFINITY
    }
}

fn footprint(rays: &Rays, ray: usize, blur_px: f32) -> Footprint {
    let way = way_to_ground(rays, ray).min(FARTHEST);
    let steep = rays.origin_z[ray] / way;
    let across = way * rays.spacing[ray] * blur_px;
    let along = rays.origin_z[ray] / (steep * steep) * rays.slope_spacing[ray] * blur_px;
    // The spacing's root of two squares counts a diagonal step: both ways are equally far off.
    let (towards_x, towards_y) = (rays.towards_x[ray], rays.towards_y[ray]);
    let along = along.min(FARTHEST);
    if along >= across {
        Footprint {
            short: across.max(1e-4),
            long: along,
            towards: (towards_x, towards_y),
        }
    } else {
        Footprint {
            short: along.max(1e-4),
            long: across,
            towards: (-towards_y, towards_x),
        }
    }
}

/// Cuts the rays into runs of one level and number of lookups.
fn runs(footprints: &[Footprint], paint: &Paint) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    let mut width = f32::NAN;
    for (ray, footprint) in footprints.iter().enumerate() {
        let samples =
            ((footprint.long / footprint.short - 0.3).ceil() as usize).clamp(1, MOST_SAMPLES);
        let wanted = footprint.short.max(footprint.long / samples as f32);
        if let Some(run) = runs.last_mut() {
            let near = (wanted / width).log(LEVEL_STEP).abs() < LEVEL_KEEPS;
            let enough = samples <= run.samples && run.samples <= 2 * samples;
            if near && enough && run.count < RUN {
                run.count += 1;
                continue;
            }
        }
        width = wanted;
        runs.push(Run {
            start: ray,
            count: 1,
            level: paint.level(wanted),
            samples,
            sharpness: 1.0 / wanted,
        });
    }
    runs
}

/// Light and dark of the carpet itself: strips, and slow stains.
fn weave(x: f32, y: f32) -> f32 {
    let strip = if (y / STRIP).floor() as i32 % 2 == 0 {
        1.0
    } else {
        -1.0
    };
    let stains = (1.7 * x + 0.6 * (2.3 * y).sin()).sin() * (1.3 * y + 0.8 * (1.1 * x).cos()).sin();
    1.0 + STRIP_CONTRAST * strip + 0.03 * stains
}
