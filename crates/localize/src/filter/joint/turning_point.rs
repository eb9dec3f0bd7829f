//! About which point do the wheels turn? An origin of the poses beside it moves when the robot turns (docs/methods.md 8.5).

use nalgebra::{Matrix2, Vector2};

use super::JointFilter;
use super::odometry_correction::{BASE_RADIUS, entry};

/// Standard deviation of the centre about which right wheels turn, metres.
pub const WHEEL_CENTRE_STD: f32 = 0.01;

/// Where a turn moves the poses' origin: entries of the odometry's correction.
const ALONG_X: usize = entry(0, 2);
const ALONG_Y: usize = entry(1, 2);

/// The poses' origin about the point that the wheels turn about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurningPoint {
    /// In the robot frame, metres.
    pub origin: Vector2<f64>,
    /// What the drive told of it, 1/m². Zero where nothing was seen.
    pub information: Matrix2<f64>,
    /// Variance of the point itself about the robot's centre, per axis, m².
    pub centre_variance: f64,
}

impl JointFilter {
    /// The origin about the turning point, as far as images and wheels tell it.
    pub(in crate::filter) fn turning_point(&self) -> TurningPoint {
        let p = |i: usize, j: usize| f64::from(self.covariance[i][j]);
        let crossed = -p(ALONG_X, ALONG_Y);
        let covariance = Matrix2::new(p(ALONG_Y, ALONG_Y), crossed, crossed, p(ALONG_X, ALONG_X));
        let prior = f64::from(self.odometry_prior.origin_variance);
        let gained = covariance.symmetric_eigen();
        let information = gained
            .eigenvalues
            .map(|variance| (1.0 / variance.max(f64::EPSILON) - 1.0 / prior).max(0.0));
        let axes = gained.eigenvectors;
        TurningPoint {
            origin: Vector2::new(self.state[ALONG_Y].into(), (-self.state[ALONG_X]).into()),
            centre_variance: self.centre_variance().into(),
            information: axes * Matrix2::from_diagonal(&information) * axes.transpose(),
        }
    }

    /// Wheels that couple motions otherwise, as those of different radii do, turn about another point, too.
    fn centre_variance(&self) -> f32 {
        let correction = |i, j| self.state[entry(i, j)];
        let couplings = [
            0.5 * (correction(0, 0) - correction(1, 1)),
            0.5 * (correction(0, 1) + correction(1, 0)),
            BASE_RADIUS * correction(2, 0),
            BASE_RADIUS * correction(2, 1),
        ];
        let squares: f32 = couplings.iter().map(|value| value * value).sum();
        WHEEL_CENTRE_STD.powi(2) + BASE_RADIUS.powi(2) * squares
    }

    /// What was seen of the origin is of an earlier map.
    pub(in crate::filter) fn forget_origin(&mut self) {
        for k in [ALONG_X, ALONG_Y] {
            self.covariance[k][k] += self.odometry_prior.origin_variance;
        }
    }

    /// The map moved the poses' origin by this in the robot frame, metres.
    pub(in crate::filter) fn shift_origin(&mut self, by: [f32; 2]) {
        self.state[ALONG_Y] += by[0];
        self.state[ALONG_X] -= by[1];
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use crate::filter::{
        FilterConfig, FilterKind, OdometryPrior, PoseFilter, PredictionInput, WheelIncrement,
    };
    use crate::frames::Pose;

    const DT: f32 = 0.02;
    const ORIGIN: [f32; 2] = [0.08, -0.05];

    /// Drives with a yaw rate, and sees poses whose origin lies beside the wheels' centre. Right wheels, no inertial unit.
    fn drive(yaw_rate: f32) -> PoseFilter {
        let config = FilterConfig::default();
        assert_eq!(config.kind, FilterKind::Joint);
        let mut prior = OdometryPrior::of_any_base(&config);
        prior.set_origin_std(0.1);
        let seen = |x: f32, theta: f32| {
            let (sin, cos) = theta.sin_cos();
            let [a, b] = ORIGIN;
            Pose::new(x + cos * a - sin * b, sin * a + cos * b, theta)
        };
        let covariance = Matrix3::from_diagonal(&Vector3::new(1e-5, 1e-5, 1e-5));
        let mut filter = PoseFilter::new(seen(0.0, 0.0), &covariance, None, &config, &prior);
        let (mut x, mut theta) = (0.0, 0.0_f32);
        for step in 0..500 {
            let (sin, cos) = (theta + 0.5 * yaw_rate * DT).sin_cos();
            let input = PredictionInput {
                dt: DT,
                ..PredictionInput::default()
            };
            filter.predict(&input, &config);
            // 1 m/s along the field's x axis.
            let increment = WheelIncrement {
                motion: [cos * DT, -sin * DT, yaw_rate * DT],
                dt: DT,
                slip: 0.0,
                imu_active: false,
            };
            filter.update_wheels(&increment, &config);
            x += DT;
            theta += yaw_rate * DT;
            if step % 2 == 0 {
                filter.update_pose(seen(x, theta), &covariance, &config);
            }
        }
        filter
    }

    #[test]
    fn turns_tell_the_origin_of_the_poses_and_straight_drives_do_not() {
        let turned = drive(1.5).turning_point().expect("a joint filter");
        let [x, y] = ORIGIN.map(f64::from);
        assert!((turned.origin.x - x).abs() < 0.01, "{turned:?}");
        assert!((turned.origin.y - y).abs() < 0.01, "{turned:?}");
        assert!(
            turned.information.trace() > 2.0 / 0.02_f64.powi(2),
            "{turned:?}"
        );
        let straight = drive(0.0).turning_point().expect("a joint filter");
        assert!(straight.information.trace() < 1.0, "{straight:?}");
    }

    #[test]
    fn step_of_the_map_moves_the_origin_in_the_robot_frame() {
        let mut filter = drive(1.5);
        let before = filter.turning_point().expect("a joint filter").origin;
        let theta = filter.pose().theta;
        filter.shift_pose([0.03 * theta.cos(), 0.03 * theta.sin(), 0.0, 0.0, 0.0]);
        let after = filter.turning_point().expect("a joint filter").origin;
        assert!((after - before - nalgebra::Vector2::new(0.03, 0.0)).norm() < 1e-5);
        filter.forget_origin();
        let forgotten = filter.turning_point().expect("a joint filter");
        assert!(forgotten.information.trace() < 1.0, "{forgotten:?}");
    }
}
