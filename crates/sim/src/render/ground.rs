//! What colour is the floor? Looks up each ray's ground point and footprint in textures of paint and light.

use std::ops::Range;

use localize::field::Field;
use localize::frames::Pose;

use super::cables::Cable;
use super::draw_list::linear;
use super::lanes::{LANES, Lanes};
use super::light_buffer::LightBuffer;
use super::markings::{
    FOOTPRINT_MIN, FULL_MARKING, MarkingTextures, NO_MARKING, Texture, index_of,
};
use super::moving_rays::{MovedRays, RANGE_MAX};
use super::rays::{SortedRays, Tile};
use crate::environment::EnvironmentConfig;
use crate::image_sensor::RUN_PIXELS;
use crate::light::LightConfig;

/// Most lookups along a stretched footprint.
const TAPS_MAX: usize = 6;
/// Most lookups of a run: small, so that many runs lie on bare carpet and are skipped.
const TAPS_PER_RUN: usize = 128;
/// Margin of the light texture around the carpet, metres.
const LIGHT_MARGIN: f32 = 4.0;
/// Cell of the light texture, metres: light changes slowly.
const LIGHT_CELL: f32 = 0.2;
/// Light is looked up for every fourth ray and interpolated in between: neighbours in a bin are a pixel apart.
const LIGHT_STRIDE: usize = 4;
/// Lookups of a run that are asked for their displacement.
const SHIFT_SAMPLES: usize = 8;
/// Light of byte 255.
const LIGHT_MAX: f32 = 2.5;
/// Width of a strip of carpet, metres, and contrast between strips.
const STRIP: f32 = 2.0;
const STRIP_CONTRAST: f32 = 0.025;

/// sRGB of carpet and paint under white light.
const CARPET: [u8; 3] = [72, 130, 88];
const MARKING_RGB: [u8; 3] = [226, 230, 226];
/// Linear light that a black cable returns.
const CABLE_LIGHT: f32 = 0.012;
/// Width and length of a plank of the floor around the carpet, metres.
const PLANK: [f32; 2] = [0.4, 2.4];

/// The floor under all rays of a table.
pub(super) struct Ground {
    /// Inverse of each footprint's side, 1/m; padded by `LANES`.
    sharpness: Vec<f32>,
    taps: Taps,
    markings: MarkingTextures,
    light: Texture,
    gloss: Option<Texture>,
    carpet_half: (f32, f32),
    /// sRGB of the floor around the carpet.
    floor_rgb: [u8; 3],
}

/// Lookups in the paint: one per ray, or several along an elongated footprint. They are grouped by tile, texture and
/// distance, so that a run of lookups reads a small part of one texture.
#[derive(Default)]
struct Taps {
    /// Position from the ray's ground point, robot frame.
    x: Vec<f32>,
    y: Vec<f32>,
    /// Index of the ray in its tile.
    ray: Vec<u32>,
    /// The lookups of each tile.
    tiles: Vec<Vec<TapRun>>,
}

/// Consecutive lookups in one texture for rays of one tile.
struct TapRun {
    start: usize,
    count: usize,
    level: usize,
    /// Weight of each lookup, over `FULL_MARKING`.
    weight: f32,
    bounds: OrientedBox,
    samples: ShiftSamples,
}

/// A box, robot frame: centre, unit vector along its first side, and half side lengths.
#[derive(Default)]
struct OrientedBox {
    centre: [f32; 2],
    axis: [f32; 2],
    half: [f32; 2],
}

impl OrientedBox {
    /// The box around all points whose first side points to their mean.
    fn enclosing(x: &[f32], y: &[f32]) -> Self {
        let (sum_x, sum_y) = (x.iter().sum::<f32>(), y.iter().sum::<f32>());
        let length = sum_x.hypot(sum_y).max(1e-9);
        let axis = [sum_x / length, sum_y / length];
        let (mut least, mut most) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (x, y) in x.iter().zip(y) {
            let at = [x * axis[0] + y * axis[1], y * axis[0] - x * axis[1]];
            for side in 0..2 {
                least[side] = least[side].min(at[side]);
                most[side] = most[side].max(at[side]);
            }
        }
        let [along, across] = [0, 1].map(|side| (least[side] + most[side]) / 2.0);
        OrientedBox {
            centre: [
                along * axis[0] - across * axis[1],
                along * axis[1] + across * axis[0],
            ],
            axis,
            half: [0, 1].map(|side| (most[side] - least[side]) / 2.0),
        }
    }

