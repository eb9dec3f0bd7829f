//! Where is the robot between sights, and how sure? Wheels, inertial unit and matched poses become one belief.
//!
//! `joint` is one filter over everything that moves or errs; `decentralised` is minho2016's net of filters.

pub mod decentralised;
pub mod joint;
mod sight;

use nalgebra::Matrix3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frame::Pose;
use crate::matching::{Expected, Match};
use crate::omni::Twist;

use decentralised::Decentralised;
use joint::Joint;

/// Which filter fuses what the witnesses say?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fusion {
    /// One filter over pose, twist, biases, scales and latency.
    #[default]
    Joint,
    /// A filter for vision, one for odometry, each corrected with the commanded motion, and a node that fuses them
    /// (minho2016 eqs 6–9).
    Decentralised,
}

/// How far each witness of the motion is believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    /// Which filter.
    pub fusion: Fusion,
    /// Random part of the way driven, metres per square root of a metre (slip on carpet).
    pub way_noise: f32,
    /// Random part of the heading per way driven, degrees per square root of a metre.
    pub heading_per_way_noise_deg: f32,
    /// Random part of the turn, radians per square root of a radian.
    pub turn_noise: f32,
    /// Unreported motion, metres per square root of a second.
    pub drift: f32,
    /// Unreported turning, degrees per square root of a second.
    pub drift_deg: f32,
    /// Standard deviation of odometry's scale before it was ever compared with sight; 0 trusts its scale.
    pub scale_std: f32,
    /// How fast the scales wander, per square root of a second (carpet direction, wear, load).
    pub scale_drift: f32,
    /// How fast the noise above is learnt from how far sights deviate from expectations, per frame; 0 keeps it as
    /// stated. 0.02 learns within some seconds.
    pub noise_learning: f32,
    /// Part of a matched pose's error that the next frames repeat (map, field, uneven light), metres: added to every
    /// frame's result, so that a thousand frames do not promise a tenth of a millimetre.
    pub sight_std: f32,
    /// The same of its heading, degrees.
    pub sight_std_deg: f32,
    /// How fast the twist changes unforeseen, m/s per square root of a second, while no inertial unit tells: so much that
    /// wheels alone say how it goes on.
    pub twist_noise: f32,
    /// The same of the turn, rad/s per square root of a second.
    pub spin_noise: f32,
    /// Noise of the gyro, degrees per square root of a second; twice a cheap unit's, for vibration.
    pub gyro_noise_deg: f32,
    /// The gyro's bias before it was ever compared, degrees/s.
    pub gyro_bias_std_deg: f32,
    /// How fast it wanders (warmth), degrees/s per square root of a second.
    pub gyro_bias_drift_deg: f32,
    /// Noise of the accelerometer, m/s per square root of a second: a cheap unit's 0.015, vibration, and what of gravity
    /// a lean of half a degree lets through.
    pub accelerometer_noise: f32,
    /// Its bias before it was ever compared, and what a lean adds to it, m/s².
    pub accelerometer_bias_std: f32,
    /// How fast that wanders (leaning), m/s² per square root of a second.
    pub accelerometer_bias_drift: f32,
    /// Time from the exposure of a frame to its stamp, seconds; 0 where stamps are those of the exposure.
    pub camera_latency: f32,
    /// How far `camera_latency` may be off, seconds: it is then estimated while driving; 0 takes it as stated.
    pub camera_latency_std: f32,
    /// When wheels are not believed.
    pub collision: crate::collision::CollisionConfig,
    /// The members of the decentralised filter.
    pub decentralised: decentralised::DecentralisedConfig,
}

impl Default for FilterConfig {
    fn default() -> Self {
        FilterConfig {
            fusion: Fusion::default(),
            way_noise: 0.02,
            heading_per_way_noise_deg: 0.7,
            turn_noise: 0.03,
            drift: 0.01,
            drift_deg: 0.6,
            scale_std: 0.05,
            scale_drift: 0.0005,
            noise_learning: 0.02,
            sight_std: 0.0015,
            sight_std_deg: 0.04,
            twist_noise: 10.0,
            spin_noise: 20.0,
            gyro_noise_deg: 0.06,
            gyro_bias_std_deg: 1.0,
            gyro_bias_drift_deg: 0.005,
            accelerometer_noise: 0.1,
            accelerometer_bias_std: 0.3,
            accelerometer_bias_drift: 0.01,
            camera_latency: 0.0,
            camera_latency_std: 0.0,
            collision: crate::collision::CollisionConfig::default(),
            decentralised: decentralised::DecentralisedConfig::default(),
        }
    }
}

