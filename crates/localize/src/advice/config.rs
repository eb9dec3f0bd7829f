//! Settings of the advice for ambiguous poses.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motions that tell ambiguous hypotheses apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AdviceConfig {
    /// True to compute advice while several hypotheses explain the images.
    pub enabled: bool,
    /// Range at which line points are expected, metres.
    pub view_range: f32,
    /// Longest displacement advised, metres.
    pub distance_max: f32,
    /// Smallest distance kept from the carpet's edge under both hypotheses, metres.
    pub edge_distance: f32,
    /// Speed by which motions are compared, m/s.
    pub speed: f32,
    /// Yaw rate by which motions are compared, degrees/s.
    pub turn_rate_deg: f32,
    /// Smallest expected gain of one image in log odds. With less, no motion is advised.
    pub log_odds_min: f32,
}

impl Default for AdviceConfig {
    fn default() -> Self {
        AdviceConfig {
            enabled: true,
            view_range: 5.0,
            distance_max: 4.0,
            edge_distance: 0.3,
            speed: 1.0,
            turn_rate_deg: 90.0,
            log_odds_min: 0.5,
        }
    }
}
