//! What is around the field? A environment with walls, panels and doors, and clutter.

use std::f32::consts::TAU;
use std::ops::Range;

use localize::field::Field;
use localize::frames::Pose;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::lanes::{LANES, RayLanes};
use super::light_buffer::LightBuffer;
use super::moving_rays::MovedRays;
use super::rays::{BIN_SPREAD, SortedRays, Tile};
use super::row_transform::RowTransform;
use super::solids::{Outline, Solid, edge_coverage};
use crate::environment::EnvironmentConfig;
use crate::image_sensor::{linear_from_srgb, srgb_from_linear};

/// Distance between carpet and walls, metres.
const MARGIN: f32 = 3.0;
/// Cell size and height of the walls' texture, metres.
const CELL: f32 = 0.08;
const HEIGHT: f32 = 4.0;
/// Height of the darker skirting along the walls, metres.
const SKIRTING: f32 = 0.4;
/// Height of a field's own walls (the league's fields until 2001), metres.
const FIELD_WALL: f32 = 0.5;
/// Their sRGB colour.
const FIELD_WALL_RGB: [u8; 3] = [206, 208, 205];
/// Number of objects between carpet and walls.
const CLUTTER_COUNT: usize = 26;

/// Width of a window, and heights of its lower and upper edge, metres.
const WINDOW: [f32; 3] = [2.2, 0.9, 3.4];
/// Its colour, bluish as the sky; the last byte marks it.
const WINDOW_RGB: [u8; 4] = [235, 245, 255, 1];

/// Hall and clutter, field frame.
pub(super) struct Environment {
    half: [f32; 2],
    /// sRGB colours, and 1 where there is a window: columns along the walls from the corner (+x, −y) counter-clockwise, rows upwards.
    wall_texture: Vec<[u8; 4]>,
    /// Their linear light, the last value unused.
    wall_light: Vec<[f32; 4]>,
    columns: usize,
    rows: usize,
    /// Half extent of a field's own walls, and half the width of the goals' mouths in them.
    field_walls: Option<([f32; 2], f32)>,
    /// Objects between carpet and walls, field frame.
    pub(super) clutter: Vec<Solid>,
}

impl Environment {
    pub(super) fn new(field: &Field, config: &EnvironmentConfig, rng: &mut ChaCha8Rng) -> Self {
        let (carpet_x, carpet_y) = field.carpet_half_extent();
        let half = [carpet_x + MARGIN, carpet_y + MARGIN];
        let columns = (4.0 * (half[0] + half[1]) / CELL).ceil() as usize;
        let rows = (HEIGHT / CELL) as usize;
        let mut environment = Environment {
            half,
            wall_texture: Vec::new(),
            wall_light: Vec::new(),
            columns,
            rows,
            field_walls: field.config.walls.then_some((
                [field.config.length / 2.0, field.config.width / 2.0],
                field.config.goal.width / 2.0,
            )),
            clutter: make_clutter([carpet_x, carpet_y], rng),
        };
        environment.paint_walls(rng);
        environment.paint_windows(config.windows);
        environment.light_walls([1.0, config.window_light]);
        environment
    }

    /// Paints plaster above a darker skirting, with panels, doors and posters of any colour.
    fn paint_walls(&mut self, rng: &mut ChaCha8Rng) {
        let (columns, rows) = (self.columns, self.rows);
        let plaster = [196, 192, 182, 0];
        let skirting = [150, 155, 168, 0];
        self.wall_texture = (0..columns * rows)
            .map(|index| {
                if (index / columns) as f32 * CELL < SKIRTING {
                    skirting
                } else {
                    plaster
                }
            })
            .collect();
        let panels = (columns as f32 * CELL / 1.4) as usize;
        for _ in 0..panels {
            let [red, green, blue] =
                clutter_colour(rng).map(|part| srgb_from_linear(part * 0.8 + 0.02));
            let colour = [red, green, blue, 0];
            let left = (rng.random::<f32>() * columns as f32) as usize;
            let width = ((0.3 + 1.2 * rng.random::<f32>()) / CELL) as usize;
            let low = ((rng.random::<f32>() * 1.2) / CELL) as usize;
            let high = (low + ((0.4 + rng.random::<f32>()) / CELL) as usize).min(rows);
            for row in low..high {
                for column in left..left + width {
                    self.wall_texture[row * columns + column % columns] = colour;
                }
            }
        }
    }

    /// Paints windows at equal distances, of the same share of the wall's length each.
    fn paint_windows(&mut self, count: usize) {
        let (low, high) = ((WINDOW[1] / CELL) as usize, (WINDOW[2] / CELL) as usize);
        for window in 0..count {
            let left = (window * self.columns + self.columns / 3) / count;
            for row in low..high.min(self.rows) {
                for column in left..left + (WINDOW[0] / CELL) as usize {
                    self.wall_texture[row * self.columns + column % self.columns] = WINDOW_RGB;
                }
            }
        }
    }

