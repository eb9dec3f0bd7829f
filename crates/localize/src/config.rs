//! What may be set about finding a place? One section per stage, each with its defaults and reasons.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::filter::FilterConfig;
use crate::global_search::GlobalSearchConfig;
use crate::global_search::branch_and_bound::BranchAndBoundConfig;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceFieldConfig;
use crate::sample::Compass;
use crate::sensors::attitude::AttitudeConfig;
use crate::sensors::compass_calibration::CompassCalibration;

mod bounds;
mod tables;

pub use bounds::{Bound, SettingError, bound, check_bounds, unbounded_settings};
pub use tables::{LOCALIZE_BOUNDS, TEAM_BOUNDS, WORLD_BOUNDS};

/// Everything about localisation.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LocalizeConfig {
    /// The look-up of distances to markings.
    pub distance_field: DistanceFieldConfig,
    /// Tracking: line points onto markings near an expected pose.
    pub matching: MatchConfig,
    /// What follows the pose from frame to frame.
    pub tracker: Tracker,
    /// Who looks for the pose on the whole field.
    pub global_search: GlobalSearchConfig,
    /// The exact search: relocalisation by default, and in any case the check on what is tracked.
    pub branch_and_bound: BranchAndBoundConfig,
    /// Odometry and fusion.
    pub filter: FilterConfig,
    /// The inertial unit: lean, gyro bias, rest.
    pub attitude: AttitudeConfig,
    /// When a pose is trusted, suspected, given up.
    pub mode: ModeConfig,
    /// The compass.
    pub compass: CompassConfig,
}

/// What follows the pose from frame to frame?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tracker {
    /// Line points matched to the markings near the expected pose (`matching.minimiser` says how).
    #[default]
    Matching,
    /// The best cell of the scan map in 4 m² about the expected pose, heading from histograms (minho2016 IV, V.B).
    ScanMap,
    /// Nothing: every frame is relocated by itself (lima2001).
    None,
}

/// What makes a tracked pose suspect?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SuspectRule {
    /// Another pose of the whole field explains clearly more points.
    #[default]
    Evidence,
    /// Mean deviation of the points and deviation from the compass both above thresholds (nubot2013 4).
    Thresholds,
}

/// When is a pose trusted, suspected, given up?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ModeConfig {
    /// What makes a tracked pose suspect.
    pub suspect_rule: SuspectRule,
    /// Rule `thresholds`: mean deviation of the points, metres.
    pub mean_distance_max: f32,
    /// Rule `thresholds`: deviation of the heading from the compass, degrees.
    pub compass_deviation_max_deg: f32,
    /// Longest time without odometry that leads from one frame to the next, seconds (the recording's contract).
    pub odometry_gap_max: f64,
    /// Fewer line points than this say nothing about a pose.
    pub points_min: usize,
    /// Fewer inliers than this found no pose on the whole field: six line segments of two points fit by chance.
    pub inliers_min: f32,
    /// Share of inliers below which a tracked pose is suspected at once.
    pub inlier_share_min: f32,
    /// Suspected too when the share falls below this part of the usual one.
    pub inlier_share_drop_max: f32,
    /// Share of inliers below which a pose of the global search is no find.
    pub global_inlier_share_min: f32,
    /// Squared deviation of the match from the prediction, in standard deviations, beyond which something unreported moved the
    /// robot: 99.9 % of 3 degrees of freedom.
    pub normalized_innovation_max: f32,
    /// How far a push that odometry missed carries the robot within a frame and is still followed, metres.
    pub unreported_motion_max: f32,
    /// Suspect frames in a row after which the pose is given up (nubot2013 4: five).
    pub suspect_frames_max: u32,
    /// A rival of the global search must explain this share of the points more than the tracked pose.
    pub alternative_margin_share: f32,
    /// It must also explain this many points more: a few points lie on some lines by chance.
    pub alternative_margin_points: f32,
    /// Seconds between checks of an unsuspected pose against the global search; 0 never checks.
    pub global_check_period: f64,
    /// Probability among the hypotheses from which on one is taken.
    pub decision_probability: f32,
    /// Position uncertainty at which a pose that nothing was seen of is given up, metres.
    pub lost_position_std: f32,
    /// The same for the heading, degrees.
    pub lost_heading_std_deg: f32,
    /// Samples in a row from the past after which the source's clock is taken to have been set back.
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

/// What is a compass good for among motors and steel? For deciding the half turn, not for a heading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CompassConfig {
    /// Noise and slow bias together, degrees.
    pub std_deg: f32,
    /// A reading older than this says nothing about a frame, seconds.
    pub age_max: f64,
    /// Evidence (log odds) from which on the half is known.
    pub half_known_log_odds: f32,
    /// Most evidence one reading gives: a magnet beside the robot lies for a while.
    pub reading_log_odds_max: f32,
    /// Most evidence kept, so that a lasting contradiction is heard; from there on the half is well established.
    pub log_odds_max: f32,
    /// A compass lives that kept its deviation while the robot turned this far, degrees; only such a one may overturn a
    /// half that is well established. More than three deviations to each side, which a stuck one may seem to keep.
    pub verified_turn_deg: f32,
    /// A reading's noise averages out in this time, seconds.
    pub smoothing_time: f32,
    /// A magnetic field that is stronger or weaker than the usual by this share is that of something nearby.
    pub strength_tolerance: f32,
    /// What makes a heading of the magnetic field where the sensor gives one (`calibrate compass`); robot.toml's
    /// `compass.calibration` stands before it. Without any the sensor's own heading is taken.
    pub calibration: Option<CompassCalibration>,
}

impl CompassConfig {
    /// The heading that a reading means, radians; none if something nearby disturbs it.
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
    /// Refuses values that cannot work, and names the first. To be called on what a user wrote.
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
