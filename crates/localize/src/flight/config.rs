//! Settings of the ball in the air.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The ball in the air: one robot over time, and several robots together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FlightConfig {
    /// Radius of the ball, metres.
    pub ball_radius: f32,
    /// Deceleration by drag over the squared speed, 1/m: half the air's density times drag coefficient and cross-section
    /// over the mass.
    pub drag: f32,
    /// Deceleration of a rolling ball, m/s².
    pub rolling_deceleration: f32,
    /// Probability of an impact or a kick between two images at 30 images per second.
    pub change_probability: f32,
    /// Probability that the ball is in the air after an impact or a kick.
    pub airborne_probability: f32,
    /// Most competing paths that are followed. A larger value costs more time after kicks and impacts.
    pub hypotheses_max: usize,
    /// Time without a sighting after which the path is forgotten, seconds.
    pub gap_max: f32,
    /// Standard deviation of the errors that all rays of a robot share, degrees: tilt and mounting.
    pub bearing_bias_std_deg: f32,
    /// Time for which these errors, and those of a robot's pose, last, seconds.
    pub bearing_bias_time: f32,
    /// Error of a ray beyond which it is an outlier, standard deviations.
    pub outlier_sigmas: f32,
    /// Time for which late rays of several robots are put in their place, and over which it is judged who is wrong,
    /// seconds.
    pub team_window: f32,
    /// Standard deviation of the clocks of two robots, seconds.
    pub clock_std: f32,
}

impl Default for FlightConfig {
    fn default() -> Self {
        FlightConfig {
            ball_radius: 0.11,
            // A ball of 0.43 kg with a drag coefficient of 0.3.
            drag: 0.016,
            rolling_deceleration: 0.35,
            // A change every two seconds at 30 images per second.
            change_probability: 0.02,
            airborne_probability: 0.2,
            hypotheses_max: 12,
            gap_max: 0.5,
            bearing_bias_std_deg: 0.2,
            bearing_bias_time: 0.7,
            outlier_sigmas: 5.0,
            team_window: 0.25,
            clock_std: 0.003,
        }
    }
}
