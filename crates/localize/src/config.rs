//! Which settings does localization have? One section per stage, each with defaults and reasons.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::advice::AdviceConfig;
use crate::filter::FilterConfig;
use crate::global_search::GlobalSearchConfig;
use crate::global_search::branch_and_bound::BranchAndBoundConfig;
use crate::map_correction::MapCorrectionConfig;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceFieldConfig;
use crate::sample::Compass;
use crate::sensors::attitude::AttitudeConfig;
use crate::sensors::compass_calibration::CompassCalibration;

mod bounds;
mod tables;

pub use bounds::{Bound, SettingError, bound, check_bounds, unbounded_settings};
pub use tables::{LOCALIZE_BOUNDS, TEAM_BOUNDS, WORLD_BOUNDS};

/// Settings of localization.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LocalizeConfig {
    /// Distance field: look-up of distances to markings.
    pub distance_field: DistanceFieldConfig,
    /// Matching of line points to markings near the predicted pose.
    pub matching: MatchConfig,
    /// Method of pose tracking from image to image.
    pub tracker: Tracker,
    /// Search for the pose on the whole field.
    pub global_search: GlobalSearchConfig,
    /// Exact global search: default for relocalization, and always the check of the tracked pose.
    pub branch_and_bound: BranchAndBoundConfig,
    /// Motions that tell ambiguous hypotheses apart.
    pub advice: AdviceConfig,
    /// Pose filter: odometry and sensor fusion.
    pub filter: FilterConfig,
    /// Inertial unit: tilt, gyro bias, standstill.
    pub attitude: AttitudeConfig,
    /// Conditions for a pose to be trusted, suspect or lost.
    pub mode: ModeConfig,
    /// Compass.
    pub compass: CompassConfig,
    /// Correction of the ground map while the robot drives.
    pub map_correction: MapCorrectionConfig,
}

/// Method of pose tracking from image to image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tracker {
    /// Line points are matched to the markings near the predicted pose; `matching.minimiser` selects the method.
    #[default]
    Matching,
    /// Best cell of the scan map within 4 m² around the predicted pose, with the heading from histograms (minho2016 IV,
    /// V.B).
    ScanMap,
    /// No tracking: each image is localized independently (lima2001).
    None,
}

/// Condition for a tracked pose to become suspect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SuspectRule {
    /// Another pose on the field explains clearly more points.
    #[default]
    Evidence,
    /// Mean deviation of the points and deviation from the compass both exceed their thresholds (nubot2013 4).
    Thresholds,
}

/// Conditions for a pose to be trusted, suspect or lost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ModeConfig {
    /// Condition for a tracked pose to become suspect.
    pub suspect_rule: SuspectRule,
    /// Rule `thresholds`: largest mean distance of the points from the markings, metres.
    pub mean_distance_max: f32,
    /// Rule `thresholds`: largest deviation of the heading from the compass, degrees.
    pub compass_deviation_max_deg: f32,
    /// Longest gap in odometry that still connects one image to the next, seconds (specified for recordings).
    pub odometry_gap_max: f64,
    /// Smallest number of line points for a pose measurement. With fewer, the pose is predicted from odometry.
    pub points_min: usize,
    /// Smallest number of inliers of a global pose. Six line segments of two points fit by chance.
    pub inliers_min: f32,
    /// Share of inliers below which a match is poor and the pose is checked by the global search at once. A larger
    /// value checks more often.
    pub inlier_share_min: f32,
    /// A match is also poor below this fraction of the mean share of inliers.
    pub inlier_share_drop_max: f32,
    /// Smallest share of inliers of a global pose. A larger value rejects more correct poses, a smaller one accepts
    /// more false poses.
    pub global_inlier_share_min: f32,
    /// Largest squared Mahalanobis distance of a match from the prediction: 99.9 % of 3 degrees of freedom. Beyond it,
    /// an unmeasured motion is assumed.
    pub normalized_innovation_max: f32,
    /// Largest displacement within one image interval that odometry missed and matching recovers, metres.
    pub unreported_motion_max: f32,
    /// Number of consecutive suspect images after which the pose is lost (nubot2013 4: five).
    pub suspect_frames_max: u32,
    /// Smallest additional share of points that an alternative global pose must explain to make the tracked pose
    /// suspect.
    pub alternative_margin_share: f32,
    /// Smallest additional number of points that an alternative must explain. A few points fit lines by chance.
    pub alternative_margin_points: f32,
    /// Time between checks of a trusted pose by the global search, seconds. 0 disables the checks.
    pub global_check_period: f64,
    /// Smallest probability of a hypothesis that is accepted. A larger value waits longer in ambiguous places.
    pub decision_probability: f32,
    /// Standard deviation of the position beyond which a pose without line points is lost, metres.
    pub lost_position_std: f32,
    /// Standard deviation of the heading beyond which a pose without line points is lost, degrees.
    pub lost_heading_std_deg: f32,
    /// Number of consecutive out-of-order samples after which the source's clock is assumed to have been set back.
    pub out_of_order_max: u32,
}