    /// True if a texture has markings somewhere in the box, for the robot at a pose. The points of the box are displaced
    /// by `shift` ± `spread`.
    fn overlaps_markings(
        &self,
        texture: &Texture,
        pose: Pose,
        (sin, cos): (f32, f32),
        (shift, spread): ([f32; 2], [f32; 2]),
    ) -> bool {
        let [x, y] = [0, 1].map(|k| self.centre[k] + shift[k]);
        let centre = [pose.x + cos * x - sin * y, pose.y + sin * x + cos * y];
        let along_x = (cos * self.axis[0] - sin * self.axis[1]).abs();
        let along_y = (sin * self.axis[0] + cos * self.axis[1]).abs();
        let spread = spread[0].hypot(spread[1]);
        let half = [
            self.half[0] * along_x + self.half[1] * along_y + spread,
            self.half[0] * along_y + self.half[1] * along_x + spread,
        ];
        texture.any_marking_within(centre, half)
    }
}

/// Some of a run's rays, by their index in the tile, and their ground points at rest. They lie together in memory, since
/// every run is asked in each image.
#[derive(Default)]
struct ShiftSamples {
    rays: [u32; SHIFT_SAMPLES],
    rest: [[f32; 2]; SHIFT_SAMPLES],
}

impl ShiftSamples {
    /// Samples of the lookups of a run; `rest_x`, `rest_y`: ground points of the tile's rays.
    fn new(rays: &[u32], [rest_x, rest_y]: [&[f32]; 2]) -> Self {
        let last = rays.len() - 1;
        let rays: [u32; SHIFT_SAMPLES] =
            std::array::from_fn(|sample| rays[sample * last / (SHIFT_SAMPLES - 1)]);
        let rest = rays.map(|ray| [rest_x[ray as usize], rest_y[ray as usize]]);
        ShiftSamples { rays, rest }
    }

    /// Middle and half range of the displacements of these rays; those of the run's other rays lie between them, or little
    /// outside.
    fn range(&self, [moved_x, moved_y]: [&[f32]; 2]) -> ([f32; 2], [f32; 2]) {
        let (mut least, mut most) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (ray, rest) in self.rays.iter().zip(&self.rest) {
            let at = [moved_x[*ray as usize], moved_y[*ray as usize]];
            for k in 0..2 {
                let shift = at[k] - rest[k];
                least[k] = least[k].min(shift);
                most[k] = most[k].max(shift);
            }
        }
        (
            [0, 1].map(|k| (least[k] + most[k]) / 2.0),
            [0, 1].map(|k| 0.75 * (most[k] - least[k]) + 0.01),
        )
    }
}

/// Short and long side of a footprint, metres, and the direction of the long one, robot frame.
struct Footprint {
    short: f32,
    long: f32,
    direction: (f32, f32),
}

impl Footprint {
    /// Number of lookups, and the side of the square of each.
    fn tap_layout(&self) -> (usize, f32) {
        // Up to 1.5 times as long as wide counts as square; no texture is finer than FOOTPRINT_MIN.
        let short = self.short.max(FOOTPRINT_MIN);
        let taps = ((self.long / short / 1.5).ceil() as usize).clamp(1, TAPS_MAX);
        (taps, short.max(self.long / taps as f32))
    }
}

