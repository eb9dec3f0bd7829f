//! Where does the origin of the poses lie, as the wheels tell it? (docs/methods.md 2.13)
//!
//! Some errors of a map move all ground points alike, so images cannot tell them from another position of the robot. But the
//! robot turns about the centre of its wheels, and a pose beside it moves in turns.

use nalgebra::{Matrix2, SMatrix, Vector2};

use super::sums::{TermMatrix, TermVector};
use super::term::TERMS_MAX;
use crate::wheel_steps::OriginOffset;

/// Squared distance of the origin from the turning point, in standard deviations, from which the given map is wrong (99.9 % of χ² with
/// two degrees of freedom).
pub(super) const WRONG_ORIGIN_CHI_SQUARED: f64 = 13.8;

/// Share by which an image changes the mean over a drive.
const RATE: f64 = 0.1;

/// The origin's position by the unknowns.
type OriginByTerm = SMatrix<f64, 2, TERMS_MAX>;

/// The origin of the poses by the map in use, as the wheels tell it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct OriginByWheels {
    /// About the turning point, robot frame, metres.
    at: Vector2<f64>,
    information: Matrix2<f64>,
    /// Derivative of the origin by the unknowns: mean over the drive.
    by_term: OriginByTerm,
    /// Covariance by what differs from this mean, place by place, m².
    by_place: Matrix2<f64>,
}

impl OriginByWheels {
    /// Takes what the drive tells, at an image whose origin has this derivative by the unknowns, known to `covariance`.
    pub(super) fn update(
        &mut self,
        measured: &OriginOffset,
        by_term: OriginByTerm,
        covariance: &TermMatrix,
    ) {
        if self.by_term == OriginByTerm::zeros() {
            self.by_term = by_term;
        }
        let difference = by_term - self.by_term;
        self.by_term += difference * RATE;
        let by_place = difference * covariance * difference.transpose();
        self.by_place += (by_place - self.by_place) * RATE;
        self.at = measured.at.map(f64::from);
        let covariance = Matrix2::identity() * f64::from(measured.variance) + self.by_place;
        self.information = covariance.try_inverse().unwrap_or_else(Matrix2::zeros);
    }

    /// The map in use took a step.
    pub(super) fn shift(&mut self, step: &TermVector) {
        self.at += self.by_term * step;
    }

    /// The wheels do not tell the origin any more.
    pub(super) fn forget(&mut self) {
        self.information = Matrix2::zeros();
    }

    /// Does the origin lie beside the turning point beyond doubt?
    pub(super) fn is_contradicted(&self) -> bool {
        self.at.dot(&(self.information * self.at)) > WRONG_ORIGIN_CHI_SQUARED
    }

    /// Information about the unknowns.
    pub(super) fn information(&self) -> TermMatrix {
        self.by_term.transpose() * self.information * self.by_term
    }

    /// Gradient of the negative log likelihood at a step from the map in use.
    pub(super) fn gradient(&self, step: &TermVector) -> TermVector {
        self.by_term.transpose() * (self.information * (self.at + self.by_term * step))
    }
}