/// A stretch of time between two samples, and what is known of the motion in it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Span {
    /// How long, seconds.
    pub seconds: f32,
    /// Horizontal acceleration, robot frame, m/s²; none where no inertial unit tells.
    pub acceleration: Option<[f32; 2]>,
    /// What the motors were told.
    pub command: Option<Twist>,
    /// Is the acceleration more than motors can do?
    pub shock: bool,
}

/// What the wheels said of one of their intervals.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Way {
    /// Metres forward and to the left, radians, robot frame at the interval's start.
    pub motion: [f32; 3],
    /// Length of the interval, seconds; 0 if it is the time since the belief began.
    pub seconds: f32,
    /// What no motion explains of the wheels' ways, metres.
    pub slip: f32,
    /// Does an inertial unit watch, so that a collision can be told?
    pub watched: bool,
}

/// A pose with its uncertainty, and what else is believed of the robot's motion.
#[derive(Debug, Clone, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "one filter is in use; a box would cost every belief an allocation"
)]
pub enum Belief {
    /// See [`Fusion::Joint`].
    Joint(Joint),
    /// See [`Fusion::Decentralised`].
    Decentralised(Decentralised),
}

macro_rules! either {
    ($belief:expr, $one:ident => $call:expr) => {
        match $belief {
            Belief::Joint($one) => $call,
            Belief::Decentralised($one) => $call,
        }
    };
}

