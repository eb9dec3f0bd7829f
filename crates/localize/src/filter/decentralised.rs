//! How does minho2016 fuse vision with odometry? Two filters, each corrected with the commanded motion, and a node.
//!
//! IV.C: every member (vision, odometry) is a Kalman filter that predicts with what the motors were told and corrects
//! with what its sensor measured. The fusing node adds what each member learnt since the last cycle, as information
//! (eqs 6–9). The members go on from the node's estimate ("the local estimates are corrected using global
//! information"), so that odometry cannot run away. Headings are kept unwrapped within a cycle.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::pose_gaussian::{innovation, retract};
use super::{FilterConfig, PredictionInput, WheelIncrement};
use crate::frames::{Pose, wrap_angle};
use crate::omni::Twist;
use crate::sensors::collision::CollisionDetector;

/// What the members are told of their prediction and of when they are lost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DecentralisedConfig {
    /// How far the commanded motion is from the real one, share of it (motors lag, wheels slip).
    pub command_noise: f32,
    /// The same at rest, metres per square root of a second.
    pub command_drift: f32,
    /// The same of the turn at rest, degrees per square root of a second.
    pub command_drift_deg: f32,
    /// Wheels that were silent for so long are no member, seconds.
    pub wheel_timeout: f32,
}

impl Default for DecentralisedConfig {
    fn default() -> Self {
        DecentralisedConfig {
            command_noise: 0.3,
            command_drift: 0.05,
            command_drift_deg: 3.0,
            wheel_timeout: 0.2,
        }
    }
}

/// A local filter; information is what the node last heard of it, none while it is lost.
#[derive(Debug, Clone, PartialEq)]
struct LocalFilter {
    covariance: Matrix3<f32>,
    sent_information: Option<(Matrix3<f32>, Vector3<f32>)>,
}

impl LocalFilter {
    fn new(covariance: Matrix3<f32>) -> Self {
        LocalFilter {
            covariance,
            sent_information: None,
        }
    }

    /// The local Kalman filter: predicted deviation and noise, measured deviation and noise, both from the node's
    /// last estimate. Its deviation; none if nothing can be inverted.
    fn update(
        &mut self,
        predicted: &Vector3<f32>,
        process: &Matrix3<f32>,
        measured: &Vector3<f32>,
        noise: &Matrix3<f32>,
    ) -> Option<Vector3<f32>> {
        let expected = self.covariance + process;
        let gain = expected * (expected + noise).try_inverse()?;
        let left = expected - gain * expected;
        self.covariance = (left + left.transpose()) * 0.5;
        let mut off = measured - predicted;
        off[2] = wrap_angle(off[2]);
        Some(predicted + gain * off)
    }

    /// Eqs 6 and 7: what it learnt since it last told; a member that is lost takes back what it said.
    fn information_increment(
        &mut self,
        deviation: Option<Vector3<f32>>,
    ) -> (Matrix3<f32>, Vector3<f32>) {
        let now = deviation.and_then(|deviation| {
            let information = self.covariance.try_inverse()?;
            Some((information, information * deviation))
        });
        let nothing = (Matrix3::zeros(), Vector3::zeros());
        let (before, after) = (
            self.sent_information.unwrap_or(nothing),
            now.unwrap_or(nothing),
        );
        self.sent_information = now;
        (after.0 - before.0, after.1 - before.1)
    }
}

