//! About which point do the wheels turn? An origin of the poses beside it moves when the robot turns (docs/methods.md 2.13).

use super::JointFilter;
use super::state::{POSE, WHEEL_INCREMENT};
use super::turning_steps::TurningSteps;
use crate::math;
use crate::wheel_steps::OriginOffset;

impl JointFilter {
    /// Where the poses' origin lies about the point that the wheels turn about. None before enough steps.
    pub(in crate::filter) fn origin_offset(&self) -> Option<OriginOffset> {
        self.turning_steps.origin()
    }

    /// A wheel sample ends the present increment.
    pub(super) fn add_wheel_step(&mut self, measured: [f32; 3]) {
        let middle = self.state[POSE + 2] - 0.5 * self.state[WHEEL_INCREMENT + 2];
        self.turning_steps.add_wheels(middle, measured);
    }

    /// The present pose is that of an image.
    pub(super) fn add_pose_step(&mut self) {
        let heading = self.state[POSE + 2] - self.state[WHEEL_INCREMENT + 2];
        let (sin, cos) = math::sin_cos(heading);
        let [x, y, turn] = [0, 1, 2].map(|k| self.state[WHEEL_INCREMENT + k]);
        self.turning_steps
            .add_pose(self.pose(), [cos * x - sin * y, sin * x + cos * y, turn]);
    }

    /// The map moved the poses by this on the field, metres.
    pub(super) fn shift_origin(&mut self, [x, y]: [f32; 2]) {
        let (sin, cos) = math::sin_cos(self.state[POSE + 2]);
        self.turning_steps
            .shift([cos * x + sin * y, cos * y - sin * x]);
    }

    /// What was seen of the origin is of an earlier map.
    pub(in crate::filter) fn forget_origin(&mut self) {
        self.turning_steps = TurningSteps::default();
    }

    /// No step leads over the present time: the wheels were interrupted, or the pose is another one.
    pub(in crate::filter) fn interrupt_steps(&mut self) {
        self.turning_steps.interrupt();
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector2, Vector3};

    use crate::filter::{
        FilterConfig, FilterKind, OdometryPrior, PoseFilter, PredictionInput, WheelIncrement,
    };
    use crate::frames::Pose;
    use crate::math;

    const DT: f32 = 0.02;
    const ORIGIN: [f32; 2] = [0.08, -0.05];

    /// Drives with a yaw rate, and sees poses whose origin lies beside the wheels' centre. No inertial unit. Wheels measure
    /// `wrong` times the motion in every fifth second.
    fn drive(yaw_rate: f32, wrong: f32) -> PoseFilter {
        let config = FilterConfig::default();
        assert_eq!(config.kind, FilterKind::Joint);
        let prior = OdometryPrior::of_any_base(&config);
        let seen = |[x, y]: [f32; 2], theta: f32| {
            let (sin, cos) = math::sin_cos(theta);
            let [a, b] = ORIGIN;
            Pose::new(x + cos * a - sin * b, y + sin * a + cos * b, theta)
        };
        let covariance = Matrix3::from_diagonal(&Vector3::new(1e-5, 1e-5, 1e-5));
        let mut filter = PoseFilter::new(seen([0.0; 2], 0.0), &covariance, None, &config, &prior);
        let (mut at, mut theta) = ([0.0; 2], 0.0_f32);
        for step in 0..1000 {
            let direction = 0.7 * step as f32 * DT;
            let velocity = [math::cos(direction), math::sin(direction)];
            let (sin, cos) = math::sin_cos(theta + 0.5 * yaw_rate * DT);
            let input = PredictionInput {
                dt: DT,
                ..PredictionInput::default()
            };
            filter.predict(&input, &config);
            let scale = if step / 50 % 5 == 4 { wrong } else { 1.0 };
            let [x, y] = velocity.map(|value| value * DT * scale);
            let increment = WheelIncrement {
                motion: [cos * x + sin * y, cos * y - sin * x, yaw_rate * DT],
                dt: DT,
                slip: 0.0,
                imu_active: false,
            };
            filter.update_wheels(&increment, &config);
            at = [at[0] + velocity[0] * DT, at[1] + velocity[1] * DT];
            theta += yaw_rate * DT;
            if step % 2 == 0 {
                filter.update_pose(seen(at, theta), &covariance, &config);
            }
        }
        filter
    }

    #[test]
    fn turns_tell_the_origin_of_the_poses_even_if_wheels_slip() {
        for wrong in [1.0, 1.5] {
            let found = drive(1.5, wrong).origin_offset().expect("enough steps");
            let error = found.at - Vector2::from(ORIGIN);
            assert!(error.norm() < 0.02, "{wrong}: {found:?}");
            assert!((2.0 * found.variance).sqrt() < 0.04, "{wrong}: {found:?}");
        }
        let straight = drive(0.0, 1.0).origin_offset().expect("enough steps");
        assert!((2.0 * straight.variance).sqrt() > 0.3, "{straight:?}");
    }

    #[test]
    fn step_of_the_map_moves_the_origin_in_the_robot_frame() {
        let mut filter = drive(1.5, 1.0);
        let before = filter.origin_offset().expect("enough steps").at;
        let (sin, cos) = math::sin_cos(filter.pose().theta);
        filter.shift_pose([0.03 * cos, 0.03 * sin, 0.0, 0.0, 0.0]);
        let after = filter.origin_offset().expect("enough steps").at;
        assert!((after - before - Vector2::new(0.03, 0.0)).norm() < 1e-5);
        filter.forget_origin();
        assert!(filter.origin_offset().is_none());
    }
}
