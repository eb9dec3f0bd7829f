//! Settings of the map correction.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Correction of the ground map from the line points of all images (docs/methods.md 2.13).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MapCorrectionConfig {
    /// Learns the errors of the camera's map while the robot drives. False takes the map as it is.
    pub enabled: bool,
    /// Learns smooth errors of line points that come without a map, too. Points of a short range then carry errors that
    /// look like those of a map.
    pub points_without_map: bool,
    /// Standard deviation of the origin of a calibrated or corrected map from the robot's centre, per axis, metres: line
    /// points cannot tell it. 6 mm is a rig tilted by 0.45° with its mirror at 0.75 m. `[map] origin_std` of robot.toml
    /// replaces it.
    pub origin_std: f32,
    /// Standard deviation of the mirror's tilt against the camera before anything was seen, per axis, degrees.
    pub mirror_tilt_std_deg: f32,
    /// Standard deviation of the offset of the mirror's axis from the camera's, per axis, metres.
    pub mirror_offset_std: f32,
    /// Standard deviation of the focal length, relative.
    pub focal_std: f32,
    /// Standard deviation of the viewpoint's height, metres.
    pub height_std: f32,
    /// Standard deviation of the smooth errors of a map whose mirror profile is unknown, as a share of the range.
    pub smooth_std: f32,
    /// Time in which a map that nobody knocks becomes as uncertain as a new one, seconds.
    pub drift_time: f32,
    /// Share of the points' information that is used, since errors of neighbouring points are alike.
    pub information_share: f32,
    /// Smallest distance between two images that count as independent, metres. Images of a robot at rest repeat their
    /// errors.
    pub step_distance: f32,
    /// Smallest turn between two such images, degrees.
    pub step_turn_deg: f32,
    /// Log likelihood ratio from which the camera counts as knocked. A larger value notices later and is seldom wrong.
    pub knock_log_odds: f32,
    /// Time between two tests for a large knock, seconds.
    pub knock_check_period: f64,
}

impl Default for MapCorrectionConfig {
    fn default() -> Self {
        MapCorrectionConfig {
            enabled: true,
            points_without_map: false,
            origin_std: 0.006,
            mirror_tilt_std_deg: 0.3,
            mirror_offset_std: 0.001,
            focal_std: 0.01,
            height_std: 0.005,
            smooth_std: 0.005,
            drift_time: 3600.0,
            information_share: 1.0,
            step_distance: 0.1,
            step_turn_deg: 4.0,
            knock_log_odds: 12.0,
            knock_check_period: 0.3,
        }
    }
}
