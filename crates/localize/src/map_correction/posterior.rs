//! The belief after some images, and how well it explains them.

use super::sums::{TermMatrix, TermVector};
use crate::math;

/// The belief after some images.
pub(super) struct Posterior {
    pub(super) covariance: TermMatrix,
    pub(super) step: TermVector,
    /// Log likelihood of the images up to a constant.
    pub(super) log_evidence: f64,
}

impl Posterior {
    /// Σ' = (1 + Σ I)⁻¹ Σ, step = −Σ' g. Unused unknowns have no variance and stay zero.
    pub(super) fn new(
        covariance: &TermMatrix,
        information: &TermMatrix,
        gradient: &TermVector,
    ) -> Option<Self> {
        let factor = TermMatrix::identity() + covariance * information;
        let lu = factor.lu();
        let posterior = lu.solve(covariance)?;
        let posterior = (posterior + posterior.transpose()) * 0.5;
        let step = -(posterior * gradient);
        let determinant = lu.determinant();
        if !(determinant > 0.0 && step.iter().all(|value| value.is_finite())) {
            return None;
        }
        Some(Posterior {
            covariance: posterior,
            log_evidence: -0.5 * gradient.dot(&step) - 0.5 * math::ln(determinant),
            step,
        })
    }
}
