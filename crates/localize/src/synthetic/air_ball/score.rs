//! Sums of what an experiment with a ball in the air measures.

use serde::Serialize;

use crate::flight::BallMotionState;

/// 95 % of a χ² distribution with three degrees of freedom are below this.
const NEES_95: f64 = 7.815;

/// Sums over one or more seeds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct AirScore {
    /// Scored images.
    pub images: usize,
    /// Those in which the ball was in the air by more than its radius.
    pub airborne: usize,
    /// Of these, called airborne.
    pub airborne_found: usize,
    /// Images of a ball on the ground that is called airborne.
    pub false_alarms: usize,
    /// Images of a ball on the ground.
    pub on_ground: usize,
    /// Images in which the most probable place is off by half a metre and three standard deviations, over the ground.
    pub misplaced: usize,
    /// Sum of errors of the position, and number.
    pub error_sum: f64,
    /// Errors summed.
    pub errors: usize,
    /// Sum of the normalized estimation errors squared (3 is honest).
    pub nees_sum: f64,
    /// Errors within the ellipsoid that should contain 95 % of them.
    pub covered: usize,
    /// Sum of errors of the predicted landing point a quarter of a second ahead or more, and number.
    pub landing_sum: f64,
    /// Landings summed.
    pub landings: usize,
    /// Images with a faulty robot, and those in which it alone is named.
    pub faulty_images: usize,
    /// Images in which the faulty robot alone is named.
    pub faulty_named: usize,
}

impl AirScore {
    /// Mean error of the position, metres.
    pub fn error(&self) -> Option<f64> {
        (self.errors > 0).then(|| self.error_sum / self.errors as f64)
    }

    /// Mean normalized estimation error squared; 3 is honest.
    pub fn nees(&self) -> Option<f64> {
        (self.errors > 0).then(|| self.nees_sum / self.errors as f64)
    }

    /// Mean error of the landing point, metres.
    pub fn landing_error(&self) -> Option<f64> {
        (self.landings > 0).then(|| self.landing_sum / self.landings as f64)
    }

    /// Counts a stated place that is far from the true one and does not say so.
    pub(super) fn add_place(&mut self, state: &BallMotionState, truth: [f64; 3]) {
        let off = nalgebra::Vector2::from_fn(|axis, _| state.state[axis] - truth[axis]);
        let covariance = state.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let Some(inverse) = covariance.try_inverse() else {
            return;
        };
        let squared_sigmas = (off.transpose() * inverse * off).x;
        self.misplaced += usize::from(off.norm() > 0.5 && squared_sigmas > 9.0);
    }

    pub(super) fn add_error(&mut self, state: &BallMotionState, truth: [f64; 3]) {
        let off = nalgebra::Vector3::from_fn(|axis, _| state.state[axis] - truth[axis]);
        let covariance = state.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        // What the kind of motion fixes has no variance of its own: a millimetre.
        let covariance = covariance + nalgebra::Matrix3::identity() * 1e-6;
        if let Some(inverse) = covariance.try_inverse() {
            let nees = (off.transpose() * inverse * off).x;
            self.nees_sum += nees;
            self.covered += usize::from(nees < NEES_95);
            self.error_sum += off.norm();
            self.errors += 1;
        }
    }
}
