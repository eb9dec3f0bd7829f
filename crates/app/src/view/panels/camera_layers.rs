//! The layers that the camera panel can draw over its image.

use serde::{Deserialize, Serialize};

/// Layers drawn over the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct CameraLayers {
    /// Camera image.
    pub(crate) image: bool,
    /// Colour class of every pixel.
    pub(crate) classes: bool,
    /// Pixels that vision samples, in the colours of their classes.
    pub(crate) scan_pixels: bool,
    /// Line points.
    pub(crate) line_points: bool,
    /// Rejected line point candidates.
    pub(crate) rejected_candidates: bool,
    /// Ball.
    pub(crate) ball: bool,
    /// Robots.
    pub(crate) robots: bool,
    /// Goals and posts.
    pub(crate) goals: bool,
    /// Boundary of the carpet.
    pub(crate) carpet_end: bool,
    /// Virtual sensor windows.
    pub(crate) virtual_sensors: bool,
    /// Masked pixels, and pixels that show no ground.
    pub(crate) mask: bool,
    /// Field lines projected at the estimated pose.
    pub(crate) field_lines: bool,
    /// Range rings and bearing rays on the ground.
    pub(crate) grid: bool,
}

impl Default for CameraLayers {
    fn default() -> Self {
        CameraLayers {
            image: true,
            classes: false,
            scan_pixels: false,
            line_points: true,
            rejected_candidates: true,
            ball: true,
            robots: true,
            goals: true,
            carpet_end: false,
            virtual_sensors: false,
            mask: false,
            field_lines: true,
            grid: false,
        }
    }
}