/// The net of filters.
#[derive(Debug, Clone, PartialEq)]
pub struct DecentralisedFilter {
    /// The node's estimate after its last cycle.
    fused_pose: Pose,
    covariance: Matrix3<f32>,
    /// The node's P⁻¹ and P⁻¹X, X as deviation from `fused`: nothing before a member told something.
    information: Matrix3<f32>,
    information_vector: Vector3<f32>,
    vision: LocalFilter,
    odometry: LocalFilter,
    /// Motion since the last cycle, in the robot's frame then: as commanded, and as the wheels report it.
    commanded_motion: Pose,
    wheel_motion: Pose,
    /// Since the last cycle, and since the wheels were heard, seconds.
    elapsed: f32,
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
            information: Matrix3::zeros(),
            information_vector: Vector3::zeros(),
            vision: LocalFilter::new(*covariance),
            odometry: LocalFilter::new(*covariance),
            commanded_motion: Pose::new(0.0, 0.0, 0.0),
            wheel_motion: Pose::new(0.0, 0.0, 0.0),
            elapsed: 0.0,
            wheel_silence: 0.0,
            command: Twist::default(),
            wheel_twist: Twist::default(),
            latency: config.camera_latency,
            collision: CollisionDetector::default(),
        }
    }

    /// The node's estimate, moved on by what the wheels report, or else by what the motors were told.
    pub(super) fn pose(&self) -> Pose {
        let motion = if self.wheels_active() {
            self.wheel_motion
        } else {
            self.commanded_motion
        };
        compose(self.fused_pose, motion)
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

    pub(super) fn predict(&mut self, span: &PredictionInput, config: &FilterConfig) {
        if span.shock {
            self.collision.trigger(&config.collision);
        }
        self.collision.advance_time(span.dt);
        self.elapsed += span.dt;
        self.wheel_silence += span.dt;
        if self.wheel_silence > config.decentralised.wheel_timeout {
            self.wheel_silence = f32::INFINITY;
        }
        self.command = span.command.unwrap_or(self.wheel_twist);
        let step = self.command.scaled(span.dt);
        self.commanded_motion = compose_arc(self.commanded_motion, [step.x, step.y, step.theta]);
    }

    pub(super) fn update_wheels(&mut self, way: &WheelIncrement, _config: &FilterConfig) {
        let [dx, dy, dtheta] = way.motion;
        let step = Pose::new(dx, dy, dtheta);
        self.wheel_motion = compose(self.wheel_motion, step);
        self.wheel_silence = 0.0;
        let per_second = if way.dt > 0.0 { 1.0 / way.dt } else { 0.0 };
        self.wheel_twist = Twist {
            x: dx * per_second,
            y: dy * per_second,
            theta: dtheta * per_second,
        };
    }

    pub(super) fn restart_wheels(&mut self) {
        self.wheel_silence = f32::INFINITY;
    }

    /// One cycle of the net: members filter and tell, the node fuses (eqs 8 and 9).
    ///
    /// `sight`: the pose that vision measured and its covariance; none where vision is lost.
    pub(super) fn fuse(&mut self, sight: Option<(Pose, Matrix3<f32>)>, config: &FilterConfig) {
        // All as deviations from where the node's estimate was, headings as small angles about it.
        let origin = self.fused_pose;
        let commanded = innovation(origin, compose(origin, self.commanded_motion));
        let process = self.command_covariance(config);
        let seen = sight.and_then(|(pose, noise)| {
            let measured = innovation(origin, pose);
            self.vision.update(&commanded, &process, &measured, &noise)
        });
        if seen.is_none() {
            self.vision.covariance += process;
        }
        let driven = self.wheels_active().then(|| {
            let measured = innovation(origin, compose(origin, self.wheel_motion));
            let noise = self.wheel_covariance(config);
            self.odometry
                .update(&commanded, &process, &measured, &noise)
        });
        let driven = driven.flatten();
        if driven.is_none() {
            // Regained, it begins from what the net then knows.
            self.odometry.covariance = self.covariance + process;
        }
        for (part, share) in [
            self.vision.information_increment(seen),
            self.odometry.information_increment(driven),
        ] {
            self.information += part;
            self.information_vector += share;
        }
        let covariance = self.information.try_inverse().filter(|covariance| {
            let variances = covariance.diagonal();
            variances.iter().all(|one| *one > 0.0 && one.is_finite())
        });
        match covariance {
            Some(covariance) if seen.is_some() || driven.is_some() => {
                self.fused_pose = retract(origin, &(covariance * self.information_vector));
                self.covariance = (covariance + covariance.transpose()) * 0.5;
            }
            // No member is left: the commanded motion alone.
            _ => {
                self.fused_pose = compose(origin, self.commanded_motion);
                self.covariance += process;
                (self.information, self.information_vector) = (Matrix3::zeros(), Vector3::zeros());
            }
        }
        self.rebase_information(&innovation(origin, self.fused_pose));
        self.commanded_motion = Pose::new(0.0, 0.0, 0.0);
        self.wheel_motion = Pose::new(0.0, 0.0, 0.0);
        self.elapsed = 0.0;
    }

    /// What was told, as deviations from the new estimate.
    fn rebase_information(&mut self, step: &Vector3<f32>) {
        self.information_vector -= self.information * step;
        for member in [&mut self.vision, &mut self.odometry] {
            if let Some((information, vector)) = &mut member.sent_information {
                *vector -= *information * step;
            }
        }
    }

    fn command_covariance(&self, config: &FilterConfig) -> Matrix3<f32> {
        let own = &config.decentralised;
        let way = own.command_noise * self.commanded_motion.x.hypot(self.commanded_motion.y);
        let turn = own.command_noise * self.commanded_motion.theta;
        let position = way * way + own.command_drift * own.command_drift * self.elapsed;
        let heading = turn * turn + own.command_drift_deg.to_radians().powi(2) * self.elapsed;
        Matrix3::from_diagonal(&Vector3::new(position, position, heading))
    }

    fn wheel_covariance(&self, config: &FilterConfig) -> Matrix3<f32> {
        let way = self.wheel_motion.x.hypot(self.wheel_motion.y);
        let position = config.odometry_noise_per_metre * config.odometry_noise_per_metre * way
            + config.odometry_drift * config.odometry_drift * self.elapsed;
        let heading = config.heading_noise_per_metre_deg.to_radians().powi(2) * way
            + config.heading_noise_per_radian
                * config.heading_noise_per_radian
                * self.wheel_motion.theta.abs()
            + config.odometry_drift_deg.to_radians().powi(2) * self.elapsed;
        // A robot that stands still since its last cycle has moved by nothing, but not by less than the floor.
        Matrix3::from_diagonal(&Vector3::new(position, position, heading).add_scalar(1e-9))
    }

    pub(super) fn inflate_covariance(&mut self, factor: f32) {
        self.covariance *= factor;
        self.vision.covariance *= factor;
        self.odometry.covariance *= factor;
    }

    pub(super) fn half_turned(&self) -> Self {
        let mut other = self.clone();
        let pose = self.fused_pose;
        other.fused_pose = Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI);
        for matrix in [
            &mut other.covariance,
            &mut other.vision.covariance,
            &mut other.odometry.covariance,
        ] {
            for i in 0..2 {
                matrix[(i, 2)] = -matrix[(i, 2)];
                matrix[(2, i)] = -matrix[(2, i)];
            }
        }
        for member in [&mut other.vision, &mut other.odometry] {
            member.sent_information = None;
        }
        (other.information, other.information_vector) = (Matrix3::zeros(), Vector3::zeros());
        other
    }
}

/// A pose moved by a motion in its own frame.
fn compose(pose: Pose, motion: Pose) -> Pose {
    let (sin, cos) = pose.theta.sin_cos();
    Pose::new(
        pose.x + cos * motion.x - sin * motion.y,
        pose.y + sin * motion.x + cos * motion.y,
        pose.theta + motion.theta,
    )
}

/// The same for a motion on an arc.
fn compose_arc(pose: Pose, [x, y, turn]: [f32; 3]) -> Pose {
    let (sin, cos) = (0.5 * turn).sin_cos();
    compose(pose, Pose::new(cos * x - sin * y, sin * x + cos * y, turn))
}
