//! Where is the robot by its wheels alone? The frame `odom` of REP 105: continuous, and drifting.

use localize::Stamp;
use localize::filter::FilterConfig;
use localize::math;
use localize::sample::Odometry;
use nalgebra::{Matrix3, Vector3};

/// Longest time over which a velocity is extrapolated or computed, seconds.
const STEP_MAX: f64 = 0.5;

/// Pose in the frame `odom`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct PlanarPose {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) theta: f64,
}

impl PlanarPose {
    /// The pose after a motion in its own axes.
    pub(crate) fn moved(self, [dx, dy, dtheta]: [f64; 3]) -> PlanarPose {
        let (sin, cos) = math::sin_cos(self.theta);
        PlanarPose {
            x: self.x + cos * dx - sin * dy,
            y: self.y + sin * dx + cos * dy,
            theta: self.theta + dtheta,
        }
    }

    /// The pose of the frame that moves `other` to this pose: `self = result · other`.
    pub(crate) fn correction_of(self, other: PlanarPose) -> PlanarPose {
        let theta = self.theta - other.theta;
        let (sin, cos) = math::sin_cos(theta);
        PlanarPose {
            x: self.x - cos * other.x + sin * other.y,
            y: self.y - sin * other.x - cos * other.y,
            theta,
        }
    }
}

/// Integrated wheel motion with its covariance.
#[derive(Debug, Clone)]
pub(crate) struct OdometryFrame {
    noise: NoisePerMotion,
    /// Stamp of the last sample.
    stamp: Option<Stamp>,
    pub(crate) pose: PlanarPose,
    /// Of (x, y, θ) in the frame `odom`, since its start.
    pub(crate) covariance: Matrix3<f64>,
    /// Velocity during the last step, robot frame: m/s, rad/s.
    pub(crate) velocity: [f64; 3],
    /// Of the velocity.
    pub(crate) velocity_covariance: Matrix3<f64>,
}

/// The settings of the filter: standard deviations per square root of a metre or a radian.
#[derive(Debug, Clone, Copy)]
struct NoisePerMotion {
    position: f64,
    heading_per_metre: f64,
    heading_per_radian: f64,
    /// Per square root of a second.
    position_drift: f64,
    heading_drift: f64,
}

impl OdometryFrame {
    /// At its origin, with the noise that the filter assumes.
    pub(crate) fn new(config: &FilterConfig) -> Self {
        OdometryFrame {
            noise: NoisePerMotion {
                position: f64::from(config.odometry_noise_per_metre),
                heading_per_metre: f64::from(config.heading_noise_per_metre_deg).to_radians(),
                heading_per_radian: f64::from(config.heading_noise_per_radian),
                position_drift: f64::from(config.odometry_drift),
                heading_drift: f64::from(config.odometry_drift_deg).to_radians(),
            },
            stamp: None,
            pose: PlanarPose::default(),
            covariance: Matrix3::zeros(),
            velocity: [0.0; 3],
            velocity_covariance: Matrix3::zeros(),
        }
    }

    /// Adds a sample.
    pub(crate) fn add(&mut self, sample: &Odometry) {
        let motion = [sample.dx, sample.dy, sample.dtheta].map(f64::from);
        let [dx, dy, dtheta] = motion;
        let step = self.stamp.map_or(0.0, |last| sample.stamp - last);
        let noise = self.noise.of(motion, step.clamp(0.0, STEP_MAX));
        // Position moves by R(θ)·(dx, dy), so an error of θ moves it across.
        let (sin, cos) = math::sin_cos(self.pose.theta);
        let rotation = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let mut transition = Matrix3::identity();
        transition[(0, 2)] = -sin * dx - cos * dy;
        transition[(1, 2)] = cos * dx - sin * dy;
        self.covariance = transition * self.covariance * transition.transpose()
            + rotation * noise * rotation.transpose();
        self.pose = self.pose.moved(motion);
        if step > 0.0 && step < STEP_MAX {
            self.velocity = [dx / step, dy / step, dtheta / step];
            self.velocity_covariance = noise / (step * step);
        }
        self.stamp = Some(sample.stamp);
    }

    /// The pose at a time near the last sample, by its velocity.
    pub(crate) fn pose_at(&self, stamp: Stamp) -> PlanarPose {
        let ahead = self.stamp.map_or(0.0, |last| stamp - last);
        if ahead.abs() > STEP_MAX {
            return self.pose;
        }
        self.pose.moved(self.velocity.map(|value| value * ahead))
    }
}

impl NoisePerMotion {
    /// Covariance of a motion in some seconds, in its own axes.
    fn of(self, [dx, dy, dtheta]: [f64; 3], step: f64) -> Matrix3<f64> {
        let distance = math::hypot(dx, dy);
        let position = self.position * self.position * distance
            + self.position_drift * self.position_drift * step;
        let heading = self.heading_drift * self.heading_drift * step
            + self.heading_per_metre * self.heading_per_metre * distance
            + self.heading_per_radian * self.heading_per_radian * dtheta.abs();
        Matrix3::from_diagonal(&Vector3::new(position, position, heading))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(seconds: f64, motion: [f32; 3]) -> Odometry {
        let [dx, dy, dtheta] = motion;
        Odometry {
            stamp: Stamp::from_seconds(seconds),
            dx,
            dy,
            dtheta,
            slip: 0.0,
        }
    }

    #[test]
    fn a_square_ends_at_its_start_and_heading_errors_spread_across_the_path() {
        let mut frame = OdometryFrame::new(&FilterConfig::default());
        let mut seconds = 0.0;
        for _side in 0..4 {
            for _step in 0..50 {
                seconds += 0.01;
                frame.add(&sample(seconds, [0.02, 0.0, 0.0]));
            }
            seconds += 0.01;
            frame.add(&sample(seconds, [0.0, 0.0, std::f32::consts::FRAC_PI_2]));
        }
        assert!(math::hypot(frame.pose.x, frame.pose.y) < 1e-5);
        let mut straight = OdometryFrame::new(&FilterConfig {
            odometry_drift: 0.0,
            odometry_drift_deg: 0.0,
            ..FilterConfig::default()
        });
        for step in 1..=500 {
            straight.add(&sample(f64::from(step) * 0.01, [0.02, 0.0, 0.0]));
        }
        // Ten metres: 2 cm per √m along, and ∫ of the heading's error across (q·d³/3).
        let along = 0.02 * 0.02 * 10.0;
        let heading = 0.7_f64.to_radians();
        let across = along + heading * heading * 1000.0 / 3.0;
        assert!((straight.covariance[(0, 0)] / along - 1.0).abs() < 1e-3);
        assert!((straight.covariance[(1, 1)] / across - 1.0).abs() < 1e-2);
        assert!(straight.covariance[(1, 2)] > 0.0);
        assert!((straight.velocity[0] - 2.0).abs() < 1e-3);
    }

    #[test]
    fn the_map_frame_moves_the_odometry_to_the_estimate() {
        let odometry = PlanarPose {
            x: 1.0,
            y: -2.0,
            theta: 0.7,
        };
        let estimate = PlanarPose {
            x: -3.0,
            y: 4.0,
            theta: -2.0,
        };
        let map_from_odom = estimate.correction_of(odometry);
        let back = map_from_odom.moved([odometry.x, odometry.y, odometry.theta]);
        assert!(math::hypot(back.x - estimate.x, back.y - estimate.y) < 1e-12);
        assert!((back.theta - estimate.theta).abs() < 1e-12);
    }
}
