//! How does minho2016 fuse vision with odometry? Two filters, each corrected with the commanded motion, and a node.
//!
//! IV.C: every member (vision, odometry) is a Kalman filter that predicts with what the motors were told and corrects
//! with what its sensor measured. The fusing node adds what each member learnt since the last cycle, as information
//! (eqs 6–9). The members go on from the node's estimate ("the local estimates are corrected using global
//! information"), so that odometry cannot run away. Headings are kept unwrapped within a cycle.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sight::{innovation, moved};
use super::{FilterConfig, Span, Way};
use crate::collision::Collision;
use crate::frame::{Pose, wrap_angle};
use crate::omni::Twist;

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
    pub silence: f32,
}

impl Default for DecentralisedConfig {
    fn default() -> Self {
        DecentralisedConfig {
            command_noise: 0.3,
            command_drift: 0.05,
            command_drift_deg: 3.0,
            silence: 0.2,
        }
    }
}

/// A local filter; information is what the node last heard of it, none while it is lost.
#[derive(Debug, Clone, PartialEq)]
struct Member {
    covariance: Matrix3<f32>,
    told: Option<(Matrix3<f32>, Vector3<f32>)>,
}

impl Member {
    fn new(covariance: Matrix3<f32>) -> Self {
        Member {
            covariance,
            told: None,
        }
    }

    /// The local Kalman filter: predicted deviation and noise, measured deviation and noise, both from the node's
    /// last estimate. Its deviation; none if nothing can be inverted.
    fn filter(
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
    fn tell(&mut self, deviation: Option<Vector3<f32>>) -> (Matrix3<f32>, Vector3<f32>) {
        let now = deviation.and_then(|deviation| {
            let information = self.covariance.try_inverse()?;
            Some((information, information * deviation))
        });
        let nothing = (Matrix3::zeros(), Vector3::zeros());
        let (before, after) = (self.told.unwrap_or(nothing), now.unwrap_or(nothing));
        self.told = now;
        (after.0 - before.0, after.1 - before.1)
    }
}

/// The net of filters.
#[derive(Debug, Clone, PartialEq)]
pub struct Decentralised {
    /// The node's estimate after its last cycle.
    fused: Pose,
    covariance: Matrix3<f32>,
    /// The node's P⁻¹ and P⁻¹X, X as deviation from `fused`: nothing before a member told something.
    information: Matrix3<f32>,
    vector: Vector3<f32>,
    vision: Member,
    odometry: Member,
    /// Motion since the last cycle, in the robot's frame then: as commanded, and as the wheels report it.
    commanded: Pose,
    driven: Pose,
    /// Since the last cycle, and since the wheels were heard, seconds.
    elapsed: f32,
    silent: f32,
    command: Twist,
    rate: Twist,
    latency: f32,
    collision: Collision,
}

impl Decentralised {
    pub(super) fn new(pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) -> Self {
        Decentralised {
            fused: pose,
            covariance: *covariance,
            information: Matrix3::zeros(),
            vector: Vector3::zeros(),
            vision: Member::new(*covariance),
            odometry: Member::new(*covariance),
            commanded: Pose::new(0.0, 0.0, 0.0),
            driven: Pose::new(0.0, 0.0, 0.0),
            elapsed: 0.0,
            silent: 0.0,
            command: Twist::default(),
            rate: Twist::default(),
            latency: config.camera_latency,
            collision: Collision::default(),
        }
    }

    /// The node's estimate, moved on by what the wheels report, or else by what the motors were told.
    pub(super) fn pose(&self) -> Pose {
        let motion = if self.wheels_are_member() {
            self.driven
        } else {
            self.commanded
        };
        on(self.fused, motion)
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.covariance
    }

    pub(super) fn twist(&self) -> Twist {
        if self.wheels_are_member() {
            self.rate
        } else {
            self.command
        }
    }

    pub(super) fn latency(&self) -> f32 {
        self.latency
    }

    pub(super) fn colliding(&self) -> bool {
        self.collision.lasts()
    }

    fn wheels_are_member(&self) -> bool {
        self.silent.is_finite() && !self.collision.lasts()
    }

    pub(super) fn advance(&mut self, span: &Span, config: &FilterConfig) {
        if span.shock {
            self.collision.hit(&config.collision);
        }
        self.collision.pass(span.seconds);
        self.elapsed += span.seconds;
        self.silent += span.seconds;
        if self.silent > config.decentralised.silence {
            self.silent = f32::INFINITY;
        }
        self.command = span.command.unwrap_or(self.rate);
        let step = self.command.scaled(span.seconds);
        self.commanded = arc(self.commanded, [step.x, step.y, step.theta]);
    }

    pub(super) fn wheels(&mut self, way: &Way, _config: &FilterConfig) {
        let [dx, dy, dtheta] = way.motion;
        let step = Pose::new(dx, dy, dtheta);
        self.driven = on(self.driven, step);
        self.silent = 0.0;
        let per_second = if way.seconds > 0.0 {
            1.0 / way.seconds
        } else {
            0.0
        };
        self.rate = Twist {
            x: dx * per_second,
            y: dy * per_second,
            theta: dtheta * per_second,
        };
    }

