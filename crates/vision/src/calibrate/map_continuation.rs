//! What would a map show beyond its last ground? Lines beyond the end of a start map would correct nothing.
//!
//! Towards the horizon the inverse of the distance falls linearly with the image radius, for any smooth mirror.

use std::f64::consts::TAU;

use localize::math;
use localize::robot::CameraConfig;

use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::{azimuth, nearest_pixel};

/// Azimuths whose ends are sought.
const AZIMUTHS: usize = 360;
/// Last known radii to which the line is fitted, as a share of the image's width, and their fewest.
const TAIL_SHARE: f64 = 0.03;
const TAIL_MIN: usize = 6;
/// Farthest ground that is added, metres: where the corrections of a map end.
const RANGE_MAX: f64 = 12.0;

/// A map's end along one azimuth.
#[derive(Debug, Clone, Copy)]
struct MapEnd {
    /// Last radius with ground, pixels.
    radius: f64,
    /// Inverse distance there, 1/m, and its change per pixel.
    inverse_range: f64,
    slope: f64,
    /// Bearing of the ground there minus that of the pixel, radians.
    deviation: f64,
}

/// The map with ground up to 12 m inside the rim. None if it has all of that.
pub(super) fn continue_map(start: &GroundMap, camera: &CameraConfig) -> Option<GroundMap> {
    let ends: Vec<Option<MapEnd>> = (0..AZIMUTHS)
        .map(|index| find_end(start, camera, TAU * index as f64 / AZIMUTHS as f64))
        .collect();
    let mut map = start.clone();
    let mut is_longer = false;
    for index in 0..map.x.len() {
        let (u, v) = (index % map.width_px, index / map.width_px);
        let (column, row) = (u as f32, v as f32);
        if start.at(u, v).is_some() || !camera.is_inside_mirror(column, row) {
            continue;
        }
        let turns = f64::from(azimuth(camera.centre_px, [column, row])) / TAU;
        let nearest = (turns * AZIMUTHS as f64).round() as i64;
        let Some(end) = ends[nearest.rem_euclid(AZIMUTHS as i64) as usize] else {
            continue;
        };
        let [x, y] = camera.robot_direction_px(column, row).map(f64::from);
        let beyond = math::hypot(x, y) - end.radius;
        let inverse_range = end.inverse_range + end.slope * beyond;
        if beyond > 0.0 && inverse_range >= 1.0 / RANGE_MAX {
            let (sin, cos) = math::sin_cos(math::atan2(y, x) + end.deviation);
            map.x[index] = (cos / inverse_range) as f32;
            map.y[index] = (sin / inverse_range) as f32;
            is_longer = true;
        }
    }
    is_longer.then_some(map)
}

/// The end along an azimuth of the image. None if too little ground precedes it, or if the distance does not rise there.
fn find_end(map: &GroundMap, camera: &CameraConfig, azimuth: f64) -> Option<MapEnd> {
    let diagonal = math::hypot(map.width_px as f64, map.height_px as f64);
    let direction = math::sin_cos(azimuth as f32);
    // Radius, inverse distance.
    let mut known: Vec<[f64; 2]> = Vec::new();
    let mut deviation = 0.0;
    for radius in 0..diagonal as usize {
        let [u, v] = nearest_pixel(camera.centre_px, radius as f32, direction);
        if u < 0.0 || v < 0.0 {
            continue;
        }
        let Some(ground) = map.at(u as usize, v as usize) else {
            continue;
        };
        let [x, y] = camera.robot_direction_px(u, v).map(f64::from);
        let (to_x, to_y) = (f64::from(ground.x), f64::from(ground.y));
        deviation = math::atan2(x * to_y - y * to_x, x * to_x + y * to_y);
        known.push([math::hypot(x, y), 1.0 / math::hypot(to_x, to_y)]);
    }
    let tail = TAIL_SHARE * map.width_px as f64;
    let last = known.last()?[0];
    known.retain(|[radius, _]| *radius >= last - tail);
    let count = known.len() as f64;
    let mean = |axis: usize| known.iter().map(|point| point[axis]).sum::<f64>() / count;
    let (radius, inverse) = (mean(0), mean(1));
    let about_mean = |[r, i]: &[f64; 2]| [(r - radius).powi(2), (r - radius) * (i - inverse)];
    let [squares, products] = known
        .iter()
        .map(about_mean)
        .fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
    let slope = products / squares;
    (known.len() >= TAIL_MIN && slope < 0.0).then_some(MapEnd {
        radius: last,
        inverse_range: inverse + slope * (last - radius),
        slope,
        deviation,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 241;
    const AXIS: f32 = 120.0;
    /// Image radius of the horizon, pixels, and of its pixels' distance times that to the horizon, metre pixels.
    const HORIZON_PX: f32 = 110.0;
    const RISE: f32 = 150.0;

    fn camera() -> CameraConfig {
        CameraConfig {
            width_px: SIDE,
            height_px: SIDE,
            focal_px: None,
            centre_px: [AXIS, AXIS],
            height: None,
            forward_deg: 90.0,
            flipped: false,
            outer_radius_px: None,
        }
    }

    /// A mirror whose inverse distance falls linearly up to the horizon, known to a distance in metres.
    fn map(range_max: f32) -> GroundMap {
        let camera = camera();
        let ground = |index: usize| {
            let (u, v) = ((index % SIDE) as f32, (index / SIDE) as f32);
            let [x, y] = camera.robot_direction_px(u, v);
            let radius = math::hypot(x, y);
            let range = RISE / (HORIZON_PX - radius);
            let is_known = radius > 20.0 && radius < HORIZON_PX && range <= range_max;
            is_known.then(|| [range * x / radius, range * y / radius])
        };
        let part = |axis: usize| {
            let values = (0..SIDE * SIDE).map(ground);
            values.map(move |ground| ground.map_or(f32::NAN, |ground| ground[axis]))
        };
        GroundMap {
            width_px: SIDE,
            height_px: SIDE,
            x: part(0).collect(),
            y: part(1).collect(),
        }
    }

    #[test]
    fn a_map_that_ends_early_is_continued_towards_the_horizon() {
        let (whole, continued) = (
            map(11.0),
            continue_map(&map(4.0), &camera()).expect("more ground"),
        );
        for index in 0..whole.x.len() {
            let (u, v) = (index % SIDE, index / SIDE);
            let Some(right) = whole.at(u, v) else {
                continue;
            };
            let off = continued.at(u, v).expect("ground").distance_to(right);
            assert!(off < 0.02 * right.distance(), "{off} m at {u}, {v}");
        }
        let farthest = continued.farthest_ground_within([AXIS, AXIS], SIDE as f32);
        assert!(farthest <= RANGE_MAX as f32, "{farthest} m");
    }

    #[test]
    fn known_ground_and_the_robot_itself_stay_as_they_are() {
        let start = map(4.0);
        let continued = continue_map(&start, &camera()).expect("more ground");
        for index in 0..start.x.len() {
            let (u, v) = (index % SIDE, index / SIDE);
            if start.at(u, v).is_some() || math::hypot(u as f32 - AXIS, v as f32 - AXIS) < 20.0 {
                assert_eq!(continued.at(u, v), start.at(u, v));
            }
        }
    }

    #[test]
    fn a_map_with_all_ground_is_not_continued() {
        assert!(continue_map(&map(f32::INFINITY), &camera()).is_none());
    }
}
