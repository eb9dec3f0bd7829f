//! How does a pixel lie on the robot? The pinhole camera and its mount, as robot.toml states them.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::ground_map::GroundMap;

/// `[camera]` of robot.toml.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Image width, pixels.
    pub width_px: usize,
    /// Image height, pixels.
    pub height_px: usize,
    /// Focal length, pixels; needed to trace a mirror profile, not with a map.
    pub focal_px: Option<f32>,
    /// Where the mirror's axis meets the image (u right, v down), pixels; integers are pixel centres.
    #[serde(deserialize_with = "localize::exactly::exactly")]
    pub centre_px: [f32; 2],
    /// Height of the pinhole above the ground, metres; needed to trace a mirror profile.
    pub height: Option<f32>,
    /// Where the robot's x axis points in the image: degrees from image right towards image up.
    pub forward_deg: f32,
    /// True if, with forward up, the robot's left is on the image's right (a camera below one mirror).
    pub flipped: bool,
    /// Radius of the mirror's rim in the image, pixels; beyond it there is nothing to see.
    pub outer_radius_px: Option<f32>,
}

impl CameraConfig {
    /// The camera of a map alone: its axis, forward direction and side as the nearest ground shows them.
    ///
    /// None if the map shows too little ground. The rim is where the map ends.
    pub fn of_map(map: &GroundMap) -> Option<Self> {
        let mut ranges: Vec<f32> = ground(map).map(|(_, at)| at[0].hypot(at[1])).collect();
        if ranges.len() < 100 {
            return None;
        }
        let quarter = ranges.len() / 4;
        let (_, &mut near, _) = ranges.select_nth_unstable_by(quarter, f32::total_cmp);
        // Near the axis ground is nearly a rotated, scaled image: x ≈ a·(u, v) + b, solved by least squares.
        let mut normal = Matrix3::<f64>::zeros();
        let mut sides = [Vector3::<f64>::zeros(); 2];
        for (pixel, at) in ground(map).filter(|(_, at)| at[0].hypot(at[1]) <= near) {
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
            .map(|([u, v], _)| (u - centre_px[0]).hypot(v - centre_px[1]))
            .fold(0.0, f32::max);
        Some(CameraConfig {
            width_px: map.width_px,
            height_px: map.height_px,
            focal_px: None,
            centre_px,
            height: None,
            forward_deg: (-x[1]).atan2(x[0]).to_degrees() as f32,
            // v points down: an unflipped mount has its determinant negative.
            flipped: determinant > 0.0,
            outer_radius_px: Some(rim),
        })
    }

    /// The image direction (pixels right, pixels down) of a step along the robot's (x, y).
    ///
    /// Row-major 2 × 2 orthogonal matrix; its determinant is −1 for an unflipped mount, since v points down.
    pub fn image_from_robot(&self) -> [[f32; 2]; 2] {
        let (sin, cos) = self.forward_deg.to_radians().sin_cos();
        let side = if self.flipped { -1.0 } else { 1.0 };
        // Forward is (cos, sin) in (right, up); left is a quarter turn from it, the other way round if flipped.
        [[cos, -side * sin], [-sin, -side * cos]]
    }

    /// Direction of a pixel from the mirror's axis, in pixels along the robot's x and y.
    pub fn robot_direction_px(&self, u: f32, v: f32) -> [f32; 2] {
        let [[xu, yu], [xv, yv]] = self.image_from_robot();
        let (du, dv) = (u - self.centre_px[0], v - self.centre_px[1]);
        [xu * du + xv * dv, yu * du + yv * dv]
    }

    /// True where the mirror is in the image.
    pub fn sees_mirror(&self, u: f32, v: f32) -> bool {
        let radius = (u - self.centre_px[0]).hypot(v - self.centre_px[1]);
        self.outer_radius_px.is_none_or(|rim| radius <= rim)
    }
}

/// The pixels that show ground, and where it is.
fn ground(map: &GroundMap) -> impl Iterator<Item = ([f32; 2], [f32; 2])> {
    (0..map.height_px)
        .flat_map(move |row| (0..map.width_px).map(move |column| (column, row)))
        .filter_map(move |(column, row)| {
            let at = map.at(column, row)?;
            Some(([column as f32, row as f32], [at.x, at.y]))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(forward_deg: f32, flipped: bool) -> CameraConfig {
        CameraConfig {
            width_px: 480,
            height_px: 480,
            focal_px: None,
            centre_px: [240.0, 240.0],
            height: None,
            forward_deg,
            flipped,
            outer_radius_px: Some(200.0),
        }
    }

    fn assert_direction(found: [f32; 2], wanted: [f32; 2]) {
        assert!(
            (found[0] - wanted[0]).abs() < 1e-3 && (found[1] - wanted[1]).abs() < 1e-3,
            "{found:?} {wanted:?}"
        );
    }

    #[test]
    fn with_forward_up_a_flipped_camera_shows_left_on_the_right() {
        assert_direction(
            camera(90.0, true).robot_direction_px(250.0, 240.0),
            [0.0, 10.0],
        );
        assert_direction(
            camera(90.0, false).robot_direction_px(250.0, 240.0),
            [0.0, -10.0],
        );
        assert_direction(
            camera(90.0, true).robot_direction_px(240.0, 230.0),
            [10.0, 0.0],
        );
    }

    #[test]
    fn forward_right_unflipped_has_left_up() {
        assert_direction(
            camera(0.0, false).robot_direction_px(250.0, 240.0),
            [10.0, 0.0],
        );
        assert_direction(
            camera(0.0, false).robot_direction_px(240.0, 230.0),
            [0.0, 10.0],
        );
    }
}
