//! Where in the image is a point of the ground? The map's way back, found by a table and a few steps of Newton's.

use localize::frames::{At, RobotFrame};
use vision::GroundMap;

/// Directions and distances of the table that says where to start.
const BEARINGS: usize = 180;
const RANGES: usize = 64;
/// Nearest distance of the table, metres; each range is a constant factor wider than the one before.
const RANGE_MIN: f32 = 0.15;
/// Farthest, metres.
const RANGE_MAX: f32 = 20.0;
/// Newton's steps: the map is smooth, from a neighbouring cell two suffice.
const STEPS: usize = 4;
/// A found pixel shows the ground no farther off than so many pixels' worth.
const MAX_REPROJECTION_ERROR_PX: f32 = 1.0;

/// Starting pixels by direction and distance.
#[derive(Debug, Clone)]
pub(crate) struct InverseGroundMap {
    initial_pixels: Vec<Option<[u16; 2]>>,
}

impl InverseGroundMap {
    /// Enters every pixel of the map into the table; empty cells take their neighbour's along the ray.
    pub(crate) fn new(map: &GroundMap) -> Self {
        let mut start: Vec<Option<[u16; 2]>> = vec![None; BEARINGS * RANGES];
        for row in 0..map.height_px {
            for column in 0..map.width_px {
                if let Some(cell) = map.at(column, row).and_then(cell) {
                    start[cell] = Some([column as u16, row as u16]);
                }
            }
        }
        for ray in start.chunks_mut(RANGES) {
            for range in 1..RANGES {
                ray[range] = ray[range].or(ray[range - 1]);
            }
            for range in (1..RANGES).rev() {
                ray[range - 1] = ray[range - 1].or(ray[range]);
            }
        }
        InverseGroundMap {
            initial_pixels: start,
        }
    }

    /// Column and row that show a point of the ground; none where the camera does not see it.
    pub(crate) fn project(&self, map: &GroundMap, ground: At<RobotFrame>) -> Option<[f32; 2]> {
        let [column, row] = self.initial_pixels[cell(ground)?]?;
        let mut at = [f32::from(column), f32::from(row)];
        for _ in 0..STEPS {
            let here = map.interpolate(at[0], at[1])?;
            let side = |du: f32, dv: f32| map.interpolate(at[0] + du, at[1] + dv);
            // The border has a neighbour on one side alone.
            let slope = |du: f32, dv: f32| {
                side(du, dv)
                    .map(|next| [next.x - here.x, next.y - here.y])
                    .or_else(|| side(-du, -dv).map(|next| [here.x - next.x, here.y - next.y]))
            };
            let ([xu, yu], [xv, yv]) = (slope(1.0, 0.0)?, slope(0.0, 1.0)?);
            let determinant = xu * yv - xv * yu;
            let (dx, dy) = (ground.x - here.x, ground.y - here.y);
            let step = [
                (yv * dx - xv * dy) / determinant,
                (xu * dy - yu * dx) / determinant,
            ];
            if !step[0].is_finite() || !step[1].is_finite() {
                return None;
            }
            // A long step leaves the part of the image in which the slope holds.
            let long = step[0].hypot(step[1]).max(1e-6);
            let part = (20.0 / long).min(1.0);
            at = [
                (at[0] + part * step[0]).clamp(0.0, (map.width_px - 1) as f32),
                (at[1] + part * step[1]).clamp(0.0, (map.height_px - 1) as f32),
            ];
            if long < 0.05 {
                break;
            }
        }
        let found = map.interpolate(at[0], at[1])?;
        let beside = map
            .interpolate(at[0] + 1.0, at[1])
            .or_else(|| map.interpolate(at[0] - 1.0, at[1]))?;
        let size = found.distance_to(beside).max(0.01);
        (found.distance_to(ground) < MAX_REPROJECTION_ERROR_PX * size).then_some(at)
    }
}

fn cell(ground: At<RobotFrame>) -> Option<usize> {
    let range = ground.distance();
    if !(range < RANGE_MAX) {
        return None;
    }
    let steps = (range.max(RANGE_MIN) / RANGE_MIN).ln() / (RANGE_MAX / RANGE_MIN).ln();
    let range = ((steps * RANGES as f32) as usize).min(RANGES - 1);
    let turns = ground.bearing() / std::f32::consts::TAU;
    let bearing = (turns.rem_euclid(1.0) * BEARINGS as f32) as usize % BEARINGS;
    Some(bearing * RANGES + range)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use pipeline::setup::Setup;

    #[test]
    fn inverse_map_returns_the_pixel_of_its_ground_point() {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence/robot.toml");
        let setup = Setup::load(&robot, None).expect("a robot");
        let (_, map) = setup.camera.expect("a camera");
        let inverse = InverseGroundMap::new(&map);
        let (mut asked, mut found) = (0, 0);
        for v in (0..map.height_px).step_by(7) {
            for u in (0..map.width_px).step_by(7) {
                let Some(ground) = map
                    .at(u, v)
                    .filter(|at| (0.5..8.0).contains(&at.distance()))
                else {
                    continue;
                };
                asked += 1;
                if let Some([fu, fv]) = inverse.project(&map, ground) {
                    found += 1;
                    let off = (fu - u as f32).hypot(fv - v as f32);
                    assert!(off < 0.5, "({u}, {v}) came back as ({fu}, {fv})");
                }
            }
        }
        assert!(found * 100 >= asked * 98, "{found} of {asked}");
    }
}
