//! What the field panel shows.

use serde::{Deserialize, Serialize};

/// Background of the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) enum FieldBackground {
    /// Plain carpet.
    #[default]
    Carpet,
    /// Distance to the nearest marking.
    DistanceField,
    /// Mean distance of the cycle's line points to the markings, over assumed robot positions.
    ErrorLandscape,
}

/// Visible layers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct FieldLayers {
    pub(crate) background: FieldBackground,
    pub(crate) line_points: bool,
    pub(crate) trail: bool,
    pub(crate) truth: bool,
    pub(crate) covariance: bool,
    pub(crate) hypotheses: bool,
    pub(crate) particles: bool,
    pub(crate) objects: bool,
    pub(crate) recomputed: bool,
    /// Length of the trail, seconds.
    pub(crate) trail_s: f64,
}

impl Default for FieldLayers {
    fn default() -> Self {
        FieldLayers {
            background: FieldBackground::Carpet,
            line_points: true,
            trail: true,
            truth: true,
            covariance: true,
            hypotheses: true,
            particles: true,
            objects: true,
            recomputed: true,
            trail_s: 10.0,
        }
    }
}
