//! Filter of nubot2013 4: odometry, corrected by each match according to the curvature of its error function.
//!
//! The paper matches the points without a prior, from the predicted pose on. The second derivatives of the error function
//! give the uncertainty of the match: where it is large, odometry counts more (docs/methods.md 8.12). The paper names
//! neither the odometry's noise nor its scale. Here they are those of docs/methods.md 8.5.

use nalgebra::{Matrix3, Vector3};

use super::dead_reckoning::{DeadReckoning, Motion};
use super::pose_gaussian::PoseMeasurement;
use super::{FilterConfig, PredictionInput, WheelIncrement};
use crate::frames::Pose;
use crate::omni::Twist;

/// Odometry corrected by matches.
#[derive(Debug, Clone, PartialEq)]
pub struct CurvatureFilter {
    /// At the last wheel sample or image.
    reckoned: DeadReckoning,
    twist: Twist,
    /// Time since `reckoned`, seconds: the pose moves on with the last twist.
    elapsed: f32,
    /// Time of the current wheel interval that an image has already used, seconds.
    used: f32,
    latency: f32,
    noise: FilterConfig,
}

impl CurvatureFilter {
    pub(super) fn new(pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) -> Self {
        CurvatureFilter {
            reckoned: DeadReckoning::new(pose, covariance, config.decentralised.scale_std),
            twist: Twist::default(),
            elapsed: 0.0,
            used: 0.0,
            latency: config.camera_latency,
            noise: config.clone(),
        }
    }

    /// Estimate at the time to which the filter is predicted.
    fn predicted(&self) -> DeadReckoning {
        let mut predicted = self.reckoned.clone();
        if self.elapsed > 0.0 {
            let step = self.twist.scaled(self.elapsed);
            self.advance(&mut predicted, [step.x, step.y, step.theta], self.elapsed);
        }
        predicted
    }

    fn advance(&self, reckoned: &mut DeadReckoning, [dx, dy, dtheta]: [f32; 3], seconds: f32) {
        let noise = self.noise.wheel_noise([dx, dy, dtheta], seconds);
        let position = noise.position.iter().sum();
        let heading = noise.heading.iter().sum();
        let noise = Matrix3::from_diagonal(&Vector3::new(position, position, heading));
        reckoned.predict(Motion::new(dx, dy, dtheta), &noise);
    }

    pub(super) fn pose(&self) -> Pose {
        self.predicted().pose
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.predicted().covariance()
    }

    pub(super) fn twist(&self) -> Twist {
        self.twist
    }

    pub(super) fn latency(&self) -> f32 {
        self.latency
    }

    pub(super) fn in_collision(&self) -> bool {
        false
    }

    pub(super) fn predict(&mut self, input: &PredictionInput, _config: &FilterConfig) {
        self.elapsed += input.dt;
    }

    pub(super) fn update_wheels(&mut self, increment: &WheelIncrement, _config: &FilterConfig) {
        let [dx, dy, dtheta] = increment.motion;
        let interval = self.elapsed + self.used;
        let share = if interval > 0.0 {
            self.elapsed / interval
        } else {
            0.0
        };
        let mut reckoned = self.reckoned.clone();
        let rest = [share * dx, share * dy, share * dtheta];
        self.advance(&mut reckoned, rest, self.elapsed);
        self.reckoned = reckoned;
        if interval > 0.0 {
            self.twist = Twist {
                x: dx / interval,
                y: dy / interval,
                theta: dtheta / interval,
            };
        }
        self.restart_wheels();
    }

    pub(super) fn restart_wheels(&mut self) {
        self.elapsed = 0.0;
        self.used = 0.0;
    }

    /// Updates by a match without prior, whose covariance is the inverse curvature of its error function.
    pub(super) fn update(&mut self, measurement: &PoseMeasurement) {
        self.reckoned = self.predicted();
        self.used += self.elapsed;
        self.elapsed = 0.0;
        self.reckoned.update(measurement);
    }

    pub(super) fn inflate_covariance(&mut self, factor: f32) {
        self.reckoned.inflate_covariance(factor);
    }

    /// The same estimate in the other field half.
    pub(super) fn half_turned(&self) -> Self {
        CurvatureFilter {
            reckoned: self.reckoned.half_turned(),
            ..self.clone()
        }
    }
}
