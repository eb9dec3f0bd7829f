//! How are walls drawn? Those of the hall, and a field's own ones.

use super::culling::ReachMargins;
use super::environment::{CELL, Environment};
use super::field_from_robot::FieldFromRobot;
use super::lanes::{BlockLight, LANES, any_positive, blend, edge_coverage, larger, smaller};
use super::lattice::BlockView;
use super::moving_rays::{MovedBlock, RayLanes};
use crate::image_sensor::linear_from_srgb;

/// Height of a field's own walls (the league's fields until 2001), metres.
const FIELD_WALL: f32 = 0.5;
/// Their sRGB colour.
const FIELD_WALL_RGB: [u8; 3] = [206, 208, 205];
/// Least distance to a wall that counts, metres.
const DISTANCE_MIN: f32 = 0.05;

impl Environment {
    /// Which walls may a block see above the floor: the hall's, the field's own?
    pub(super) fn visible_walls(
        &self,
        pose: FieldFromRobot,
        view: &BlockView,
        margins: &ReachMargins,
    ) -> [bool; 2] {
        let sees = |half: [f32; 2]| {
            // The steepest ray that meets the nearest wall above the floor.
            let reaches = |distance: f32| {
                let near = (0.998 * distance - margins.origin_radius()).max(DISTANCE_MIN);
                view.slope[1] >= -(margins.height_max() + 1e-3) / near
            };
            let gaps = [
                half[0] - pose.x,
                half[1] - pose.y,
                half[0] + pose.x,
                half[1] + pose.y,
            ];
            let nearest = gaps.into_iter().fold(f32::MAX, f32::min);
            reaches(nearest) && reaches(nearest_wall(pose, view, gaps))
        };
        [
            sees(self.half),
            self.field_walls.is_some_and(|(half, _)| sees(half)),
        ]
    }

    /// Draws the hall's walls on a block.
    #[inline(never)]
    pub(super) fn draw_walls(
        &self,
        pose: FieldFromRobot,
        rays: &MovedBlock,
        light: &mut BlockLight,
    ) {
        let (sin, cos) = (pose.sin, pose.cos);
        let [hx, hy] = self.half;
        let per_cell = 1.0 / CELL;
        let (most_column, most_row) = ((self.columns - 1) as f32, (self.rows - 1) as f32);
        for (row, of_row) in rays.rows.iter().enumerate() {
            let RayLanes {
                origin,
                direction,
                slope,
            } = of_row;
            let slope_spacing = &rays.spacing[1][row];
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
                let distance = larger(smaller(distance_x, distance_y), 1e-3);
                let z = slope[i].mul_add(distance, origin[2][i]);
                covered[i] = edge_coverage(z, distance.mul_add(slope_spacing[i], 1e-3));
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
                let column = smaller(larger(along * per_cell, 0.0), most_column);
                let row = smaller(larger(z * per_cell, 0.0), most_row);
                cell[i] = floor_to_u32(row) * self.columns as u32 + floor_to_u32(column);
            }
            if !any_positive(&covered) {
                continue;
            }
            let mut colours = [[0f32; LANES]; 3];
            for i in 0..LANES {
                let colour = self.wall_light[cell[i] as usize];
                for k in 0..3 {
                    colours[k][i] = colour[k];
                }
            }
            for (plane, colours) in light.iter_mut().zip(&colours) {
                let light = &mut plane[row];
                for i in 0..LANES {
                    light[i] = covered[i].mul_add(colours[i] - light[i], light[i]);
                }
            }
        }
    }

    /// Draws the field's own walls, white and open at the goals' mouths.
    pub(super) fn draw_field_walls(
        &self,
        pose: FieldFromRobot,
        rays: &MovedBlock,
        light: &mut BlockLight,
    ) {
        let Some(([hx, hy], mouth)) = self.field_walls else {
            return;
        };
        let (sin, cos) = (pose.sin, pose.cos);
        let white = FIELD_WALL_RGB.map(linear_from_srgb);
        for (row, of_row) in rays.rows.iter().enumerate() {
            let RayLanes {
                origin,
                direction,
                slope,
            } = of_row;
            let slope_spacing = &rays.spacing[1][row];
            let (mut end, mut side) = ([0.0; LANES], [0.0; LANES]);
            for i in 0..LANES {
                let (ox, oy) = (origin[0][i], origin[1][i]);
                let (from_x, from_y) = (pose.x + cos * ox - sin * oy, pose.y + sin * ox + cos * oy);
                let (tx, ty) = (direction[0][i], direction[1][i]);
                let (to_x, to_y) = (cos * tx - sin * ty, sin * tx + cos * ty);
                let distance_x = distance_to_wall(hx, from_x, to_x);
                let distance_y = distance_to_wall(hy, from_y, to_y);
                let distance = larger(smaller(distance_x, distance_y), 1e-3);
                let is_end = distance_x < distance_y;
                let open = is_end & ((from_y + distance * to_y).abs() < mouth);
                let z = origin[2][i] + slope[i] * distance;
                let width = distance * slope_spacing[i] + 1e-3;
                let covered = edge_coverage(z, width) * edge_coverage(FIELD_WALL - z, width);
                let covered = if open { 0.0 } else { covered };
                end[i] = if is_end { covered } else { 0.0 };
                side[i] = covered - end[i];
            }
            // The walls along y get slightly less light. A ray meets one of both.
            blend(light, row, &end, white);
            blend(light, row, &side, white.map(|part| 0.9 * part));
        }
    }
}

/// Least distance to a wall in the directions of a block; `gaps`: to the walls at +x, +y, -x and -y.
fn nearest_wall(pose: FieldFromRobot, view: &BlockView, gaps: [f32; 4]) -> f32 {
    let Some([half_cos, half_sin]) = view.half_angle else {
        return gaps.into_iter().fold(f32::MAX, f32::min);
    };
    let [tx, ty] = pose.rotate(view.towards);
    let mut nearest = f32::MAX;
    for (gap, part, turn) in [
        (gaps[0], tx, ty),
        (gaps[1], ty, tx),
        (gaps[2], -tx, ty),
        (gaps[3], -ty, tx),
    ] {
        // The largest component of any of the directions towards this wall.
        let most = if part >= half_cos {
            1.0
        } else {
            part * half_cos + turn.abs() * half_sin
        };
        if most > 1e-3 {
            nearest = nearest.min(gap / most);
        }
    }
    nearest
}

/// The integer part of a number from 0 to 4 million, without the checks of a cast.
#[inline(always)]
fn floor_to_u32(number: f32) -> u32 {
    (number - 0.5 + 12_582_912.0).max(12_582_912.0).to_bits() & 0x3f_ffff
}

/// Distance to the wall at ± half along one axis, from inside.
#[inline(always)]
fn distance_to_wall(half: f32, from: f32, rate: f32) -> f32 {
    (half.copysign(rate) - from) / larger(rate.abs(), 1e-6).copysign(rate)
}