    /// Computes the light of the texture; `brightness`: of walls and of windows.
    fn light_walls(&mut self, brightness: [f32; 2]) {
        let linear: [f32; 256] = std::array::from_fn(|byte| linear_from_srgb(byte as u8));
        let light = |&[red, green, blue, window]: &[u8; 4]| {
            let bright = brightness[usize::from(window & 1)];
            let [red, green, blue] =
                [red, green, blue].map(|byte| bright * linear[usize::from(byte)]);
            [red, green, blue, 0.0]
        };
        self.wall_light = self.wall_texture.iter().map(light).collect();
    }

    /// Draws the walls on every ray that meets them above the floor; branch-free for vectorisation.
    pub(super) fn shade(
        &self,
        pose: Pose,
        rays: &SortedRays,
        tile: &Tile,
        moved: &MovedRays,
        light_buffer: &mut LightBuffer,
    ) {
        let (sin, cos) = pose.theta.sin_cos();
        let [hx, hy] = self.half;
        let (per_cell, most_column, most_row) = (
            1.0 / CELL,
            (self.columns - 1) as f32,
            (self.rows - 1) as f32,
        );
        for (number, bin) in rays.bins(tile) {
            let first = first_ray_above_floor(pose, rays, (number, &bin), self.half);
            let run = first..bin.end;
            let ray = moved.run(rays, &run);
            let mut light = light_buffer.lanes(&run);
            for group in 0..ray.groups() {
                let RayLanes {
                    origin,
                    direction,
                    slope,
                    slope_spacing,
                    ..
                } = ray.lanes(group);
                let mask = ray.mask(group);
                let (mut cell, mut covered) = ([0u32; LANES], [0.0; LANES]);
                for i in 0..LANES {
                    let (ox, oy) = (origin[0][i], origin[1][i]);
                    let (from_x, from_y) = (
                        cos.mul_add(ox, (-sin).mul_add(oy, pose.x)),
                        sin.mul_add(ox, cos.mul_add(oy, pose.y)),
                    );
                    let (tx, ty) = (direction[0][i], direction[1][i]);
                    let (to_x, to_y) = (cos.mul_add(tx, -sin * ty), sin.mul_add(tx, cos * ty));
                    let distance_x = distance_to_wall(hx, from_x, to_x);
                    let distance_y = distance_to_wall(hy, from_y, to_y);
                    let distance = distance_x.min(distance_y).max(1e-3);
                    let z = slope[i].mul_add(distance, origin[2][i]);
                    covered[i] =
                        mask[i] * edge_coverage(z, distance.mul_add(slope_spacing[i], 1e-3));
                    // Along the walls, counter-clockwise from the corner (+x, −y).
                    let (x, y) = (
                        distance.mul_add(to_x, from_x),
                        distance.mul_add(to_y, from_y),
                    );
                    let side = if to_x > 0.0 {
                        y + hy
                    } else {
                        2.0 * hx + 3.0 * hy - y
                    };
                    let end = if to_y > 0.0 {
                        2.0 * hy + hx - x
                    } else {
                        3.0 * hx + 4.0 * hy + x
                    };
                    let along = if distance_x < distance_y { side } else { end };
                    let column = (along * per_cell).clamp(0.0, most_column);
                    let row = (z * per_cell).clamp(0.0, most_row);
                    cell[i] = floor_to_u32(row) * self.columns as u32 + floor_to_u32(column);
                }
                let mut colours = [[0f32; LANES]; 3];
                for i in 0..LANES {
                    let colour = self.wall_light[cell[i] as usize];
                    for k in 0..3 {
                        colours[k][i] = colour[k];
                    }
                }
                for (plane, colours) in light.iter_mut().zip(&colours) {
                    let light = &mut plane[group];
                    for i in 0..LANES {
                        light[i] = covered[i].mul_add(colours[i] - light[i], light[i]);
                    }
                }
            }
        }
        if let Some((half, mouth)) = self.field_walls {
            draw_field_walls(pose, half, mouth, (rays, tile, moved), light_buffer);
        }
    }
}

