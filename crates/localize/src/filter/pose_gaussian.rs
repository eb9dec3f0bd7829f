//! Gaussians of poses, with headings on the circle: fusion, and the measurement contained in a posterior.

use nalgebra::{Matrix3, Vector3};

use crate::frames::Pose;
use crate::matching::Matrix5;

/// Posterior of pose and tilt after an image.
#[derive(Debug, Clone, Copy)]
pub(super) struct PosePosterior {
    pub(super) pose: Pose,
    /// Tilt (a, b) beyond the expected one, radians.
    pub(super) tilt: [f32; 2],
    /// Of (x, y, θ, a, b).
    pub(super) covariance: Matrix5,
}

/// A pose measured independently of the prediction.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseMeasurement {
    pub(super) pose: Pose,
    /// Of (x, y, θ).
    pub(super) covariance: Matrix3<f32>,
}

/// `pose` plus a difference in (x, y, θ), the inverse of [`Pose::difference`].
pub(super) fn retract(pose: Pose, step: &Vector3<f32>) -> Pose {
    Pose::new(pose.x + step[0], pose.y + step[1], pose.theta + step[2])
}

/// Kalman update of a predicted pose and tilt by a pose measurement. None if S is singular.
///
/// `predicted_covariance`: of (x, y, θ, a, b).
pub(super) fn kalman_update(
    predicted: Pose,
    predicted_covariance: &Matrix5,
    measurement: &PoseMeasurement,
) -> Option<PosePosterior> {
    let cross = predicted_covariance.fixed_columns::<3>(0);
    let gain = cross * (cross.fixed_rows::<3>(0) + measurement.covariance).try_inverse()?;
    let posterior = predicted_covariance - gain * cross.transpose();
    let step = gain * measurement.pose.difference(predicted);
    Some(PosePosterior {
        pose: retract(predicted, &step.fixed_rows::<3>(0).into_owned()),
        tilt: [step[3], step[4]],
        covariance: (posterior + posterior.transpose()) * 0.5,
    })
}

/// The measurement that took a prediction to `posterior`. None if it carried no information.
pub(super) fn recover_measurement(
    predicted: Pose,
    predicted_covariance: &Matrix3<f32>,
    posterior: &PoseMeasurement,
) -> Option<PoseMeasurement> {
    let before = predicted_covariance.try_inverse()?;
    let after = posterior.covariance.try_inverse()?;
    // A thousandth of the prior's information remains, so that directions without measurement stay invertible.
    let covariance = (after - before * 0.999).try_inverse()?;
    if !covariance.diagonal().iter().all(|variance| *variance > 0.0) {
        return None;
    }
    let step = covariance * after * posterior.pose.difference(predicted);
    Some(PoseMeasurement {
        pose: retract(predicted, &step),
        covariance: (covariance + covariance.transpose()) * 0.5,
    })
}
