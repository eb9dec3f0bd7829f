//! The pinhole camera and its mount, as in robot.toml.

use serde::{Deserialize, Serialize};

use crate::math;

/// `[camera]` of robot.toml.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Image width, pixels.
    pub width_px: usize,
    /// Image height, pixels.
    pub height_px: usize,
    /// Focal length, pixels. Required to trace a mirror profile, unused with a map.
    pub focal_px: Option<f32>,
    /// The mirror axis in the image (u right, v down), pixels; integers are pixel centres.
    #[serde(deserialize_with = "crate::fixed_array::deserialize")]
    pub centre_px: [f32; 2],
    /// Height of the pinhole above the ground, metres. Required to trace a mirror profile.
    pub height: Option<f32>,
    /// Direction of the robot's x axis in the image: degrees from image right towards image up.
    pub forward_deg: f32,
    /// True if the robot's left appears on the right of an image with forward up (a camera below one mirror).
    pub flipped: bool,
    /// Radius of the mirror's rim in the image, pixels. Pixels beyond it are unused.
    pub outer_radius_px: Option<f32>,
}

/// `[camera]` of robot.toml as written: a camera that is not calibrated yet has a size only.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSection {
    /// Image width, pixels.
    pub width_px: usize,
    /// Image height, pixels.
    pub height_px: usize,
    /// Focal length, pixels. Required to trace a mirror profile, unused with a map.
    pub focal_px: Option<f32>,
    /// The mirror axis in the image (u right, v down), pixels; integers are pixel centres. Absent: that of the calibrated
    /// map.
    #[serde(default, deserialize_with = "optional_pair")]
    pub centre_px: Option<[f32; 2]>,
    /// Height of the pinhole above the ground, metres. Required to trace a mirror profile.
    pub height: Option<f32>,
    /// Direction of the robot's x axis in the image: degrees from image right towards image up.
    #[serde(default = "forward_up_deg")]
    pub forward_deg: f32,
    /// True if the robot's left appears on the right of an image with forward up (a camera below one mirror).
    #[serde(default = "one_mirror")]
    pub flipped: bool,
    /// Radius of the mirror's rim in the image, pixels. Pixels beyond it are unused.
    pub outer_radius_px: Option<f32>,
}

fn optional_pair<'de, D: serde::Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<[f32; 2]>, D::Error> {
    crate::fixed_array::deserialize(deserializer).map(Some)
}

fn forward_up_deg() -> f32 {
    90.0
}

fn one_mirror() -> bool {
    true
}

impl CameraSection {
    /// The camera, if the mirror's axis is known.
    pub fn camera(&self) -> Option<CameraConfig> {
        Some(self.with_axis(self.centre_px?, self.outer_radius_px))
    }

    /// The camera with this axis and rim.
    pub fn with_axis(&self, centre_px: [f32; 2], outer_radius_px: Option<f32>) -> CameraConfig {
        CameraConfig {
            width_px: self.width_px,
            height_px: self.height_px,
            focal_px: self.focal_px,
            centre_px,
            height: self.height,
            forward_deg: self.forward_deg,
            flipped: self.flipped,
            outer_radius_px,
        }
    }
}

impl From<CameraConfig> for CameraSection {
    fn from(camera: CameraConfig) -> Self {
        CameraSection {
            width_px: camera.width_px,
            height_px: camera.height_px,
            focal_px: camera.focal_px,
            centre_px: Some(camera.centre_px),
            height: camera.height,
            forward_deg: camera.forward_deg,
            flipped: camera.flipped,
            outer_radius_px: camera.outer_radius_px,
        }
    }
}

impl CameraConfig {
    /// The image direction (pixels right, pixels down) of a step along the robot's (x, y).
    ///
    /// Row-major 2 × 2 orthogonal matrix; its determinant is −1 for an unflipped mount, since v points down.
    pub fn image_from_robot(&self) -> [[f32; 2]; 2] {
        let (sin, cos) = math::sin_cos(self.forward_deg.to_radians());
        let side = if self.flipped { -1.0 } else { 1.0 };
        // Forward is (cos, sin) in (right, up). Left is 90° from it, in the opposite direction if flipped.
        [[cos, -side * sin], [-sin, -side * cos]]
    }

    /// Direction of a pixel from the mirror's axis, in pixels along the robot's x and y.
    pub fn robot_direction_px(&self, u: f32, v: f32) -> [f32; 2] {
        let [[xu, yu], [xv, yv]] = self.image_from_robot();
        let (du, dv) = (u - self.centre_px[0], v - self.centre_px[1]);
        [xu * du + xv * dv, yu * du + yv * dv]
    }

    /// True if the pixel is inside the mirror's rim.
    pub fn is_inside_mirror(&self, u: f32, v: f32) -> bool {
        let radius = math::hypot(u - self.centre_px[0], v - self.centre_px[1]);
        self.outer_radius_px.is_none_or(|rim| radius <= rim)
    }
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
    fn flipped_camera_facing_up_maps_left_to_image_right() {
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
    fn unflipped_camera_facing_right_maps_left_to_image_up() {
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
