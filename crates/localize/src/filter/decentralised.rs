//! Decentralised filter of minho2016 IV.C, eqs 6 to 9 (docs/methods.md 8.11).
//!
//! Each member (vision, odometry) is a Kalman filter that predicts with the commanded motion and corrects with its own
//! measurement: vision with a pose, odometry with the motion of the wheels. The node adds what each member learned beyond
//! the common prediction, in information form. Members continue from the node's estimate. Motions are measured relative
//! to that estimate, so the covariance grows without vision.

use nalgebra::{Matrix3, Vector3};

use super::dead_reckoning::{DeadReckoning, Motion};
use super::pose_gaussian::{PoseMeasurement, retract};
use super::{FilterConfig, PredictionInput, WheelIncrement};
use crate::frames::Pose;
use crate::math;
use crate::omni::Twist;
use crate::sensors::collision::CollisionDetector;

pub use super::config::DecentralisedConfig;

/// A member's estimate in information form: P⁻¹ and P⁻¹X, with X relative to the common prediction.
struct Information {
    matrix: Matrix3<f32>,
    vector: Vector3<f32>,
}

/// The node with its two members.
#[derive(Debug, Clone, PartialEq)]
pub struct DecentralisedFilter {
    /// The node's estimate after its last cycle.
    fused: DeadReckoning,
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
    noise: FilterConfig,
}

impl DecentralisedFilter {
    pub(super) fn new(pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) -> Self {
        DecentralisedFilter {
            fused: DeadReckoning::new(pose, covariance, config.decentralised.scale_std),
            commanded_motion: Motion::new(0.0, 0.0, 0.0),
            wheel_motion: Motion::new(0.0, 0.0, 0.0),
            elapsed: 0.0,
            wheel_silence: 0.0,
            command: Twist::default(),
            wheel_twist: Twist::default(),
            latency: config.camera_latency,
            collision: CollisionDetector::default(),
            noise: config.clone(),
        }
    }

    pub(super) fn pose(&self) -> Pose {
        self.odometry_member().pose
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.odometry_member().covariance()
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

    /// The common prediction of both members by the commanded motion.
    fn commanded(&self) -> DeadReckoning {
        let mut commanded = self.fused.clone();
        commanded.predict(self.commanded_motion, &self.command_covariance());
        commanded
    }

    /// The odometry's Kalman filter: the commanded motion, corrected by the wheels' motion since the last cycle.
    fn odometry_member(&self) -> DeadReckoning {
        let command_noise = self.command_covariance();
        let (mut motion, mut noise) = (self.commanded_motion, command_noise);
        if self.wheels_active() {
            let gain = (command_noise + self.wheel_covariance()).try_inverse();
            if let Some(gain) = gain.map(|inverse| command_noise * inverse) {
                let by = |motion: Motion| Vector3::new(motion.x, motion.y, motion.theta);
                let step = gain * (by(self.wheel_motion) - by(motion));
                motion = Motion::new(
                    motion.x + step[0],
                    motion.y + step[1],
                    motion.theta + step[2],
                );
                noise = command_noise - gain * command_noise;
            }
        }
        let mut member = self.fused.clone();
        member.predict(motion, &noise);
        member
    }

    /// One cycle: the members filter, the node fuses their information (eqs 8 and 9).
    ///
    /// `measurement`: pose measured by vision. None without one.
    pub(super) fn fuse(&mut self, measurement: Option<PoseMeasurement>) {
        let commanded = self.commanded();
        let odometry = self.odometry_member();
        let mut vision = commanded.clone();
        if let Some(measurement) = &measurement {
            vision.update(measurement);
        }
        // X is relative to the commanded pose, where the common prediction has X = 0.
        let information = |member: &DeadReckoning| {
            let matrix = member.covariance().try_inverse()?;
            let vector = matrix * member.pose.difference(commanded.pose);
            Some(Information { matrix, vector })
        };
        let fused = commanded.covariance().try_inverse().and_then(|predicted| {
            // Eqs 6 and 7, relative to the prediction; eqs 8 and 9.
            let (vision, odometry) = (information(&vision)?, information(&odometry)?);
            let sum = predicted + (vision.matrix - predicted) + (odometry.matrix - predicted);
            let covariance = sum.try_inverse()?;
            let is_valid = covariance
                .diagonal()
                .iter()
                .all(|variance| *variance > 0.0 && variance.is_finite());
            let step = covariance * (vision.vector + odometry.vector);
            is_valid.then(|| (retract(commanded.pose, &step), covariance))
        });
        self.fused = odometry;
        if let (Some((pose, covariance)), Some(_)) = (fused, measurement) {
            self.fused.set_posterior(pose, &covariance);
        }
        self.commanded_motion = Motion::new(0.0, 0.0, 0.0);
        self.wheel_motion = Motion::new(0.0, 0.0, 0.0);
        self.elapsed = 0.0;
    }

    /// Process noise: uncertainty of the commanded motion.
    fn command_covariance(&self) -> Matrix3<f32> {
        let noise = &self.noise.decentralised;
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
    fn wheel_covariance(&self) -> Matrix3<f32> {
        let Motion { x, y, theta, .. } = self.wheel_motion;
        let noise = self.noise.wheel_noise([x, y, theta], self.elapsed);
        let [position, heading] = [noise.position, noise.heading].map(|terms| terms.iter().sum());
        // The floor keeps the matrix invertible for a robot at rest.
        Matrix3::from_diagonal(&Vector3::new(position, position, heading).add_scalar(1e-9))
    }

    pub(super) fn inflate_covariance(&mut self, factor: f32) {
        self.fused.inflate_covariance(factor);
    }

    /// The same estimate in the other field half.
    pub(super) fn half_turned(&self) -> Self {
        DecentralisedFilter {
            fused: self.fused.half_turned(),
            ..self.clone()
        }
    }
}

/// Motion on an arc, approximated by its chord at half the rotation.
fn chord(motion: Twist) -> Motion {
    let Twist { x, y, theta } = motion;
    let (sin, cos) = math::sin_cos(0.5 * theta);
    Motion::new(cos * x - sin * y, sin * x + cos * y, theta)
}