impl Ground {
    pub(super) fn new(
        rays: &SortedRays,
        field: &Field,
        light: &LightConfig,
        (environment, cables): (&EnvironmentConfig, &[Cable]),
    ) -> Self {
        let count = rays.count();
        let footprints: Vec<Footprint> = (0..count).map(|ray| footprint(rays, ray)).collect();
        // The finest texture suits most of the image, not the few rays next to the robot.
        let mut short: Vec<f32> = footprints.iter().map(|footprint| footprint.short).collect();
        let finest = match short.len() / 4 {
            0 => 1.0,
            quarter => *short.select_nth_unstable_by(quarter, f32::total_cmp).1,
        };
        let paint = MarkingTextures::new(field, cables, finest);
        let (half_x, half_y) = field.carpet_half_extent();
        let byte = |value: f32| (value / LIGHT_MAX * 255.0).round().clamp(0.0, 255.0) as u8;
        let (light_x, light_y) = (half_x + LIGHT_MARGIN, half_y + LIGHT_MARGIN);
        // The field's own walls, if any, hide what is beyond the carpet.
        let albedo = |x: f32, y: f32| {
            if x.abs() < half_x && y.abs() < half_y {
                carpet_albedo(x, y)
            } else {
                plank_albedo(x, y, environment.plank_contrast)
            }
        };
        let lit = Texture::new(light_x, light_y, LIGHT_CELL, |x, y| {
            byte(light.spot_light_at(x, y).0 * albedo(x, y))
        });
        let glossy = light.spots.iter().any(|spot| spot.gloss > 0.0);
        let gloss = glossy.then(|| {
            Texture::new(light_x, light_y, LIGHT_CELL, |x, y| {
                byte(light.spot_light_at(x, y).1)
            })
        });
        // Ground point of each ray of the upright robot; at `RANGE_MAX` if it does not meet the ground.
        let (x, y): (Vec<f32>, Vec<f32>) = (0..count)
            .map(|ray| {
                let distance = distance_to_ground(rays, ray).min(RANGE_MAX);
                let (dx, dy) = (
                    distance * rays.direction_x[ray],
                    distance * rays.direction_y[ray],
                );
                (rays.origin_x[ray] + dx, rays.origin_y[ray] + dy)
            })
            .unzip();
        // No paint is farther from the robot than the carpet's diagonal.
        let range_max = 2.0 * half_x.hypot(half_y);
        let taps = Taps::new(rays, &footprints, &paint, &x, &y, range_max);
        let mut sharpness: Vec<f32> = footprints
            .iter()
            .map(|footprint| 1.0 / footprint.tap_layout().1)
            .collect();
        sharpness.extend([1.0; LANES]);
        Ground {
            taps,
            sharpness,
            markings: paint,
            light: lit,
            gloss,
            carpet_half: (half_x, half_y),
            floor_rgb: environment.floor_rgb,
        }
    }

    /// Writes the floor's light (linear, per colour) for the rays of tile number `index`.
    pub(super) fn shade(
        &self,
        pose: Pose,
        index: usize,
        tile: &Tile,
        moved: &MovedRays,
        scratch: &mut Scratch,
        light_buffer: &mut LightBuffer,
    ) {
        let sin_cos = pose.theta.sin_cos();
        let mut white = std::mem::take(&mut scratch.marking_coverage);
        white.clear();
        white.resize(tile.rays.len().next_multiple_of(LANES), 0.0);
        let ground = moved.ground(&tile.rays);
        for run in &self.taps.tiles[index] {
            let taps = run.start..run.start + run.count;
            // Skips bare carpet, which is most of a field.
            let texture = &self.markings.levels[run.level];
            let displaced = run.samples.range(ground);
            if !run
                .bounds
                .overlaps_markings(texture, pose, sin_cos, displaced)
            {
                continue;
            }
            let rays = &self.taps.ray[taps.clone()];
            let offsets = [&self.taps.x[taps.clone()], &self.taps.y[taps]];
            scratch.transform_taps(pose, sin_cos, offsets, rays, ground);
            scratch.sample_texture(texture);
            let bare = -run.weight * f32::from(NO_MARKING);
            for (ray, value) in rays.iter().zip(&scratch.values) {
                let white = &mut white[*ray as usize];
                *white += run.weight.mul_add(*value, bare);
            }
        }
        let mut start = tile.rays.start;
        for white in white.chunks(RUN_PIXELS) {
            let run = start..start + white.len();
            start = run.end;
            self.compose(pose, sin_cos, moved, (run, white), scratch, light_buffer);
        }
        scratch.marking_coverage = white;
    }