/// Draws the field's own walls, white and open at the goals' mouths.
fn draw_field_walls(
    pose: Pose,
    [hx, hy]: [f32; 2],
    mouth: f32,
    (rays, tile, moved): (&SortedRays, &Tile, &MovedRays),
    light_buffer: &mut LightBuffer,
) {
    let (sin, cos) = pose.theta.sin_cos();
    let white = FIELD_WALL_RGB.map(linear_from_srgb);
    for (number, bin) in rays.bins(tile) {
        let run = first_ray_above_floor(pose, rays, (number, &bin), [hx, hy])..bin.end;
        let moved = moved.run(rays, &run);
        let origin = moved.origin.map(|of| of.as_flattened());
        let direction = moved.direction.map(|of| of.as_flattened());
        let slope = moved.slope.as_flattened();
        let slope_spacing = moved.slope_spacing.as_flattened();
        let [red, green, blue] = light_buffer.planes(&run);
        for i in 0..run.len() {
            let (ox, oy) = (origin[0][i], origin[1][i]);
            let (from_x, from_y) = (pose.x + cos * ox - sin * oy, pose.y + sin * ox + cos * oy);
            let (tx, ty) = (direction[0][i], direction[1][i]);
            let (to_x, to_y) = (cos * tx - sin * ty, sin * tx + cos * ty);
            let (distance_x, distance_y) = (
                distance_to_wall(hx, from_x, to_x),
                distance_to_wall(hy, from_y, to_y),
            );
            let distance = distance_x.min(distance_y).max(1e-3);
            let closed = if distance_x < distance_y && (from_y + distance * to_y).abs() < mouth {
                0.0
            } else {
                1.0
            };
            let z = origin[2][i] + slope[i] * distance;
            let width = distance * slope_spacing[i] + 1e-3;
            let covered = closed * edge_coverage(z, width) * edge_coverage(FIELD_WALL - z, width);
            // The walls along y get slightly less light.
            let facing = if distance_x < distance_y { 1.0 } else { 0.9 };
            red[i] += covered * (white[0] * facing - red[i]);
            green[i] += covered * (white[1] * facing - green[i]);
            blue[i] += covered * (white[2] * facing - blue[i]);
        }
    }
}

/// The integer part of a number from 0 to 4 million, without the checks of a cast.
#[inline(always)]
fn floor_to_u32(number: f32) -> u32 {
    (number - 0.5 + 12_582_912.0).max(12_582_912.0).to_bits() & 0x3f_ffff
}

/// Distance to the wall at ± half along one axis, from inside.
#[inline(always)]
fn distance_to_wall(half: f32, from: f32, rate: f32) -> f32 {
    (half.copysign(rate) - from)
        / if rate.abs() < 1e-6 {
            1e-6f32.copysign(rate)
        } else {
            rate
        }
}

/// The first ray of a bin that may meet a wall above the floor; those before it are too steep.
fn first_ray_above_floor(
    pose: Pose,
    rays: &SortedRays,
    (number, bin): (usize, &Range<usize>),
    half: [f32; 2],
) -> usize {
    let (sin, cos) = pose.theta.sin_cos();
    let RowTransform {
        angle_max,
        shift_max,
        ..
    } = rays.transform;
    let [tx, ty] = rays.bin_direction(number);
    let (tx, ty) = (cos * tx - sin * ty, sin * tx + cos * ty);
    // Tilt turns the azimuth of a ray that meets a wall, which is nearly level, by less than its angle.
    let spread = BIN_SPREAD + angle_max;
    let nearest = [-spread, spread]
        .map(|turn| {
            let (tx, ty) = (tx - turn * ty, ty + turn * tx);
            let distance_x = distance_to_wall(half[0], pose.x, tx);
            distance_x.min(distance_to_wall(half[1], pose.y, ty))
        })
        .into_iter()
        .fold(f32::MAX, f32::min);
    // Margin for origins off the axis and the motion during the image.
    let near = (0.998 * nearest - 2.0 * rays.origin_radius_max - shift_max).max(0.05);
    let lifted = angle_max * (rays.origin_radius_max + angle_max * rays.origin_height_max);
    let level = -(rays.origin_height_max + lifted) / near;
    let steepest = rays.steepest(number, level - rays.reach_below(level) - 1e-3 / near);
    bin.start + rays.slope[bin.clone()].partition_point(|&slope| slope < steepest)
}

/// Random people, boxes and poles between carpet and walls.
fn make_clutter(carpet: [f32; 2], rng: &mut ChaCha8Rng) -> Vec<Solid> {
    let mut solids = Vec::new();
    for _ in 0..CLUTTER_COUNT {
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
            solids.push(Solid {
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
                stack(0.0, 0.85, round(0.14), [40, 42, 58].map(linear_from_srgb));
                stack(0.85, 1.5, round(0.2), colour);
                stack(1.5, 1.75, round(0.1), [190, 150, 125].map(linear_from_srgb));
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
    solids
}

/// A random colour: half of them greys, the others as bright as a ball or a marker.
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
    BRIGHT[rng.random_range(0..BRIGHT.len())].map(linear_from_srgb)
}
