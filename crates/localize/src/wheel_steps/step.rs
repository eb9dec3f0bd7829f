//! A motion by the wheels and by the poses, and how errors of such steps count in robust fits.

use crate::frames::{RobotFrame, Tf};

/// Fewer steps fit anything.
pub(super) const STEPS_MIN: usize = 6;
/// Expected errors of a step between two poses: metres, radians.
pub const STEP_STD: (f32, f32) = (0.03, 0.04);
/// Passes of the reweighted fit.
pub(super) const PASSES: usize = 8;

/// One motion, measured twice, in the robot frame at its start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredStep {
    /// By the wheels.
    pub wheels: Tf<RobotFrame, RobotFrame>,
    /// Between the poses that the line points give.
    pub poses: Tf<RobotFrame, RobotFrame>,
}

/// Standard deviation of errors by their median, so that outliers do not count.
pub fn spread(errors: &[f32]) -> f32 {
    if errors.is_empty() {
        return 0.0;
    }
    let mut errors = errors.to_vec();
    let middle = errors.len() / 2;
    1.2 * *errors.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Weight of an error in standard deviations: an outlier has next to none.
pub fn weight(deviation: f32) -> f32 {
    (1.0 + (deviation / 2.0).powi(2)).powi(-2)
}