    /// Composes floor, carpet and paint under the light, on a multiple of `LANES` rays.
    fn compose(
        &self,
        pose: Pose,
        sin_cos: (f32, f32),
        moved: &MovedRays,
        (rays, white): (Range<usize>, &[f32]),
        scratch: &mut Scratch,
        light_buffer: &mut LightBuffer,
    ) {
        let (mut lit, mut gloss) = ([0.0; RUN_PIXELS], [0.0; RUN_PIXELS]);
        let [ground_x, ground_y] = moved.ground(&rays);
        scratch.transform_to_field(pose, sin_cos, ground_x, ground_y);
        let (x, y) = (scratch.x, scratch.y);
        scratch.keep_strided();
        scratch.sample_texture(&self.light);
        interpolate_strided(&scratch.values, &mut lit);
        if let Some(texture) = &self.gloss {
            scratch.sample_texture(texture);
            interpolate_strided(&scratch.values, &mut gloss);
        }
        let (half_x, half_y) = self.carpet_half;
        let [carpet, paint, floor] = [CARPET, MARKING_RGB, self.floor_rgb].map(linear);
        let sharpness = self.sharpness[rays.clone()].as_chunks::<LANES>().0;
        let white = white.as_chunks::<LANES>().0;
        let [x, y, lit, gloss] = [&x, &y, &lit, &gloss].map(|of| of.as_chunks::<LANES>().0);
        let [red, green, blue] = light_buffer.lanes(&rays);
        let light = red.iter_mut().zip(green).zip(blue);
        let places = x.iter().zip(y).zip(lit.iter().zip(gloss));
        let floors = places.zip(white.iter().zip(sharpness));
        for (((red, green), blue), (((x, y), (lit, gloss)), (white, sharpness))) in
            light.zip(floors)
        {
            let mut floor_light: [Lanes; 3] = [[0.0; LANES]; 3];
            for i in 0..LANES {
                let inside_x = (half_x - x[i].abs()).mul_add(sharpness[i], 0.5);
                let inside_y = (half_y - y[i].abs()).mul_add(sharpness[i], 0.5);
                let inside = inside_x.clamp(0.0, 1.0) * inside_y.clamp(0.0, 1.0);
                // Negative coverage is a cable's.
                let (painted, covered) = (white[i].max(0.0), white[i].min(0.0));
                let bright = (LIGHT_MAX / 255.0) * lit[i];
                let shine = (LIGHT_MAX / 255.0) * gloss[i];
                for k in 0..3 {
                    let (carpet, paint, floor) = (carpet[k], paint[k], floor[k]);
                    let cable = covered.mul_add(carpet - CABLE_LIGHT, carpet - floor);
                    let on_carpet = painted.mul_add(paint - carpet, cable);
                    floor_light[k][i] = bright.mul_add(inside.mul_add(on_carpet, floor), shine);
                }
            }
            [*red, *green, *blue] = floor_light;
        }
    }
}

impl Taps {
    fn new(
        rays: &SortedRays,
        footprints: &[Footprint],
        paint: &MarkingTextures,
        x: &[f32],
        y: &[f32],
        range_max: f32,
    ) -> Self {
        let mut taps = Taps::default();
        for tile in &rays.tiles {
            // Sorted by distance (the bits of a positive float have its order), so that runs are compact.
            let mut sorted: Vec<(usize, usize, u32, usize)> = tile
                .rays
                .clone()
                .map(|ray| (x[ray].hypot(y[ray]), ray))
                .filter(|&(distance, _)| distance < range_max)
                .map(|(distance, ray)| {
                    let (count, side) = footprints[ray].tap_layout();
                    (paint.level(side), count, distance.to_bits(), ray)
                })
                .collect();
            sorted.sort_unstable();
            let mut runs: Vec<TapRun> = Vec::new();
            let (first, mut at_x, mut at_y) = (taps.x.len(), Vec::new(), Vec::new());
            for (level, count, _, ray) in sorted {
                let Footprint {
                    long,
                    direction: towards,
                    ..
                } = footprints[ray];
                for tap in 0..count {
                    let along = ((tap as f32 + 0.5) / count as f32 - 0.5) * long;
                    append_tap(
                        &mut runs,
                        taps.x.len(),
                        level,
                        1.0 / (FULL_MARKING * count as f32),
                    );
                    taps.x.push(along * towards.0);
                    taps.y.push(along * towards.1);
                    at_x.push(x[ray] + along * towards.0);
                    at_y.push(y[ray] + along * towards.1);
                    taps.ray.push((ray - tile.rays.start) as u32);
                }
            }
            for run in &mut runs {
                let rest = [x, y].map(|of| &of[tile.rays.clone()]);
                let rays = &taps.ray[run.start..run.start + run.count];
                run.samples = ShiftSamples::new(rays, rest);
                let within = run.start - first..run.start + run.count - first;
                run.bounds = OrientedBox::enclosing(&at_x[within.clone()], &at_y[within]);
            }
            taps.tiles.push(runs);
        }
        taps
    }
}

