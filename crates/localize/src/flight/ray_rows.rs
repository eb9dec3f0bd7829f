//! How do azimuth, elevation and apparent size of a sighting depend on the ball's place and on the errors that a robot's rays share?

use super::config::FlightConfig;
use super::ray::RobotRay;
use crate::math;

/// Standard deviation of a distance by the apparent size that all rays of a robot share, share of the distance.
const SIZE_BIAS_STD: f64 = 0.15;
/// Largest and smallest distance that weights a ray, metres.
const DISTANCE_MAX: f64 = 20.0;
pub(super) const DISTANCE_MIN: f64 = 0.3;

/// A row of the measurement matrix: coefficients of the position and of one shared error.
pub(super) struct Row {
    pub(super) axis: [f64; 3],
    pub(super) bias: (usize, f64),
    /// Measured minus what a ball at the origin of the frame would give.
    pub(super) value: f64,
    pub(super) variance: f64,
}

/// A ray's unit vectors.
pub(super) struct Direction {
    pub(super) towards: [f64; 3],
    pub(super) aside: [f64; 3],
    pub(super) upwards: [f64; 3],
}

pub(super) fn direction(azimuth: f64, elevation: f64) -> Direction {
    let (sin, cos) = math::sin_cos(azimuth);
    let (up, level) = math::sin_cos(elevation);
    Direction {
        towards: [level * cos, level * sin, up],
        aside: [-sin, cos, 0.0],
        upwards: [-up * cos, -up * sin, level],
    }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Point of a ray at a distance.
pub(super) fn point_on(ray: &RobotRay, distance: f64) -> [f64; 3] {
    let towards = direction(f64::from(ray.ray.azimuth), f64::from(ray.ray.elevation)).towards;
    std::array::from_fn(|axis| f64::from(ray.ray.origin[axis]) + distance * towards[axis])
}

/// About which ball the rows are linear.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayGeometry {
    /// Its place, metres.
    pub(super) at: [f64; 3],
    /// m/s.
    pub(super) velocity: [f64; 3],
    /// The derivatives are those at this place, else those at the point of the ray at its distance. There the noise of a
    /// measured direction would seem to tell the distance.
    pub(super) near: bool,
}

/// Azimuth, elevation and distance, with the errors that the robot's rays share from number `first` of the state on.
pub(super) fn ray_rows(
    geometry: &RayGeometry,
    ray: &RobotRay,
    first: usize,
    config: &FlightConfig,
) -> [Option<Row>; 3] {
    let &RayGeometry { at, velocity, near } = geometry;
    let [level, distance] = distances_to(at, ray);
    let RobotRay { ray, pose_std, .. } = ray;
    let origin = ray.origin.map(f64::from);
    let measured = [f64::from(ray.azimuth), f64::from(ray.elevation)];
    let seen = if near {
        let offset: [f64; 3] = std::array::from_fn(|axis| at[axis] - origin[axis]);
        [
            math::atan2(offset[1], offset[0]),
            math::atan2(offset[2], math::hypot(offset[0], offset[1])),
        ]
    } else {
        measured
    };
    // The innovation of a ball at `reference` is the difference of the directions.
    let reference = if near { at } else { origin };
    let direction = direction(seen[0], seen[1]);
    let bias = f64::from(config.bearing_bias_std_deg).to_radians();
    let [position, heading] = pose_std.map(f64::from);
    let clock = f64::from(config.clock_std);
    let late = |axis: [f64; 3], range: f64| dot(axis, velocity) * clock / range;
    let norm = |parts: &[f64]| parts.iter().map(|part| part * part).sum::<f64>().sqrt();
    // Along the ray an error of the position changes the elevation by its sine.
    let foreshortened = math::sin(measured[1]) * position / distance;
    let aside = norm(&[
        bias,
        heading,
        position / level,
        late(direction.aside, level),
    ]);
    let upwards = norm(&[bias, foreshortened, late(direction.upwards, distance)]);
    let across = |axis: [f64; 3], range: f64, off: f64, bias: (usize, f64), std: f32| Row {
        axis: axis.map(|part| part / range),
        bias,
        value: dot(axis, reference) / range + off,
        variance: f64::from(std) * f64::from(std),
    };
    let size = ray.distance.map(|pair| {
        let [measured, std] = pair.map(f64::from);
        Row {
            axis: direction.towards,
            bias: (first + 2, -measured * SIZE_BIAS_STD),
            value: measured + dot(direction.towards, origin),
            variance: std * std,
        }
    });
    let turn = wrap_angle(measured[0] - seen[0]);
    let raise = measured[1] - seen[1];
    [
        Some(across(
            direction.aside,
            level,
            turn,
            (first, aside),
            ray.azimuth_std,
        )),
        Some(across(
            direction.upwards,
            distance,
            raise,
            (first + 1, upwards),
            ray.elevation_std,
        )),
        size,
    ]
}

/// Horizontal and whole distance of a ball, limited so that no weight is extreme.
pub(super) fn distances_to(at: [f64; 3], ray: &RobotRay) -> [f64; 2] {
    let offset: [f64; 3] = std::array::from_fn(|axis| at[axis] - f64::from(ray.ray.origin[axis]));
    let level = math::hypot(offset[0], offset[1]);
    [level, math::hypot(level, offset[2])].map(|range| range.clamp(DISTANCE_MIN, DISTANCE_MAX))
}

/// An angle between −π and π.
fn wrap_angle(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}
