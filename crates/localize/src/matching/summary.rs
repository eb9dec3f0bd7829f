//! Covariance and quality of a match (docs/methods.md 5.6, 5.7, 5.9).

use nalgebra::SMatrix;

use super::distance_field::DistanceField;
use super::normal_equations::NormalEquations;
use super::{Match, Matcher, Matrix5, PARAMETERS, Vector5, positive_inverse};
use crate::frames::Pose;

type Matrix5d = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Variance of a matched pose over that of independent residuals: a point is compared with the nearest marking, which is
/// not always its own, so that residuals understate errors (measured on synthetic drives, docs/methods.md 5.6).
const NEAREST_MARKING_SCALE: f32 = 1.1;

impl Matcher {
    /// Covariance and quality at the last state of a minimisation.
    pub(super) fn summarize(
        &self,
        sums: &NormalEquations,
        distances: &DistanceField,
        state: &Vector5,
        steps: usize,
    ) -> Match {
        let count = self.points.len().max(1) as f32;
        // Covariance of an M-estimator: (Σψ²/Σw) / (Σψ′/Σw)² · (Σ w J Jᵀ)⁻¹, corrected for the degrees of freedom of
        // the pose. It scales with the residual, whatever standard deviations the points state.
        let weight = sums.weight.max(1e-6);
        let freedom = (weight / (weight - 3.0).max(1.0)).max(1.0);
        let slope = (sums.psi_slope / weight).clamp(0.2, 1.0);
        let observed_scale = sums.psi_squared / weight / (slope * slope) * freedom;
        let [expected_scale, stated_weight] = self.spread.expected_scale();
        let scale = ((observed_scale * weight + expected_scale * stated_weight)
            / (weight + stated_weight))
            .clamp(0.1, 25.0);
        let variance_scale = scale * NEAREST_MARKING_SCALE * self.repetition;
        let difference = self.prior_difference(state);
        let prior = difference.information(&self.prior.information);
        let pose_tilt = well_determined_inverse(&(sums.normal / variance_scale + prior))
            .unwrap_or_else(|| {
                let pass = self.pass(state, 1.0);
                let points = pass.exact_normal(&self.lanes, distances);
                let prior = prior.map(f64::from);
                inverse_of(
                    &(points / f64::from(variance_scale) + prior),
                    &self.uninformative_prior().map(f64::from),
                )
            });
        let pose_tilt = (pose_tilt + pose_tilt.transpose()) * 0.5;
        let repetition = self.repeated.repetition();
        let deviation = difference.with_tilt([state[3], state[4]]);
        let kernel_squared = self.config.kernel_scale_sigmas * self.config.kernel_scale_sigmas;
        Match {
            pose: Pose::new(state[0], state[1], state[2]),
            covariance: pose_tilt.fixed_view::<3, 3>(0, 0).into_owned(),
            mahalanobis_squared: deviation.dot(&(self.prior.information * deviation)),
            tilt: [state[3], state[4]],
            pose_tilt_covariance: pose_tilt,
            repetition_ratio: self.repetition / repetition.image_factor(),
            repeated_factor: repetition.floor_factor() * scale / variance_scale,
            determined_parameters: PARAMETERS as f32 - (pose_tilt * prior).trace(),
            observed_scale,
            variance_scale,
            point_spread: self.spread_factor,
            inlier_rms: (sums.weighted_squares / weight).sqrt(),
            mean_distance: sums.distance_sum / count,
            inlier_share: sums.inliers / count,
            score: sums.score / count,
            cost: 0.5 * kernel_squared * (self.points.len() as f32 - sums.score),
            steps,
        }
    }
}

/// A parameter of which the others leave less than this share of its information is not told by a matrix in 32 bits.
const DETERMINED_MIN: f32 = 1e-4;

/// Inverse of an information matrix, if rounding does not matter.
fn well_determined_inverse(information: &Matrix5) -> Option<Matrix5> {
    let inverse = information.cholesky()?.inverse();
    // Of each parameter: its information alone over that given the others.
    let shares = (0..PARAMETERS).map(|k| 1.0 / (information[(k, k)] * inverse[(k, k)]));
    let well = shares.fold(f32::INFINITY, f32::min) > DETERMINED_MIN;
    well.then_some(inverse)
}

/// Inverse of a covariance of (x, y, θ, a, b). A heading that is not known makes it a million times longer than wide, and an inverse in
/// 32 bits would be no covariance's.
pub(crate) fn information_of(covariance: &Matrix5) -> Option<Matrix5> {
    let inverse = positive_inverse(&covariance.map(f64::from))?;
    Some(inverse.map(|value| value as f32))
}

/// Inverse of an information matrix to which `least` is added after rounding's negative parts are taken away.
fn inverse_of(information: &Matrix5d, least: &Matrix5d) -> Matrix5 {
    let scale = information.diagonal().map(|value| value.max(1e-12).sqrt());
    let scaling = Matrix5d::from_diagonal(&scale);
    let unscaling = Matrix5d::from_diagonal(&scale.map(|value| 1.0 / value));
    let mut parts = (unscaling * information * unscaling).symmetric_eigen();
    parts.eigenvalues.apply(|value| *value = value.max(0.0));
    let sum = scaling * parts.recompose() * scaling + least;
    let unknown = || Matrix5d::from_diagonal(&least.diagonal().map(|value| 1.0 / value));
    positive_inverse(&sum)
        .unwrap_or_else(unknown)
        .map(|value| value as f32)
}
