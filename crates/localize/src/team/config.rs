//! Settings of the team's ball fusion.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::{SettingError, TEAM_BOUNDS, check_bounds};
use crate::localizer::CooperativeConfig;

/// Fusion of shared observations among team-mates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TeamConfig {
    /// This robot's number in the team.
    pub number: u32,
    /// Largest number of team-mates; reports of further numbers are ignored. The team's `members` (network.toml) take the places of
    /// other numbers.
    pub teammates_max: usize,
    /// Largest age of a reported ball's last detection, seconds. Older balls are ignored.
    pub ball_age_max: f32,
    /// Time without a report after which a team-mate is removed, seconds.
    pub report_timeout: f32,
    /// Process noise of the ball's velocity, m/s per square root of a second.
    pub ball_acceleration_noise: f32,
    /// Standard deviation of a reported velocity, m/s.
    pub velocity_std: f32,
    /// Added in quadrature to each reported standard deviation, metres: the remaining calibration error.
    pub position_std_min: f32,
    /// Largest squared Mahalanobis distance of two balls that agree. The default is 99 % of 2 degrees of freedom.
    pub gate: f32,
    /// Largest change of the field half's log odds by one image. A smaller value decides later and more reliably.
    pub half_log_odds_max: f32,
    /// Correction of the pose by sightings between team-mates.
    pub cooperative: CooperativeConfig,
}

impl Default for TeamConfig {
    fn default() -> Self {
        TeamConfig {
            number: 1,
            teammates_max: 10,
            ball_age_max: 1.0,
            report_timeout: 5.0,
            ball_acceleration_noise: 1.0,
            velocity_std: 0.5,
            position_std_min: 0.05,
            gate: 9.2,
            // At 30 Hz the half is decided within half a second, and not by a single image.
            half_log_odds_max: 0.5,
            cooperative: CooperativeConfig::default(),
        }
    }
}

impl TeamConfig {
    /// Returns an error for the first invalid value.
    pub fn check(&self) -> Result<(), SettingError> {
        check_bounds("team", self, TEAM_BOUNDS)
    }
}
