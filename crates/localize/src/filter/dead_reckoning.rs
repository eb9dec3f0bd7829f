//! Pose by measured motions with an honest covariance, for filters that do not estimate the odometry scales.
//!
//! Two scales, of translation and rotation, are parameters of a Schmidt-Kalman filter: they are not estimated, but their
//! error is common to all motions since the last image. It adds up along the path instead of averaging out.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::pose_gaussian::{PoseMeasurement, retract};
use crate::frames::{Pose, RobotFrame, Tf};

/// Transform from the robot frame now to an earlier robot frame.
pub(super) type Motion = Tf<RobotFrame, RobotFrame>;

/// Derivatives of (x, y, θ) by the scales of translation and rotation.
type ScaleSensitivity = SMatrix<f32, 3, 2>;

/// Pose with its covariance.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DeadReckoning {
    pub(super) pose: Pose,
    /// Of (x, y, θ), the scales' share included.
    covariance: Matrix3<f32>,
    sensitivity: ScaleSensitivity,
    /// Variance of each scale.
    scale_variance: f32,
}

impl DeadReckoning {
    pub(super) fn new(pose: Pose, covariance: &Matrix3<f32>, scale_std: f32) -> Self {
        DeadReckoning {
            pose,
            covariance: *covariance,
            sensitivity: ScaleSensitivity::zeros(),
            scale_variance: scale_std * scale_std,
        }
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.covariance
    }

    /// Moves the pose. `noise`: covariance of the motion's (x, y, θ) on the field.
    pub(super) fn predict(&mut self, motion: Motion, noise: &Matrix3<f32>) {
        let moved = self.pose * motion;
        let (dx, dy) = (moved.x - self.pose.x, moved.y - self.pose.y);
        // A heading error turns the motion.
        let jacobian = Matrix3::new(1.0, 0.0, -dy, 0.0, 1.0, dx, 0.0, 0.0, 1.0);
        let carried = jacobian * self.sensitivity;
        let own = ScaleSensitivity::new(dx, 0.0, dy, 0.0, 0.0, motion.theta);
        let sensitivity = carried + own;
        let scales = (sensitivity * sensitivity.transpose() - carried * carried.transpose())
            * self.scale_variance;
        self.covariance =
            symmetric(&(jacobian * self.covariance * jacobian.transpose() + scales + noise));
        self.sensitivity = sensitivity;
        self.pose = moved;
    }

    /// Kalman update by a measured pose. Without effect if its covariance is singular.
    pub(super) fn update(&mut self, measurement: &PoseMeasurement) {
        let total = self.covariance + measurement.covariance;
        let Some(information) = total.try_inverse() else {
            return;
        };
        let gain = self.covariance * information;
        let step = gain * measurement.pose.difference(self.pose);
        self.set_posterior(
            retract(self.pose, &step),
            &(self.covariance - gain * self.covariance),
        );
    }

    /// Takes over a pose and covariance that follow from this estimate and a measurement.
    pub(super) fn set_posterior(&mut self, pose: Pose, covariance: &Matrix3<f32>) {
        // P⁺ P⁻¹ is 1 − K: what remains of each error.
        if let Some(information) = self.covariance.try_inverse() {
            self.sensitivity = covariance * information * self.sensitivity;
        }
        self.pose = pose;
        self.covariance = symmetric(covariance);
    }

    pub(super) fn inflate_covariance(&mut self, factor: f32) {
        self.covariance *= factor;
    }

    /// The same estimate in the other field half.
    pub(super) fn half_turned(&self) -> Self {
        let mut turned = self.clone();
        turned.pose = Pose::new(
            -self.pose.x,
            -self.pose.y,
            self.pose.theta + std::f32::consts::PI,
        );
        let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        turned.covariance = mirror * self.covariance * mirror;
        turned.sensitivity = mirror * self.sensitivity;
        turned
    }
}

fn symmetric(matrix: &Matrix3<f32>) -> Matrix3<f32> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_error_grows_with_the_distance_and_cancels_on_the_way_back() {
        let start = Pose::new(0.0, 0.0, 0.0);
        let mut reckoned = DeadReckoning::new(start, &Matrix3::zeros(), 0.05);
        let step = |sign: f32| Motion::new(0.1 * sign, 0.0, 0.0);
        for _ in 0..100 {
            reckoned.predict(step(1.0), &Matrix3::zeros());
        }
        assert!((reckoned.covariance()[(0, 0)].sqrt() - 0.5).abs() < 1e-3);
        for _ in 0..100 {
            reckoned.predict(step(-1.0), &Matrix3::zeros());
        }
        assert!(reckoned.covariance()[(0, 0)].abs() < 1e-4);
    }
}
