//! Settings of matching.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Method of minimisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Minimiser {
    /// Gauss-Newton on reweighted squares.
    #[default]
    GaussNewton,
    /// Resilient backpropagation: steps by the gradient's signs (nubot2013 4, minho2016 VI).
    Rprop,
}

/// Settings of matching.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MatchConfig {
    /// Method of minimisation.
    pub minimiser: Minimiser,
    /// Kernel scale c of e(t), in standard deviations of a point. Points beyond about c are outliers; a smaller value
    /// rejects more points.
    pub kernel_scale_sigmas: f32,
    /// Standard deviation added to that of each point, metres (errors of the painted markings and of the map).
    pub map_std: f32,
    /// Largest number of steps per image; RPROP needs about three times as many as Gauss-Newton.
    pub steps_max: usize,
    /// Step size below which the minimisation ends, metres and radians.
    pub convergence_step: f32,
    /// Standard deviation of the robot's tilt per axis, degrees, before images tell. 0 assumes an upright robot; real
    /// robots show 0.45 from image to image.
    pub tilt_std_deg: f32,
    /// Initial standard deviation of the logarithm of the learned variances of points and tilt (docs/methods.md 5.8): 1.2
    /// stands for a factor of 2 in their spread. 0 keeps the stated spread of points and `tilt_std_deg`.
    pub spread_learning_std: f32,
    /// Height of the viewpoint (the mirror) above the ground, metres. A tilt displaces points by their squared distance
    /// over this height.
    pub viewpoint_height: f32,
}

impl Default for MatchConfig {
    fn default() -> Self {
        MatchConfig {
            minimiser: Minimiser::default(),
            kernel_scale_sigmas: 3.0,
            map_std: 0.015,
            steps_max: 20,
            convergence_step: 2e-4,
            tilt_std_deg: 0.45,
            spread_learning_std: 1.2,
            viewpoint_height: crate::robot::DEFAULT_VIEWPOINT_HEIGHT,
        }
    }
}
