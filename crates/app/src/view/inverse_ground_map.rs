//! Inverse of the ground map: from a ground point to its pixel, by a table of initial pixels and Newton's method.

use localize::frames::{At, RobotFrame};
use vision::GroundMap;

/// Bearings and ranges of the table of initial pixels.
const BEARINGS: usize = 180;
const RANGES: usize = 64;
/// Nearest range of the table, metres; ranges grow geometrically.
const RANGE_MIN: f32 = 0.15;
/// Farthest range of the table, metres.
const RANGE_MAX: f32 = 20.0;
/// Newton iterations at most: the map is smooth, so two suffice from a neighbouring cell.
const STEPS: usize = 4;
/// Largest distance between the requested and the found ground point, in pixel widths on the ground.
const MAX_REPROJECTION_ERROR_PX: f32 = 1.0;

/// Initial pixels by bearing and range.
#[derive(Debug, Clone)]
pub(crate) struct InverseGroundMap {
    initial_pixels: Vec<Option<[u16; 2]>>,
}

impl InverseGroundMap {
    /// Builds the table from every pixel of the map; empty cells take a neighbour's pixel along their ray.
    ///
    /// The rim of a mirror may show the same ground again, coarsely: the pixel that resolves a cell best stands for it.
    pub(crate) fn new(map: &GroundMap) -> Self {
        let mut start: Vec<Option<[u16; 2]>> = vec![None; BEARINGS * RANGES];
        let mut finest = vec![f32::INFINITY; BEARINGS * RANGES];
        for row in 0..map.height_px {
            for column in 0..map.width_px {
                let (Some(ground), Some(area)) =
                    (map.at(column, row), pixel_area(map, column, row))
                else {
                    continue;
                };
                if let Some(cell) = cell(ground).filter(|&cell| area < finest[cell]) {
                    start[cell] = Some([column as u16, row as u16]);
                    finest[cell] = area;
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

    /// Pixel (column, row) of a ground point; None if the camera does not see it.
    pub(crate) fn project(&self, map: &GroundMap, ground: At<RobotFrame>) -> Option<[f32; 2]> {
        let [column, row] = self.initial_pixels[cell(ground)?]?;
        let mut at = [f32::from(column), f32::from(row)];
        for _ in 0..STEPS {
            let here = map.interpolate(at[0], at[1])?;
            let neighbour = |du: f32, dv: f32| map.interpolate(at[0] + du, at[1] + dv);
            // Pixels at the border have a neighbour on one side only.
            let slope = |du: f32, dv: f32| {
                neighbour(du, dv)
                    .map(|next| [next.x - here.x, next.y - here.y])
                    .or_else(|| neighbour(-du, -dv).map(|next| [here.x - next.x, here.y - next.y]))
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
            // Limit the step: the linearisation holds only near the current pixel.
            let length = step[0].hypot(step[1]).max(1e-6);
            let scale = (20.0 / length).min(1.0);
            at = [
                (at[0] + scale * step[0]).clamp(0.0, (map.width_px - 1) as f32),
                (at[1] + scale * step[1]).clamp(0.0, (map.height_px - 1) as f32),
            ];
            if length < 0.05 {
                break;
            }
        }
        let found = map.interpolate(at[0], at[1])?;
        let adjacent = map
            .interpolate(at[0] + 1.0, at[1])
            .or_else(|| map.interpolate(at[0] - 1.0, at[1]))?;
        let pixel_size = found.distance_to(adjacent).max(0.01);
        (found.distance_to(ground) < MAX_REPROJECTION_ERROR_PX * pixel_size).then_some(at)
    }
}

/// Ground that a pixel covers, square metres. `None` where a neighbour sees none.
fn pixel_area(map: &GroundMap, column: usize, row: usize) -> Option<f32> {
    let here = map.at(column, row)?;
    let neighbour = |column: usize, row: usize| {
        let inside = column < map.width_px && row < map.height_px;
        inside.then(|| map.at(column, row)).flatten()
    };
    let across = neighbour(column + 1, row).or_else(|| neighbour(column.wrapping_sub(1), row))?;
    let down = neighbour(column, row + 1).or_else(|| neighbour(column, row.wrapping_sub(1)))?;
    let (xu, yu) = (across.x - here.x, across.y - here.y);
    let (xv, yv) = (down.x - here.x, down.y - here.y);
    Some((xu * yv - xv * yu).abs())
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
        let (mut points, mut found) = (0, 0);
        for v in (0..map.height_px).step_by(7) {
            for u in (0..map.width_px).step_by(7) {
                let Some(ground) = map
                    .at(u, v)
                    .filter(|at| (0.5..8.0).contains(&at.distance()))
                else {
                    continue;
                };
                points += 1;
                if let Some([fu, fv]) = inverse.project(&map, ground) {
                    found += 1;
                    let error = (fu - u as f32).hypot(fv - v as f32);
                    assert!(error < 0.5, "({u}, {v}) was projected to ({fu}, {fv})");
                }
            }
        }
        assert!(found * 100 >= points * 98, "{found} of {points}");
    }
}
