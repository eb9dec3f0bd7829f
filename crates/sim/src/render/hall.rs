//! What is around the field? A hall with walls, panels and doors, and clutter that stands about.

use std::f32::consts::TAU;

use localize::field::Field;
use localize::frame::Pose;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::rays::Rays;
use super::solids::{Outline, Solid};
use crate::film::decode;

/// Room between carpet and walls, metres.
const MARGIN: f32 = 3.0;
/// Cell of the walls' picture, metres, and how high it goes.
const CELL: f32 = 0.05;
const HEIGHT: f32 = 4.0;
/// Height of a field's own walls (the league's fields until 2001), metres.
const FIELD_WALL: f32 = 0.5;
/// Things that stand between carpet and walls.
const THINGS: usize = 26;

/// The hall, field frame.
pub(super) struct Hall {
    half: [f32; 2],
    /// Linear colours: columns along the walls from the corner (+x, −y) counter-clockwise, rows upwards.
    picture: Vec<[f32; 3]>,
    columns: usize,
    rows: usize,
    /// Half extent of a field's own walls.
    field_walls: Option<[f32; 2]>,
    /// What stands about; places and directions in the field frame.
    pub(super) things: Vec<Solid>,
}

impl Hall {
    pub(super) fn new(field: &Field, rng: &mut ChaCha8Rng) -> Self {
        let (carpet_x, carpet_y) = field.carpet_half_extent();
        let half = [carpet_x + MARGIN, carpet_y + MARGIN];
        let columns = (4.0 * (half[0] + half[1]) / CELL).ceil() as usize;
        let rows = (HEIGHT / CELL) as usize;
        let mut hall = Hall {
            half,
            picture: Vec::new(),
            columns,
            rows,
            field_walls: field.config.walls.then_some([carpet_x, carpet_y]),
            things: things([carpet_x, carpet_y], rng),
        };
        hall.paint(rng);
        hall
    }

    /// Plain plaster over a darker skirting, with panels, doors and posters of any colour.
    fn paint(&mut self, rng: &mut ChaCha8Rng) {
        let (columns, rows) = (self.columns, self.rows);
        let plaster = [196, 192, 182].map(decode);
        let skirting = [150, 155, 168].map(decode);
        self.picture = (0..columns * rows)
            .map(|index| {
                if (index / columns) as f32 * CELL < 0.9 {
                    skirting
                } else {
                    plaster
                }
            })
            .collect();
        let panels = (columns as f32 * CELL / 1.4) as usize;
        for _ in 0..panels {
            let colour = clutter_colour(rng).map(|part| part * 0.8 + 0.02);
            let left = (rng.random::<f32>() * columns as f32) as usize;
            let width = ((0.3 + 1.2 * rng.random::<f32>()) / CELL) as usize;
            let low = ((rng.random::<f32>() * 1.2) / CELL) as usize;
            let high = (low + ((0.4 + rng.random::<f32>()) / CELL) as usize).min(rows);
            for row in low..high {
                for column in left..left + width {
                    self.picture[row * columns + column % columns] = colour;
                }
            }
        }
    }

    /// Draws the walls over every ray that meets them above the floor.
    pub(super) fn shade(&self, pose: Pose, rays: &Rays, light: &mut [Vec<f32>; 3]) {
        let (sin, cos) = pose.theta.sin_cos();
        let walls = self.field_walls.unwrap_or(self.half);
        // No wall is nearer than this: rays that reach the floor before need no look.
        let near = (walls[0] - pose.x.abs())
            .min(walls[1] - pose.y.abs())
            .max(0.3);
        let steepest = -1.1 / (near - 0.2).max(0.1);
        for bin in rays.bins() {
            let first =
                bin.start + rays.slope[bin.clone()].partition_point(|&slope| slope < steepest);
            for ray in first..bin.end {
                let (ox, oy) = (rays.origin_x[ray], rays.origin_y[ray]);
                let from = [pose.x + cos * ox - sin * oy, pose.y + sin * ox + cos * oy];
                let (tx, ty) = (rays.towards_x[ray], rays.towards_y[ray]);
                let towards = [cos * tx - sin * ty, sin * tx + cos * ty];
                let (height, slope) = (rays.origin_z[ray], rays.slope[ray]);
                if let Some(half) = self.field_walls {
                    let way = way_out(from, towards, half);
                    let z = height + slope * way;
                    let width = way * rays.slope_spacing[ray] + 1e-3;
                    let covered = (z / width + 0.5).clamp(0.0, 1.0)
                        * ((FIELD_WALL - z) / width + 0.5).clamp(0.0, 1.0);
                    if covered >= 1.0 {
                        mix(light, ray, 1.0, [0.62, 0.63, 0.62]);
                        continue;
                    }
                    if z > 0.0 {
                        self.wall(from, towards, height, slope, rays, ray, light);
                    }
                    mix(light, ray, covered, [0.62, 0.63, 0.62]);
                } else {
                    self.wall(from, towards, height, slope, rays, ray, light);
                }
            }
        }
    }