impl Default for ModeConfig {
    fn default() -> Self {
        ModeConfig {
            suspect_rule: SuspectRule::default(),
            mean_distance_max: 0.3,
            compass_deviation_max_deg: 30.0,
            odometry_gap_max: 1.0,
            points_min: 6,
            inliers_min: 12.0,
            inlier_share_min: 0.45,
            inlier_share_drop_max: 0.75,
            global_inlier_share_min: 0.4,
            normalized_innovation_max: 16.3,
            unreported_motion_max: 0.4,
            suspect_frames_max: 5,
            alternative_margin_share: 0.1,
            alternative_margin_points: 6.0,
            global_check_period: 1.0,
            decision_probability: 0.95,
            lost_position_std: 0.7,
            lost_heading_std_deg: 20.0,
            out_of_order_max: 5,
        }
    }
}

/// Compass. Motors and steel disturb it, so it decides the field half and not the heading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CompassConfig {
    /// Standard deviation of noise and slow bias together, degrees. A larger value reduces the evidence of a reading.
    pub std_deg: f32,
    /// Largest age of a reading that is used for an image, seconds.
    pub age_max: f64,
    /// Log odds from which the field half is known.
    pub half_known_log_odds: f32,
    /// Largest change of the log odds by one reading. It limits a temporary disturbance by a nearby magnet.
    pub reading_log_odds_max: f32,
    /// Largest log odds. At this value the field half is established; the limit allows a lasting contradiction to
    /// change it.
    pub log_odds_max: f32,
    /// Rotation over which the compass must follow the robot before it may change an established half, degrees. It
    /// exceeds the six `std_deg` that a stuck compass may appear to follow.
    pub verified_turn_deg: f32,
    /// Time constant that averages the noise of readings, seconds.
    pub smoothing_time: f32,
    /// Largest relative deviation of the magnetic field strength from the calibrated one. Beyond it, a nearby object
    /// disturbs the reading.
    pub strength_tolerance: f32,
    /// Conversion of the magnetic field to a heading (`calibrate compass`). `compass.calibration` of robot.toml has
    /// precedence. Without a calibration, the sensor's own heading is used.
    pub calibration: Option<CompassCalibration>,
}

impl CompassConfig {
    /// Heading of a reading, radians. None if the magnetic field is disturbed.
    pub fn heading(&self, sample: &Compass) -> Option<f32> {
        let Some((calibration, field)) = self.calibration.as_ref().zip(sample.magnetic_field)
        else {
            return sample.heading.is_finite().then_some(sample.heading);
        };
        let magnetic = calibration.heading(field);
        ((magnetic.relative_strength - 1.0).abs() <= self.strength_tolerance)
            .then_some(magnetic.heading)
    }
}

impl Default for CompassConfig {
    fn default() -> Self {
        CompassConfig {
            std_deg: 10.0,
            age_max: 0.5,
            half_known_log_odds: 2.0,
            reading_log_odds_max: 2.5,
            log_odds_max: 10.0,
            verified_turn_deg: 90.0,
            smoothing_time: 0.3,
            strength_tolerance: 0.2,
            calibration: None,
        }
    }
}

impl LocalizeConfig {
    /// Returns an error for the first invalid value.
    pub fn check(&self) -> Result<(), SettingError> {
        check_bounds("localize", self, LOCALIZE_BOUNDS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_a_zero_cell_is_refused() {
        for name in crate::presets::PRESETS {
            let config = LocalizeConfig::preset(name).expect("a preset");
            assert_eq!(config.check(), Ok(()));
        }
        let mut config = LocalizeConfig::default();
        config.branch_and_bound.cell = 0.0;
        let message = config.check().expect_err("no cells").to_string();
        assert!(
            message.starts_with("localize.branch_and_bound.cell = 0:"),
            "{message}"
        );
    }

    #[test]
    fn an_unknown_key_is_refused() {
        assert!(toml::from_str::<LocalizeConfig>("[branch_and_bound]\ncel = 0.1").is_err());
        assert!(toml::from_str::<LocalizeConfig>("[branch_and_bound]\ncell = 0.2").is_ok());
    }
}