/// Extends the last run by the lookup `next`, or starts another.
fn append_tap(runs: &mut Vec<TapRun>, next: usize, level: usize, weight: f32) {
    match runs.last_mut() {
        Some(run) if (run.level, run.weight) == (level, weight) && run.count < TAPS_PER_RUN => {
            run.count += 1
        }
        _ => runs.push(TapRun {
            start: next,
            count: 1,
            level,
            weight,
            bounds: OrientedBox::default(),
            samples: ShiftSamples::default(),
        }),
    }
}

/// Buffers of a run of lookups.
pub(super) struct Scratch {
    count: usize,
    /// Coverage by white paint of each ray of a tile.
    marking_coverage: Vec<f32>,
    /// Field coordinates, metres.
    x: [f32; RUN_PIXELS],
    y: [f32; RUN_PIXELS],
    /// Values there, 0 to 255.
    values: [f32; RUN_PIXELS],
    fraction_x: [f32; RUN_PIXELS],
    fraction_y: [f32; RUN_PIXELS],
    cell: [u32; RUN_PIXELS],
}

/// Interpolates linearly between values of every `LIGHT_STRIDE`th ray of a run.
fn interpolate_strided(few: &[f32; RUN_PIXELS], all: &mut [f32; RUN_PIXELS]) {
    for (group, pair) in all.chunks_exact_mut(LIGHT_STRIDE).zip(few.windows(2)) {
        for (step, value) in group.iter_mut().enumerate() {
            let part = step as f32 / LIGHT_STRIDE as f32;
            *value = part.mul_add(pair[1] - pair[0], pair[0]);
        }
    }
}

impl Scratch {
    pub(super) fn new() -> Self {
        let zero = [0.0; RUN_PIXELS];
        Scratch {
            count: 0,
            marking_coverage: Vec::new(),
            x: zero,
            y: zero,
            values: zero,
            fraction_x: zero,
            fraction_y: zero,
            cell: [0; RUN_PIXELS],
        }
    }

    /// Transforms points of the robot frame to the field frame.
    fn transform_to_field(&mut self, pose: Pose, (sin, cos): (f32, f32), x: &[f32], y: &[f32]) {
        self.count = x.len().min(y.len()).min(RUN_PIXELS);
        let count = self.count;
        let (x, y) = (&x[..count], &y[..count]);
        let (out_x, out_y) = (&mut self.x[..count], &mut self.y[..count]);
        for i in 0..count {
            out_x[i] = cos.mul_add(x[i], (-sin).mul_add(y[i], pose.x));
            out_y[i] = sin.mul_add(x[i], cos.mul_add(y[i], pose.y));
        }
    }

    /// As `transform_to_field`, for points given from their rays' ground points.
    fn transform_taps(
        &mut self,
        pose: Pose,
        (sin, cos): (f32, f32),
        [x, y]: [&[f32]; 2],
        rays: &[u32],
        [ground_x, ground_y]: [&[f32]; 2],
    ) {
        self.count = rays.len().min(RUN_PIXELS);
        let count = self.count;
        let (x, y, rays) = (&x[..count], &y[..count], &rays[..count]);
        let ground_y = &ground_y[..ground_x.len()];
        let (out_x, out_y) = (&mut self.x[..count], &mut self.y[..count]);
        // Lookups first, so that the arithmetic vectorises.
        for i in 0..count {
            let ray = rays[i] as usize;
            (out_x[i], out_y[i]) = (ground_x[ray], ground_y[ray]);
        }
        for i in 0..count {
            let (x, y) = (x[i] + out_x[i], y[i] + out_y[i]);
            out_x[i] = cos.mul_add(x, (-sin).mul_add(y, pose.x));
            out_y[i] = sin.mul_add(x, cos.mul_add(y, pose.y));
        }
    }

