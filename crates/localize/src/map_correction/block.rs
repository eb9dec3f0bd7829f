//! Do many images together show a small knock?

use super::posterior::Posterior;
use super::sums::{TermMatrix, TermVector};

/// Independent images between two tests for a small knock.
pub(super) const BLOCK_IMAGES: u32 = 20;

/// Images since the last test for a small knock.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// The belief at its start.
    pub(super) coefficients: TermVector,
    pub(super) covariance: TermMatrix,
    /// Of all its images, at those coefficients.
    pub(super) information: TermMatrix,
    pub(super) gradient: TermVector,
    pub(super) images: u32,
}

impl Block {
    pub(super) fn new(coefficients: TermVector, covariance: TermMatrix) -> Self {
        Block {
            coefficients,
            covariance,
            information: TermMatrix::zeros(),
            gradient: TermVector::zeros(),
            images: 0,
        }
    }

    /// `gradient`: at the coefficients `at`.
    pub(super) fn add(&mut self, information: &TermMatrix, gradient: &TermVector, at: &TermVector) {
        self.gradient += gradient - information * (at - self.coefficients);
        self.information += information;
        self.images += 1;
    }

    /// Do the images prefer a knock within the block by `log_odds_min`?
    pub(super) fn is_knocked(&self, prior: &TermMatrix, log_odds_min: f64) -> bool {
        let evidence = |covariance: &TermMatrix| {
            Posterior::new(covariance, &self.information, &self.gradient)
                .map(|posterior| posterior.log_evidence)
        };
        let (calm, knocked) = (
            evidence(&self.covariance),
            evidence(&(self.covariance + prior)),
        );
        calm.zip(knocked)
            .is_some_and(|(calm, knocked)| knocked - calm > log_odds_min)
    }
}