    #[expect(clippy::too_many_arguments, reason = "a ray's numbers, in a hot loop")]
    fn wall(
        &self,
        from: [f32; 2],
        towards: [f32; 2],
        height: f32,
        slope: f32,
        rays: &Rays,
        ray: usize,
        light: &mut [Vec<f32>; 3],
    ) {
        let way = way_out(from, towards, self.half);
        let z = height + slope * way;
        let width = way * rays.slope_spacing[ray] + 1e-3;
        let covered = (z / width + 0.5).clamp(0.0, 1.0);
        if covered <= 0.0 {
            return;
        }
        let at = [from[0] + way * towards[0], from[1] + way * towards[1]];
        let [hx, hy] = self.half;
        // Along the walls, counter-clockwise from the corner (+x, −y).
        let along = if at[0] > hx - 1e-2 {
            at[1] + hy
        } else if at[1] > hy - 1e-2 {
            2.0 * hy + hx - at[0]
        } else if at[0] < -hx + 1e-2 {
            2.0 * hy + 2.0 * hx + hy - at[1]
        } else {
            4.0 * hy + 2.0 * hx + at[0] + hx
        };
        let column = ((along / CELL) as usize).min(self.columns - 1);
        let row = ((z.max(0.0) / CELL) as usize).min(self.rows - 1);
        mix(
            light,
            ray,
            covered,
            self.picture[row * self.columns + column],
        );
    }
}

fn mix(light: &mut [Vec<f32>; 3], ray: usize, part: f32, colour: [f32; 3]) {
    for (plane, colour) in light.iter_mut().zip(colour) {
        plane[ray] += part * (colour - plane[ray]);
    }
}

/// Horizontal way from inside a box of ± half to its walls.
fn way_out(from: [f32; 2], towards: [f32; 2], half: [f32; 2]) -> f32 {
    let axis = |axis: usize| {
        let rate = towards[axis];
        let room = half[axis].copysign(rate) - from[axis];
        room / if rate.abs() < 1e-6 {
            1e-6f32.copysign(rate)
        } else {
            rate
        }
    };
    axis(0).min(axis(1)).max(1e-3)
}

/// People, boxes and poles between carpet and walls.
fn things(carpet: [f32; 2], rng: &mut ChaCha8Rng) -> Vec<Solid> {
    let mut things = Vec::new();
    for _ in 0..THINGS {
        let out = 0.5 + (MARGIN - 1.0) * rng.random::<f32>();
        let part = 2.2 * rng.random::<f32>() - 1.1;
        let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
        let (x, y) = if rng.random::<f32>() < carpet[0] / (carpet[0] + carpet[1]) {
            (carpet[0] * part, side * (carpet[1] + out))
        } else {
            (side * (carpet[0] + out), carpet[1] * part)
        };
        let colour = clutter_colour(rng);
        let mut stack = |bottom: f32, top: f32, outline: Outline, colour: [f32; 3]| {
            things.push(Solid {
                x,
                y,
                bottom,
                top,
                outline,
                side: colour,
                cap: colour,
            });
        };
        let round = |radius: f32| Outline::Circle { radius };
        match rng.random_range(0..4) {
            0 => {
                stack(0.0, 0.85, round(0.14), [40, 42, 58].map(decode));
                stack(0.85, 1.5, round(0.2), colour);
                stack(1.5, 1.75, round(0.1), [190, 150, 125].map(decode));
            }
            1 => stack(0.0, 1.5 + rng.random::<f32>(), round(0.05), colour),
            _ => {
                let (sin, cos) = (rng.random::<f32>() * TAU).sin_cos();
                let half = [
                    0.15 + 0.4 * rng.random::<f32>(),
                    0.1 + 0.3 * rng.random::<f32>(),
                ];
                stack(
                    0.0,
                    0.3 + 0.8 * rng.random::<f32>(),
                    Outline::Box { half, cos, sin },
                    colour,
                );
            }
        }
    }
    things
}

/// Any colour: mostly greys, some as bright as a ball or a marker.
fn clutter_colour(rng: &mut ChaCha8Rng) -> [f32; 3] {
    const BRIGHT: [[u8; 3]; 7] = [
        [200, 50, 45],
        [40, 80, 190],
        [225, 190, 40],
        [30, 140, 75],
        [230, 120, 40],
        [235, 235, 230],
        [40, 150, 190],
    ];
    if rng.random::<f32>() < 0.5 {
        let grey = 0.03 + 0.5 * rng.random::<f32>();
        return [grey, grey, grey * 1.05];
    }
    BRIGHT[rng.random_range(0..BRIGHT.len())].map(decode)
}
