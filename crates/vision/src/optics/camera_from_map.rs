//! Recovers the camera of a calibrated map: axis, forward direction and handedness.

use localize::math;
use localize::robot::CameraConfig;
use nalgebra::{Matrix3, Vector3};

use crate::optics::ground_map::GroundMap;

/// Camera of a map: axis, forward direction and handedness, from the ground nearest to the robot.
///
/// None if the map shows too little ground. The rim radius is that of the outermost mapped pixel.
pub fn camera_from_map(map: &GroundMap) -> Option<CameraConfig> {
    let mut ranges: Vec<f32> = ground(map)
        .map(|(_, at)| math::hypot(at[0], at[1]))
        .collect();
    if ranges.len() < 100 {
        return None;
    }
    let quarter = ranges.len() / 4;
    let (_, &mut near, _) = ranges.select_nth_unstable_by(quarter, f32::total_cmp);
    // Near the axis the ground is nearly a rotated, scaled image: x ≈ a·(u, v) + b, solved by least squares.
    let mut normal = Matrix3::<f64>::zeros();
    let mut sides = [Vector3::<f64>::zeros(); 2];
    for (pixel, at) in ground(map).filter(|(_, at)| math::hypot(at[0], at[1]) <= near) {
        let row = Vector3::new(f64::from(pixel[0]), f64::from(pixel[1]), 1.0);
        normal += row * row.transpose();
        for axis in 0..2 {
            sides[axis] += row * f64::from(at[axis]);
        }
    }
    let inverse = normal.try_inverse()?;
    let [x, y] = sides.map(|side| inverse * side);
    let determinant = x[0] * y[1] - x[1] * y[0];
    if determinant.abs() < 1e-12 {
        return None;
    }
    let centre_px = [
        ((x[1] * y[2] - x[2] * y[1]) / determinant) as f32,
        ((x[2] * y[0] - x[0] * y[2]) / determinant) as f32,
    ];
    let rim = ground(map)
        .map(|([u, v], _)| math::hypot(u - centre_px[0], v - centre_px[1]))
        .fold(0.0, f32::max);
    Some(CameraConfig {
        width_px: map.width_px,
        height_px: map.height_px,
        focal_px: None,
        centre_px,
        height: None,
        forward_deg: math::atan2(-x[1], x[0]).to_degrees() as f32,
        // v points down: an unflipped mount has its determinant negative.
        flipped: determinant > 0.0,
        outer_radius_px: Some(rim),
    })
}

/// Pixels that show ground (u, v), with their ground points (x, y), metres.
fn ground(map: &GroundMap) -> impl Iterator<Item = ([f32; 2], [f32; 2])> {
    (0..map.height_px)
        .flat_map(move |row| (0..map.width_px).map(move |column| (column, row)))
        .filter_map(move |(column, row)| {
            let at = map.at(column, row)?;
            Some(([column as f32, row as f32], [at.x, at.y]))
        })
}
