//! Covariance and quality of a match (docs/methods.md 5.6, 5.7, 5.9).

use super::normal_equations::NormalEquations;
use super::{Match, Matcher, Matrix5, PARAMETERS, Vector5};
use crate::frames::Pose;

/// Variance of a matched pose over that of independent residuals: a point is compared with the nearest marking, which is
/// not always its own, so that residuals understate errors (measured on synthetic drives, docs/methods.md 5.6).
const NEAREST_MARKING_SCALE: f32 = 1.1;

impl Matcher {
    /// Covariance and quality at the last state of a minimisation.
    pub(super) fn summarize(&self, sums: &NormalEquations, state: &Vector5, steps: usize) -> Match {
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
        let normal = sums.normal / variance_scale + self.prior.information;
        let pose_tilt = normal.try_inverse().unwrap_or_else(|| {
            let information = self.uninformative_prior().diagonal();
            Matrix5::from_diagonal(&information.map(|value| 1.0 / value))
        });
        let pose_tilt = (pose_tilt + pose_tilt.transpose()) * 0.5;
        let repetition = self.repeated.repetition();
        let deviation = self.prior_residual(state);
        let kernel_squared = self.config.kernel_scale_sigmas * self.config.kernel_scale_sigmas;
        Match {
            pose: Pose::new(state[0], state[1], state[2]),
            covariance: pose_tilt.fixed_view::<3, 3>(0, 0).into_owned(),
            mahalanobis_squared: deviation.dot(&(self.prior.information * deviation)),
            tilt: [state[3], state[4]],
            pose_tilt_covariance: pose_tilt,
            repetition_ratio: self.repetition / repetition.image_factor(),
            repeated_factor: repetition.floor_factor() * scale / variance_scale,
            determined_parameters: PARAMETERS as f32 - (pose_tilt * self.prior.information).trace(),
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
