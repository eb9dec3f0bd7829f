//! Decentralised filter of minho2016 IV.C, eqs 6 to 9 (docs/methods.md 8.11).
//!
//! Each member (vision, odometry) is a Kalman filter that predicts with the commanded motion and corrects with its own
//! measurement. The node adds what each member learned since the last cycle, in information form. The members continue
//! from the node's estimate, so odometry does not drift away.

use nalgebra::{Matrix3, Vector3};

use super::config::WheelNoise;
use super::pose_gaussian::{PoseMeasurement, retract};
use super::{FilterConfig, PredictionInput, WheelIncrement};
use crate::frames::{Pose, RobotFrame, Tf, wrap_angle};
use crate::math;
use crate::omni::Twist;
use crate::sensors::collision::CollisionDetector;

pub use super::config::DecentralisedConfig;

/// Transform from the robot frame now to the robot frame at the last cycle.
type Motion = Tf<RobotFrame, RobotFrame>;

/// Information form of a Gaussian: P⁻¹ and P⁻¹X.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Information {
    matrix: Matrix3<f32>,
    vector: Vector3<f32>,
}

impl Information {
    fn zero() -> Self {
        Information {
            matrix: Matrix3::zeros(),
            vector: Vector3::zeros(),
        }
    }
}

/// A member's local filter.
#[derive(Debug, Clone, PartialEq)]
struct LocalFilter {
    covariance: Matrix3<f32>,
    /// Information last sent to the node. None while the member has no measurement.
    sent: Option<Information>,
}

impl LocalFilter {
    fn new(covariance: Matrix3<f32>) -> Self {
        LocalFilter {
            covariance,
            sent: None,
        }
    }

    /// Kalman filter step. Deviations are relative to the node's last estimate.
    ///
    /// Returns the posterior deviation, or None if S is singular.
    fn update(
        &mut self,
        predicted: &Vector3<f32>,
        process_noise: &Matrix3<f32>,
        measured: &Vector3<f32>,
        measurement_noise: &Matrix3<f32>,
    ) -> Option<Vector3<f32>> {
        let prior = self.covariance + process_noise;
        let gain = prior * (prior + measurement_noise).try_inverse()?;
        let posterior = prior - gain * prior;
        self.covariance = (posterior + posterior.transpose()) * 0.5;
        let mut innovation = measured - predicted;
        innovation[2] = wrap_angle(innovation[2]);
        Some(predicted + gain * innovation)
    }

    /// Eqs 6 and 7: information gained since the last cycle. A member without a measurement withdraws its information.
    fn information_increment(&mut self, deviation: Option<Vector3<f32>>) -> Information {
        let current = deviation.and_then(|deviation| {
            let matrix = self.covariance.try_inverse()?;
            Some(Information {
                matrix,
                vector: matrix * deviation,
            })
        });
        let before = self.sent.unwrap_or_else(Information::zero);
        let after = current.unwrap_or_else(Information::zero);
        self.sent = current;
        Information {
            matrix: after.matrix - before.matrix,
            vector: after.vector - before.vector,
        }
    }
}

/// The node with its two members.
#[derive(Debug, Clone, PartialEq)]
pub struct DecentralisedFilter {
    /// The node's estimate after its last cycle.
    fused_pose: Pose,
    covariance: Matrix3<f32>,
    /// The node's information about the deviation from `fused_pose`. Zero before the first measurement.
    information: Information,
    vision: LocalFilter,
    odometry: LocalFilter,
    /// Commanded motion since the last cycle, robot frame at that time.
    commanded_motion: Motion,
    /// Motion measured by the wheels since the last cycle, same frame.
    wheel_motion: Motion,
    /// Time since the last cycle, seconds.
    elapsed: f32,
    /// Time since the last wheel sample, seconds. Infinite after a timeout.
    wheel_silence: f32,
    command: Twist,
    wheel_twist: Twist,
    latency: f32,
    collision: CollisionDetector,
}

impl DecentralisedFilter {
    pub(super) fn new(pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) -> Self {
        DecentralisedFilter {
            fused_pose: pose,
            covariance: *covariance,
            information: Information::zero(),
            vision: LocalFilter::new(*covariance),
            odometry: LocalFilter::new(*covariance),
            commanded_motion: Motion::new(0.0, 0.0, 0.0),
            wheel_motion: Motion::new(0.0, 0.0, 0.0),
            elapsed: 0.0,
            wheel_silence: 0.0,
            command: Twist::default(),
            wheel_twist: Twist::default(),
            latency: config.camera_latency,
            collision: CollisionDetector::default(),
        }
    }

    /// The node's estimate, moved by the wheels, or by the command without them.
    pub(super) fn pose(&self) -> Pose {
        let motion = if self.wheels_active() {
            self.wheel_motion
        } else {
            self.commanded_motion
        };
        self.fused_pose * motion
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.covariance
    }

    pub(super) fn twist(&self) -> Twist {
        if self.wheels_active() {
            self.wheel_twist
        } else {
            self.command
        }
    }

    pub(super) fn latency(&self) -> f32 {
        self.latency
    }

    pub(super) fn in_collision(&self) -> bool {
        self.collision.is_active()
    }

    fn wheels_active(&self) -> bool {
        self.wheel_silence.is_finite() && !self.collision.is_active()
    }

    pub(super) fn predict(&mut self, input: &PredictionInput, config: &FilterConfig) {
        if input.shock {
            self.collision.trigger(&config.collision);
        }
        self.collision.advance_time(input.dt);
        self.elapsed += input.dt;
        self.wheel_silence += input.dt;
        if self.wheel_silence > config.decentralised.wheel_timeout {
            self.wheel_silence = f32::INFINITY;
        }
        self.command = input.command.unwrap_or(self.wheel_twist);
        let step = self.command.scaled(input.dt);
        self.commanded_motion = self.commanded_motion * chord(step);
    }

