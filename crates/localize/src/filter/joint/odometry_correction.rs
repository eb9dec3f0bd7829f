//! Which linear map takes the motion that the wheels report to the true one? (docs/methods.md 8.5)
//!
//! Wheels of unequal radius, a base radius or a forward direction that is a little off: each is a linear error of the
//! measured motion (x, y, θ). A 3 × 3 matrix covers them all, also for a base whose geometry is not known.

use super::state::{Covariance, ODOMETRY_CORRECTION, State};
use crate::filter::FilterConfig;

/// Index of the correction's entry in row `i` and column `j`.
pub(super) const fn entry(i: usize, j: usize) -> usize {
    ODOMETRY_CORRECTION + 3 * i + j
}

/// Distance of the wheels from the centre that relates errors of rotation to errors of translation, metres.
const BASE_RADIUS: f32 = 0.25;
/// Scale of an entry: 1, m/rad or rad/m.
pub(super) fn entry_scale(i: usize, j: usize) -> f32 {
    match (i, j) {
        (2, 0 | 1) => 1.0 / BASE_RADIUS,
        (0 | 1, 2) => BASE_RADIUS,
        _ => 1.0,
    }
}

/// Standard deviation of an entry in its unit at the start. 0 if the correction is not estimated.
fn initial_std(i: usize, j: usize, config: &FilterConfig) -> f32 {
    if i == j {
        config.odometry_scale_std
    } else if config.odometry_scale_std > 0.0 {
        config.odometry_coupling_std
    } else {
        0.0
    }
}

/// Sets the identity with its initial uncertainty. The scales along x and y are alike up to the coupling's size.
pub(super) fn initialize(state: &mut State, covariance: &mut Covariance, config: &FilterConfig) {
    for i in 0..3 {
        for j in 0..3 {
            let std = initial_std(i, j, config) * entry_scale(i, j);
            state[entry(i, j)] = f32::from(u8::from(i == j));
            covariance[entry(i, j)][entry(i, j)] = std * std;
        }
    }
    let (scale, coupling) = (initial_std(0, 0, config), initial_std(0, 1, config));
    let common = (scale * scale - coupling * coupling).max(0.0);
    covariance[entry(0, 0)][entry(1, 1)] = common;
    covariance[entry(1, 1)][entry(0, 0)] = common;
}
