//! What does a sight say by itself, and what together with an expectation? Gaussians of poses, headings on the circle.

use nalgebra::{Matrix3, Vector3};

use super::FilterConfig;
use crate::frames::{Pose, wrap_angle};
use crate::matching::Matrix5;

/// What is believed of pose and lean after a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct PosePosterior {
    pub(super) pose: Pose,
    /// Beyond the lean that was expected, radians.
    pub(super) lean: [f32; 2],
    /// Of (x, y, θ, a, b).
    pub(super) covariance: Matrix5,
}

/// From the expected pose to another.
pub(super) fn innovation(expected: Pose, pose: Pose) -> Vector3<f32> {
    Vector3::new(
        pose.x - expected.x,
        pose.y - expected.y,
        wrap_angle(pose.theta - expected.theta),
    )
}

/// The pose so far from another.
pub(super) fn retract(pose: Pose, step: &Vector3<f32>) -> Pose {
    Pose::new(pose.x + step[0], pose.y + step[1], pose.theta + step[2])
}

/// Expectation (with its covariance of pose and lean) and a sight of the pose independent of it, together.
pub(super) fn kalman_update(
    expected: Pose,
    covariance: &Matrix5,
    pose: Pose,
    sight: &Matrix3<f32>,
) -> Option<PosePosterior> {
    let with = covariance.fixed_columns::<3>(0);
    let gain = with * (with.fixed_rows::<3>(0) + sight).try_inverse()?;
    let left = covariance - gain * with.transpose();
    let step = gain * innovation(expected, pose);
    Some(PosePosterior {
        pose: retract(expected, &step.fixed_rows::<3>(0).into_owned()),
        lean: [step[3], step[4]],
        covariance: (left + left.transpose()) * 0.5,
    })
}

/// The sight alone, given what became of an expectation by it; none where it said nothing.
pub(super) fn recover_measurement(
    expected: Pose,
    covariance: &Matrix3<f32>,
    found: Pose,
    left: &Matrix3<f32>,
) -> Option<(Pose, Matrix3<f32>)> {
    // Directions that the sight left free keep a little of the expectation's information, so that it can be inverted.
    let before = covariance.try_inverse()?;
    let after = left.try_inverse()?;
    let sight = (after - before * 0.999).try_inverse()?;
    if !sight.diagonal().iter().all(|variance| *variance > 0.0) {
        return None;
    }
    let step = sight * after * innovation(expected, found);
    Some((retract(expected, &step), (sight + sight.transpose()) * 0.5))
}

/// What frame after frame repeats of a sight's error.
pub(super) fn systematic_covariance(config: &FilterConfig) -> Matrix3<f32> {
    let position = config.systematic_position_std * config.systematic_position_std;
    let heading = config.systematic_heading_std_deg.to_radians().powi(2);
    Matrix3::from_diagonal(&Vector3::new(position, position, heading))
}