    pub(super) fn update_wheels(&mut self, increment: &WheelIncrement, _config: &FilterConfig) {
        let [dx, dy, dtheta] = increment.motion;
        self.wheel_motion = self.wheel_motion * Motion::new(dx, dy, dtheta);
        self.wheel_silence = 0.0;
        let per_second = if increment.dt > 0.0 {
            1.0 / increment.dt
        } else {
            0.0
        };
        self.wheel_twist = Twist {
            x: dx * per_second,
            y: dy * per_second,
            theta: dtheta * per_second,
        };
    }

    pub(super) fn restart_wheels(&mut self) {
        self.wheel_silence = f32::INFINITY;
    }

    /// One cycle: the members filter, the node fuses their information (eqs 8 and 9).
    ///
    /// `measurement`: pose measured by vision. None without one.
    pub(super) fn fuse(&mut self, measurement: Option<PoseMeasurement>, config: &FilterConfig) {
        // All deviations are relative to the node's last estimate, so headings are small angles.
        let origin = self.fused_pose;
        let commanded = (origin * self.commanded_motion).difference(origin);
        let process_noise = self.command_covariance(config);
        let vision = measurement.and_then(|PoseMeasurement { pose, covariance }| {
            let measured = pose.difference(origin);
            self.vision
                .update(&commanded, &process_noise, &measured, &covariance)
        });
        if vision.is_none() {
            self.vision.covariance += process_noise;
        }
        let odometry = self.wheels_active().then(|| {
            let measured = (origin * self.wheel_motion).difference(origin);
            let noise = self.wheel_covariance(config);
            self.odometry
                .update(&commanded, &process_noise, &measured, &noise)
        });
        let odometry = odometry.flatten();
        if odometry.is_none() {
            // When the wheels return, this member starts from the node's covariance.
            self.odometry.covariance = self.covariance + process_noise;
        }
        for increment in [
            self.vision.information_increment(vision),
            self.odometry.information_increment(odometry),
        ] {
            self.information.matrix += increment.matrix;
            self.information.vector += increment.vector;
        }
        let covariance = self.information.matrix.try_inverse().filter(|covariance| {
            let variances = covariance.diagonal();
            variances
                .iter()
                .all(|variance| *variance > 0.0 && variance.is_finite())
        });
        match covariance {
            Some(covariance) if vision.is_some() || odometry.is_some() => {
                self.fused_pose = retract(origin, &(covariance * self.information.vector));
                self.covariance = (covariance + covariance.transpose()) * 0.5;
            }
            // Without members the commanded motion alone.
            _ => {
                self.fused_pose = origin * self.commanded_motion;
                self.covariance += process_noise;
                self.information = Information::zero();
            }
        }
        self.rebase_information(&self.fused_pose.difference(origin));
        self.commanded_motion = Motion::new(0.0, 0.0, 0.0);
        self.wheel_motion = Motion::new(0.0, 0.0, 0.0);
        self.elapsed = 0.0;
    }

    /// Expresses all information relative to the new estimate, `step` away from the old one.
    fn rebase_information(&mut self, step: &Vector3<f32>) {
        let sent = [&mut self.vision, &mut self.odometry].map(|member| member.sent.as_mut());
        let node = std::iter::once(&mut self.information);
        for information in node.chain(sent.into_iter().flatten()) {
            information.vector -= information.matrix * step;
        }
    }

    /// Process noise: uncertainty of the commanded motion.
    fn command_covariance(&self, config: &FilterConfig) -> Matrix3<f32> {
        let noise = &config.decentralised;
        let translation =
            noise.command_noise * math::hypot(self.commanded_motion.x, self.commanded_motion.y);
        let rotation = noise.command_noise * self.commanded_motion.theta;
        let position =
            translation * translation + noise.command_drift * noise.command_drift * self.elapsed;
        let heading =
            rotation * rotation + noise.command_drift_deg.to_radians().powi(2) * self.elapsed;
        Matrix3::from_diagonal(&Vector3::new(position, position, heading))
    }

    /// Measurement noise of the wheels (docs/methods.md 8.5).
    fn wheel_covariance(&self, config: &FilterConfig) -> Matrix3<f32> {
        let Motion { x, y, theta, .. } = self.wheel_motion;
        let WheelNoise { position, heading } = config.wheel_noise([x, y, theta], self.elapsed);
        // The floor keeps the matrix invertible for a robot at rest.
        Matrix3::from_diagonal(&Vector3::new(position, position, heading).add_scalar(1e-9))
    }

    pub(super) fn inflate_covariance(&mut self, factor: f32) {
        self.covariance *= factor;
        self.vision.covariance *= factor;
        self.odometry.covariance *= factor;
    }

    /// The same estimate in the other field half.
    pub(super) fn half_turned(&self) -> Self {
        let mut turned = self.clone();
        let pose = self.fused_pose;
        turned.fused_pose = Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI);
        for matrix in [
            &mut turned.covariance,
            &mut turned.vision.covariance,
            &mut turned.odometry.covariance,
        ] {
            for i in 0..2 {
                matrix[(i, 2)] = -matrix[(i, 2)];
                matrix[(2, i)] = -matrix[(2, i)];
            }
        }
        for member in [&mut turned.vision, &mut turned.odometry] {
            member.sent = None;
        }
        turned.information = Information::zero();
        turned
    }
}

/// Motion on an arc, approximated by its chord at half the rotation.
fn chord(motion: Twist) -> Motion {
    let Twist { x, y, theta } = motion;
    let (sin, cos) = math::sin_cos(0.5 * theta);
    Motion::new(cos * x - sin * y, sin * x + cos * y, theta)
}
