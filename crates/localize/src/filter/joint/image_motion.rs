//! How did the robot move since the last image? (docs/methods.md 8.14)
//!
//! The pose at that image is a clone of the state (`pose_clone`). The motion is the one by all sensors and images, with its
//! covariance.

use nalgebra::Matrix3;

use super::JointFilter;
use super::pose_clone::PoseClone;
use super::state::POSE;
use crate::filter::MotionEstimate;
use crate::frames::{Tf, wrap_angle};
use crate::math;

impl JointFilter {
    /// The motion begins anew at the present pose: an image was processed.
    pub(in crate::filter) fn begin_image_motion(&mut self) {
        let cross = [0, 1, 2].map(|k| self.covariance[POSE + k]);
        self.image_clone = Some(PoseClone {
            pose: [0, 1, 2].map(|k| self.state[POSE + k]),
            covariance: cross.map(|line| [line[POSE], line[POSE + 1], line[POSE + 2]]),
            cross,
        });
    }

    /// Motion since the last image. None for a new filter.
    pub(in crate::filter) fn image_motion(&self) -> Option<MotionEstimate> {
        let clone = self.image_clone.as_ref()?;
        let [x, y, theta] = clone.pose;
        let (sin, cos) = math::sin_cos(theta);
        let (dx, dy) = (self.state[POSE] - x, self.state[POSE + 1] - y);
        let turn = wrap_angle(self.state[POSE + 2] - theta);
        let motion = Tf::new(cos * dx + sin * dy, cos * dy - sin * dx, turn);
        // Derivatives by the pose and by the clone.
        let by_pose = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        let mut by_clone = -by_pose;
        (by_clone[(0, 2)], by_clone[(1, 2)]) = (motion.y, -motion.x);
        let pose = Matrix3::from_fn(|i, j| self.covariance[POSE + i][POSE + j]);
        let own = Matrix3::from_fn(|i, j| clone.covariance[i][j]);
        let cross = Matrix3::from_fn(|i, j| clone.cross[i][POSE + j]);
        let mixed = by_clone * cross * by_pose.transpose();
        let covariance = by_pose * pose * by_pose.transpose()
            + mixed
            + mixed.transpose()
            + by_clone * own * by_clone.transpose();
        let mut covariance = (covariance + covariance.transpose()) * 0.5;
        // The difference of large covariances: rounding may leave less than nothing.
        for axis in 0..3 {
            let rounding = 1e-6 * pose[(axis, axis)];
            covariance[(axis, axis)] = covariance[(axis, axis)].max(0.0) + rounding;
        }
        Some(MotionEstimate { motion, covariance })
    }

    /// A correction of the pose right after an image is no motion since then. The mates' errors, which the clone does not know,
    /// would else move the two apart.
    pub(super) fn follow_correction(&mut self, step: [f32; 3]) {
        let Some([x, y, theta]) = self.image_clone.as_ref().map(|clone| clone.pose) else {
            return;
        };
        self.begin_image_motion();
        if let Some(clone) = &mut self.image_clone {
            clone.pose = [x + step[0], y + step[1], theta + step[2]];
        }
    }