impl Belief {
    /// A pose just found; scales and biases of an earlier belief are kept, since wheels and units are the same.
    pub fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        known: Option<&Belief>,
        config: &FilterConfig,
    ) -> Self {
        match config.fusion {
            Fusion::Joint => {
                let known = known.and_then(|known| match known {
                    Belief::Joint(joint) => Some(joint),
                    Belief::Decentralised(_) => None,
                });
                Belief::Joint(Joint::new(pose, covariance, known, config))
            }
            Fusion::Decentralised => {
                Belief::Decentralised(Decentralised::new(pose, covariance, config))
            }
        }
    }

    /// The expected pose.
    pub fn pose(&self) -> Pose {
        either!(self, one => one.pose())
    }

    /// Of (x, y, θ), metres and radians.
    pub fn covariance(&self) -> Matrix3<f32> {
        either!(self, one => one.covariance())
    }

    /// The robot's velocity in its own frame.
    pub fn twist(&self) -> Twist {
        either!(self, one => one.twist())
    }

    /// Estimated scales of the odometry: metres per metre, radians per radian.
    pub fn scales(&self) -> [f32; 2] {
        match self {
            Belief::Joint(joint) => joint.scales(),
            Belief::Decentralised(_) => [1.0; 2],
        }
    }

    /// The gyro's estimated bias about the vertical, rad/s.
    pub fn gyro_bias(&self) -> f32 {
        match self {
            Belief::Joint(joint) => joint.gyro_bias(),
            Belief::Decentralised(_) => 0.0,
        }
    }

    /// Estimated time from a frame's exposure to its stamp, seconds.
    pub fn latency(&self) -> f32 {
        match self {
            Belief::Joint(joint) => joint.latency(),
            Belief::Decentralised(one) => one.latency(),
        }
    }

    /// Does a collision last, so that the wheels are not believed?
    pub fn colliding(&self) -> bool {
        either!(self, one => one.colliding())
    }

    /// Largest standard deviation of the position in any direction, metres.
    pub fn position_std(&self) -> f32 {
        let p = self.covariance();
        let mean = 0.5 * (p[(0, 0)] + p[(1, 1)]);
        let half = 0.5 * (p[(0, 0)] - p[(1, 1)]);
        (mean + half.hypot(p[(0, 1)])).max(0.0).sqrt()
    }

    /// Standard deviation of the heading, radians.
    pub fn heading_std(&self) -> f32 {
        self.covariance()[(2, 2)].max(0.0).sqrt()
    }

    /// Moves on by a stretch of time.
    pub fn advance(&mut self, span: &Span, config: &FilterConfig) {
        either!(self, one => one.advance(span, config));
    }

    /// Hears the wheels at the end of their interval.
    pub fn wheels(&mut self, way: &Way, config: &FilterConfig) {
        either!(self, one => one.wheels(way, config));
    }

    /// The wheels' counting was interrupted: it begins anew here.
    pub fn wheels_interrupted(&mut self) {
        either!(self, one => one.wheels_interrupted());
    }

    /// Hears the gyro: rate about the vertical, rad/s, of the last `seconds`.
    pub fn gyro(&mut self, rate: f32, seconds: f32, config: &FilterConfig) {
        if let Belief::Joint(joint) = self {
            joint.gyro(rate, seconds, config);
        }
    }

    /// The robot stands still, and has for `seconds` more.
    pub fn rest(&mut self, seconds: f32) {
        if let Belief::Joint(joint) = self {
            joint.rest(seconds);
        }
    }

    /// A frame showed nothing.
    pub fn unseen(&mut self, config: &FilterConfig) {
        if let Belief::Decentralised(one) = self {
            one.cycle(None, config);
        }
    }

    /// What a matcher is told beforehand of the pose at a frame's exposure.
    pub fn expected(&self) -> Expected {
        Expected {
            pose: self.pose(),
            information: self
                .sight_covariance()
                .try_inverse()
                .unwrap_or_else(Matrix3::zeros),
        }
    }

    /// Of the pose at a frame's exposure, what is not known of the latency included.
    fn sight_covariance(&self) -> Matrix3<f32> {
        match self {
            Belief::Joint(joint) => joint.sight_covariance(),
            Belief::Decentralised(one) => one.covariance(),
        }
    }

    /// Squared deviation of a match under this belief's expectation in its own standard deviations (3 degrees of
    /// freedom): an update x⁺ − x has covariance P − P⁺.
    pub fn surprise(&self, matched: &Match) -> f32 {
        let expected = self.sight_covariance();
        // Directions that the match left free do not move; a hundredth of P keeps them invertible.
        let update = expected * 1.01 - matched.covariance;
        let innovation = sight::innovation(self.pose(), matched.pose);
        update.try_inverse().map_or(0.0, |inverse| {
            innovation.dot(&(inverse * innovation)).max(0.0)
        })
    }

    /// Fuses a pose that was found without this belief's expectation, with its covariance.
    pub fn correct(&mut self, pose: Pose, sight: &Matrix3<f32>, config: &FilterConfig) {
        if let Belief::Decentralised(one) = self {
            one.cycle(Some((pose, *sight)), config);
            return;
        }
        let expected = self.sight_covariance();
        if let Some((fused, left)) = sight::fused(self.pose(), &expected, pose, sight) {
            self.absorb(fused, &left, config);
        }
    }

    /// Takes over the pose and covariance that a match found under this belief's expectation, and draws from it what
    /// it says about everything else.
    pub fn absorb(&mut self, pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) {
        match self {
            Belief::Joint(joint) => joint.absorb(pose, covariance, config),
            Belief::Decentralised(one) => {
                let expected = one.covariance();
                let sight = sight::alone(one.pose(), &expected, pose, covariance);
                one.cycle(sight, config);
            }
        }
    }

    /// Widens the pose's uncertainty by `factor` (variance): something moved the robot that no witness reported, which
    /// says nothing about scales and biases.
    pub fn widen(&mut self, factor: f32) {
        either!(self, one => one.widen(factor.max(1.0)));
    }

    /// The same belief seen from the other half of the field.
    pub fn half_turned(&self) -> Self {
        match self {
            Belief::Joint(joint) => Belief::Joint(joint.half_turned()),
            Belief::Decentralised(one) => Belief::Decentralised(one.half_turned()),
        }
    }
}
