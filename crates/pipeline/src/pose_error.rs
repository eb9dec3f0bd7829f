//! How far is an estimate from the ground truth, and did it say so?

use localize::frames::wrap_angle;
use localize::math;
use nalgebra::{Matrix3, Vector3};

use crate::cycle::Cycle;

/// Error of an estimated pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PoseError {
    /// Estimate minus truth: x, y in metres (field frame), heading in radians.
    pub(crate) difference: Vector3<f64>,
    /// Squared normalised error eᵀ C⁻¹ e. None if the covariance is not positive.
    pub(crate) nees: Option<f64>,
}

impl PoseError {
    /// None without a pose or without ground truth.
    pub(crate) fn of(cycle: &Cycle) -> Option<Self> {
        let (estimate, truth) = (&cycle.estimate, cycle.inputs.truth.as_ref()?);
        let (pose, true_pose) = (estimate.pose?, truth.pose);
        let turn = f64::from(pose.theta) - f64::from(true_pose.theta);
        let difference = Vector3::new(
            f64::from(pose.x) - f64::from(true_pose.x),
            f64::from(pose.y) - f64::from(true_pose.y),
            f64::from(wrap_angle(turn as f32)),
        );
        Some(PoseError {
            difference,
            nees: normalized_square(difference, estimate.covariance.map(f64::from)),
        })
    }

    /// Error of the position, metres.
    pub(crate) fn distance(&self) -> f64 {
        math::hypot(self.difference.x, self.difference.y)
    }
}

fn normalized_square(error: Vector3<f64>, covariance: Matrix3<f64>) -> Option<f64> {
    // NaN is not positive, either.
    if !(covariance.determinant() > 0.0) {
        return None;
    }
    Some(error.dot(&covariance.lu().solve(&error)?))
}