    pub(super) fn wheels_interrupted(&mut self) {
        self.silent = f32::INFINITY;
    }

    /// One cycle of the net: members filter and tell, the node fuses (eqs 8 and 9).
    ///
    /// `sight`: the pose that vision measured and its covariance; none where vision is lost.
    pub(super) fn cycle(&mut self, sight: Option<(Pose, Matrix3<f32>)>, config: &FilterConfig) {
        // All as deviations from where the node's estimate was, headings as small angles about it.
        let origin = self.fused;
        let commanded = innovation(origin, on(origin, self.commanded));
        let process = self.command_noise(config);
        let seen = sight.and_then(|(pose, noise)| {
            let measured = innovation(origin, pose);
            self.vision.filter(&commanded, &process, &measured, &noise)
        });
        if seen.is_none() {
            self.vision.covariance += process;
        }
        let driven = self.wheels_are_member().then(|| {
            let measured = innovation(origin, on(origin, self.driven));
            let noise = self.wheel_noise(config);
            self.odometry
                .filter(&commanded, &process, &measured, &noise)
        });
        let driven = driven.flatten();
        if driven.is_none() {
            // Regained, it begins from what the net then knows.
            self.odometry.covariance = self.covariance + process;
        }
        for (part, share) in [self.vision.tell(seen), self.odometry.tell(driven)] {
            self.information += part;
            self.vector += share;
        }
        let covariance = self.information.try_inverse().filter(|covariance| {
            let variances = covariance.diagonal();
            variances.iter().all(|one| *one > 0.0 && one.is_finite())
        });
        match covariance {
            Some(covariance) if seen.is_some() || driven.is_some() => {
                self.fused = moved(origin, &(covariance * self.vector));
                self.covariance = (covariance + covariance.transpose()) * 0.5;
            }
            // No member is left: the commanded motion alone.
            _ => {
                self.fused = on(origin, self.commanded);
                self.covariance += process;
                (self.information, self.vector) = (Matrix3::zeros(), Vector3::zeros());
            }
        }
        self.rebase(&innovation(origin, self.fused));
        self.commanded = Pose::new(0.0, 0.0, 0.0);
        self.driven = Pose::new(0.0, 0.0, 0.0);
        self.elapsed = 0.0;
    }

    /// What was told, as deviations from the new estimate.
    fn rebase(&mut self, step: &Vector3<f32>) {
        self.vector -= self.information * step;
        for member in [&mut self.vision, &mut self.odometry] {
            if let Some((information, vector)) = &mut member.told {
                *vector -= *information * step;
            }
        }
    }

    fn command_noise(&self, config: &FilterConfig) -> Matrix3<f32> {
        let own = &config.decentralised;
        let way = own.command_noise * self.commanded.x.hypot(self.commanded.y);
        let turn = own.command_noise * self.commanded.theta;
        let position = way * way + own.command_drift * own.command_drift * self.elapsed;
        let heading = turn * turn + own.command_drift_deg.to_radians().powi(2) * self.elapsed;
        Matrix3::from_diagonal(&Vector3::new(position, position, heading))
    }

    fn wheel_noise(&self, config: &FilterConfig) -> Matrix3<f32> {
        let way = self.driven.x.hypot(self.driven.y);
        let position =
            config.way_noise * config.way_noise * way + config.drift * config.drift * self.elapsed;
        let heading = config.heading_per_way_noise_deg.to_radians().powi(2) * way
            + config.turn_noise * config.turn_noise * self.driven.theta.abs()
            + config.drift_deg.to_radians().powi(2) * self.elapsed;
        // A robot that stands still since its last cycle has moved by nothing, but not by less than the floor.
        Matrix3::from_diagonal(&Vector3::new(position, position, heading).add_scalar(1e-9))
    }

    pub(super) fn widen(&mut self, factor: f32) {
        self.covariance *= factor;
        self.vision.covariance *= factor;
        self.odometry.covariance *= factor;
    }

    pub(super) fn half_turned(&self) -> Self {
        let mut other = self.clone();
        let pose = self.fused;
        other.fused = Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI);
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
            member.told = None;
        }
        (other.information, other.vector) = (Matrix3::zeros(), Vector3::zeros());
        other
    }
}

/// A pose moved by a motion in its own frame.
fn on(pose: Pose, motion: Pose) -> Pose {
    let (sin, cos) = pose.theta.sin_cos();
    Pose::new(
        pose.x + cos * motion.x - sin * motion.y,
        pose.y + sin * motion.x + cos * motion.y,
        pose.theta + motion.theta,
    )
}

/// The same for a motion on an arc.
fn arc(pose: Pose, [x, y, turn]: [f32; 3]) -> Pose {
    let (sin, cos) = (0.5 * turn).sin_cos();
    on(pose, Pose::new(cos * x - sin * y, sin * x + cos * y, turn))
}