    /// Keeps every `LIGHT_STRIDE`th point, and the last one.
    fn keep_strided(&mut self) {
        let last = self.count - 1;
        let count = last / LIGHT_STRIDE + 2;
        for number in 0..count - 1 {
            let point = number * LIGHT_STRIDE;
            (self.x[number], self.y[number]) = (self.x[point], self.y[point]);
        }
        (self.x[count - 1], self.y[count - 1]) = (self.x[last], self.y[last]);
        self.count = count;
    }

    /// Bilinear values at the points; the texture's border extends outside.
    fn sample_texture(&mut self, texture: &Texture) {
        // Adding 1.5·2²³ leaves the rounded value in the lowest bits: a floor that vectorises.
        const ROUND: f32 = 12_582_912.0;
        const BITS: u32 = 0x3f_ffff;
        let count = self.count.min(RUN_PIXELS);
        let (most_x, most_y) = ((texture.columns - 1) as f32, (texture.rows - 1) as f32);
        let blocks = texture.blocks();
        let per_metre = texture.per_metre;
        let (left, bottom) = (-texture.left * per_metre, -texture.bottom * per_metre);
        for i in 0..count {
            let across = self.x[i].mul_add(per_metre, left).clamp(0.0, most_x);
            let up = self.y[i].mul_add(per_metre, bottom).clamp(0.0, most_y);
            let (column, row) = (across - 0.5 + ROUND, up - 0.5 + ROUND);
            self.fraction_x[i] = across - (column - ROUND);
            self.fraction_y[i] = up - (row - ROUND);
            self.cell[i] = index_of(column.to_bits() & BITS, row.to_bits() & BITS, blocks);
        }
        let cells = &texture.cells[..];
        for cell in &mut self.cell[..count] {
            *cell = cells[*cell as usize];
        }
        let out = &mut self.values;
        let parts = self.fraction_x.iter().zip(&self.fraction_y).zip(&self.cell);
        for (out, ((part_x, part_y), cell)) in out[..count].iter_mut().zip(parts) {
            let corner = |shift: u32| ((cell >> shift) & 255) as i32 as f32;
            let low = part_x.mul_add(corner(8) - corner(0), corner(0));
            let high = part_x.mul_add(corner(24) - corner(16), corner(16));
            *out = part_y.mul_add(high - low, low);
        }
    }
}

/// Horizontal distance of a ray's ground point, metres; infinite if it does not meet the ground.
fn distance_to_ground(rays: &SortedRays, ray: usize) -> f32 {
    let slope = rays.slope[ray];
    if slope < 0.0 {
        rays.origin_z[ray] / -slope
    } else {
        f32::INFINITY
    }
}

fn footprint(rays: &SortedRays, ray: usize) -> Footprint {
    let distance = distance_to_ground(rays, ray).min(RANGE_MAX);
    let steep = rays.origin_z[ray] / distance;
    let across = distance * rays.azimuth_spacing[ray];
    let along = rays.origin_z[ray] / (steep * steep) * rays.slope_spacing[ray];
    // Both spacings are root sum squares over rows and columns.
    let (towards_x, towards_y) = (rays.direction_x[ray], rays.direction_y[ray]);
    let along = along.min(RANGE_MAX);
    if along >= across {
        Footprint {
            short: across.max(1e-4),
            long: along,
            direction: (towards_x, towards_y),
        }
    } else {
        Footprint {
            short: along.max(1e-4),
            long: across,
            direction: (-towards_y, towards_x),
        }
    }
}

/// Relative brightness of a wooden floor, plank by plank.
fn plank_albedo(x: f32, y: f32, contrast: f32) -> f32 {
    let row = (y / PLANK[0]).floor();
    // Planks of neighbouring rows are staggered.
    let column = (x / PLANK[1] + 0.37 * row).floor();
    let hash = (row * 12.9898 + column * 78.233).sin() * 43_758.547;
    1.0 + contrast * (2.0 * (hash - hash.floor()) - 1.0)
}

/// Relative brightness of the carpet: strips and slow variations.
fn carpet_albedo(x: f32, y: f32) -> f32 {
    let strip = if (y / STRIP).floor() as i32 % 2 == 0 {
        1.0
    } else {
        -1.0
    };
    let stains = (1.7 * x + 0.6 * (2.3 * y).sin()).sin() * (1.3 * y + 0.8 * (1.1 * x).cos()).sin();
    1.0 + STRIP_CONTRAST * strip + 0.03 * stains
}
