//! What may be set about sharing among team-mates? Who we are, how long a word counts, when balls agree.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::{SettingError, TEAM_BOUNDS, check_bounds};

/// Sharing among team-mates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TeamConfig {
    /// Our own number.
    pub number: u32,
    /// Most team-mates that are listened to: those beyond are strangers.
    pub teammates_max: usize,
    /// A ball that was not seen for so many seconds is not counted.
    pub ball_age_max: f32,
    /// A team-mate that was not heard for so many seconds is forgotten.
    pub report_timeout: f32,
    /// How the ball's velocity wanders when somebody touches it, m/s in a second.
    pub ball_acceleration_noise: f32,
    /// Error of a reported velocity, m/s.
    pub velocity_std: f32,
    /// Nobody knows the ball better than this, metres: what calibration leaves, whatever a robot claims.
    pub position_std_min: f32,
    /// Squared deviation of two balls in standard deviations up to which they agree: 99 % of 2 degrees of freedom.
    pub gate: f32,
    /// Most that one frame's ball says about the half of the field, log odds.
    pub half_log_odds_max: f32,
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
            // At 30 Hz the half is decided within half a second, and by no single frame.
            half_log_odds_max: 0.5,
        }
    }
}

impl TeamConfig {
    /// Refuses values that cannot work, and names the first.
    pub fn check(&self) -> Result<(), SettingError> {
        check_bounds("team", self, TEAM_BOUNDS)
    }
}
