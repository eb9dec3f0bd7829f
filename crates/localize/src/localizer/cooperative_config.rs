//! Settings of the pose correction by team-mates.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Correction of the pose by sightings between team-mates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CooperativeConfig {
    /// Correct the pose by team-mates.
    pub enabled: bool,
    /// Markings determine a pose whose position has at most this standard deviation without errors that repeat, metres.
    pub determined_std_max: f32,
    /// Time without markings that determine the pose after which team-mates correct it, seconds.
    pub needed_after: f32,
    /// Team-mates correct a pose whose position has at least this standard deviation, metres. A larger value relies longer
    /// on dead reckoning.
    pub own_std_min: f32,
    /// Largest standard deviation of a position that team-mates correct, metres. A larger one may take another robot for this
    /// one.
    pub own_std_max: f32,
    /// Largest standard deviation of the position of a robot that corrects others, metres.
    pub helper_std_max: f32,
    /// Time for which a corrected robot must track the markings before it corrects others, seconds.
    pub independent_after: f32,
    /// Added in quadrature to each standard deviation of a sighting, metres: the remaining calibration error.
    pub position_std_min: f32,
    /// Time for which the errors of a team-mate and of a sighting last, seconds.
    pub error_time: f32,
    /// Standard deviation of the clocks of two robots, seconds.
    pub clock_std: f32,
    /// Largest age of a sighting, seconds.
    pub delay_max: f32,
    /// Largest squared Mahalanobis distance of a sighting. The default is 99.9 % of 2 degrees of freedom.
    pub gate: f32,
    /// Time for which most team-mates must contradict the pose until it counts as less certain, seconds.
    pub doubt_after: f32,
    /// A sighting is ambiguous if another robot explains it with a squared Mahalanobis distance that is larger by less
    /// than this.
    pub ambiguity_margin: f32,
}

impl Default for CooperativeConfig {
    fn default() -> Self {
        CooperativeConfig {
            enabled: true,
            determined_std_max: 0.05,
            needed_after: 1.0,
            own_std_min: 0.01,
            own_std_max: 0.5,
            helper_std_max: 0.1,
            independent_after: 2.0,
            position_std_min: 0.05,
            error_time: 5.0,
            // Half of the difference of a delay there and back.
            clock_std: 0.01,
            delay_max: 0.3,
            gate: 13.8,
            doubt_after: 0.7,
            ambiguity_margin: 9.0,
        }
    }
}