    /// Adds an error of the present pose that the pose at the last image has as well.
    pub(super) fn add_common_error(&mut self, axis: usize, variance: f32) {
        self.inflate_variance(POSE + axis, variance);
        if let Some(clone) = &mut self.image_clone {
            clone.inflate_common(axis, variance);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::filter::pose_gaussian::{PoseMeasurement, kalman_update};
    use crate::filter::{FilterConfig, ImuInterval, OdometryPrior, PredictionInput};
    use crate::filter::{TiltPrior, WheelIncrement};
    use crate::frames::Pose;

    const DT: f32 = 0.01;

    fn filter(position_std: f32, config: &FilterConfig) -> JointFilter {
        let variance = position_std * position_std;
        let covariance = Matrix3::from_diagonal(&Vector3::new(variance, variance, 1e-6));
        let prior = OdometryPrior::of_any_base(config);
        let pose = Pose::new(1.0, 2.0, 0.5);
        let mut filter = JointFilter::new(pose, &covariance, None, config, &prior);
        drive(&mut filter, [0.0; 3], 0.0, 50, config);
        filter
    }

    /// The wheels report `wheels`; the inertial unit feels an acceleration along x.
    fn drive(
        filter: &mut JointFilter,
        wheels: [f32; 3],
        acceleration: f32,
        steps: usize,
        config: &FilterConfig,
    ) {
        for _ in 0..steps {
            let imu = ImuInterval {
                specific_force: [acceleration, 0.0],
                mean_angular_velocity: [0.0; 3],
                final_yaw_rate: 0.0,
                vibration_std: 0.0,
                sample_period: DT,
            };
            let input = PredictionInput {
                dt: DT,
                imu: Some(imu),
                ..PredictionInput::default()
            };
            filter.predict(&input, config);
            let increment = WheelIncrement {
                motion: wheels.map(|speed| speed * DT),
                dt: DT,
                slip: 0.0,
                imu_active: true,
            };
            filter.update_wheels(&increment, config);
        }
    }

    fn see(filter: &mut JointFilter, pose: Pose, config: &FilterConfig) {
        let variances = Vector3::new(1e-4, 1e-4, 1e-6);
        let measurement = PoseMeasurement {
            pose,
            covariance: Matrix3::from_diagonal(&variances),
        };
        let predicted = filter.predicted_covariance(TiltPrior::STATE);
        let posterior = kalman_update(filter.pose(), &predicted, &measurement).expect("regular");
        filter.update(&posterior, TiltPrior::STATE, config);
    }

    fn ahead(distance: f32) -> Pose {
        Pose::new(1.0, 2.0, 0.5) * Tf::new(distance, 0.0, 0.0)
    }

    #[test]
    fn correction_of_an_old_error_is_no_motion_and_an_admitted_motion_is_one() {
        let config = FilterConfig::default();
        for (old, expected) in [(true, 0.0), (false, 0.1)] {
            let mut filter = filter(if old { 0.3 } else { 0.003 }, &config);
            filter.begin_image_motion();
            drive(&mut filter, [0.0; 3], 0.0, 3, &config);
            if !old {
                filter.admit_motion(0.1, 0.02);
            }
            see(&mut filter, ahead(0.1), &config);
            let MotionEstimate { motion, covariance } = filter.image_motion().expect("an image");
            let off = filter.pose().origin().distance_to(ahead(0.1).origin());
            assert!(off < 0.02, "{off}");
            assert!((motion.x - expected).abs() < 0.02, "{old}: {motion:?}");
            let std = covariance[(0, 0)].sqrt();
            assert!(if old { std < 0.01 } else { std < 0.02 }, "{old}: {std}");
        }
    }

    #[test]
    fn wheels_that_spin_are_no_motion() {
        let config = FilterConfig::default();
        let mut filter = filter(0.003, &config);
        for _ in 0..30 {
            filter.begin_image_motion();
            drive(&mut filter, [1.5, 0.0, 0.0], 0.0, 3, &config);
            see(&mut filter, ahead(0.0), &config);
            let MotionEstimate { motion, covariance } = filter.image_motion().expect("an image");
            let std = covariance[(0, 0)].sqrt();
            assert!(motion.x.abs() < 0.01 + 3.0 * std, "{motion:?} {std}");
            assert!(motion.x.abs() < 0.02, "{motion:?} {std}");
        }
    }

    #[test]
    fn motion_is_that_of_the_drive_with_an_honest_deviation() {
        let config = FilterConfig::default();
        let mut filter = filter(0.003, &config);
        drive(&mut filter, [1.0, 0.0, 0.0], 0.0, 3, &config);
        let before = filter.pose();
        filter.begin_image_motion();
        assert_eq!(
            filter.image_motion().map(|estimate| estimate.motion.x),
            Some(0.0)
        );
        drive(&mut filter, [1.0, 0.0, 0.0], 0.0, 3, &config);
        let MotionEstimate { motion, covariance } = filter.image_motion().expect("an image");
        let step = before.inverse() * filter.pose();
        assert!((motion.x - step.x).abs() < 1e-5 && (motion.y - step.y).abs() < 1e-5);
        for axis in 0..3 {
            let std = covariance[(axis, axis)].sqrt();
            assert!(std > 1e-5 && std < 0.03, "{axis}: {std}");
        }
    }
}
