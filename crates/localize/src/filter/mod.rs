//! Where is the robot between sights, and how sure? Wheels, inertial unit and matched poses become one belief.
//!
//! `joint` is one filter over everything that moves or errs; `decentralised` is minho2016's net of filters.

mod config;
pub mod decentralised;
pub mod joint;
mod sight;

pub use config::{FilterConfig, Fusion};

use nalgebra::Matrix3;

use crate::frame::Pose;
use crate::matching::{Expected, Match, Matrix5};
use crate::omni::Twist;

use decentralised::Decentralised;
use joint::Joint;
use sight::Shown;

/// A stretch of time between two samples, and what is known of the motion in it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Span {
    /// How long, seconds.
    pub seconds: f32,
    /// What the inertial unit says of it; none where there is none.
    pub felt: Option<Felt>,
    /// What the motors were told.
    pub command: Option<Twist>,
    /// Is the acceleration more than motors can do?
    pub shock: bool,
}

/// What the inertial unit says of a stretch of time, robot frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Felt {
    /// Mean specific force along x and y, gravity's part of it included, m/s².
    pub force: [f32; 2],
    /// Mean rate, rad/s.
    pub rate: [f32; 3],
    /// About z at the stretch's end, rad/s.
    pub spin: f32,
    /// How much the accelerometer's readings scatter beside one another, m/s² (one sigma).
    pub rattle: f32,
    /// From reading to reading, seconds.
    pub interval: f32,
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

/// How is a frame's lean expected to be, beyond what its points were bent by?
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LeanPrior {
    /// As the belief knows of it, errors common with the pose's included.
    Own,
    /// Another one in every frame: none, with this standard deviation, radians.
    Fresh(f32),
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

    /// Lean of the camera and its standard deviation, radians; none where no inertial unit tells.
    pub fn lean(&self) -> Option<([f32; 2], f32)> {
        match self {
            Belief::Joint(joint) => joint.lean(),
            Belief::Decentralised(_) => None,
        }
    }

    /// What a matcher is told beforehand of pose and lean at a frame's exposure.
    pub fn expected(&self, lean: LeanPrior) -> Expected {
        Expected {
            pose: self.pose(),
            information: self
                .sight_covariance(lean)
                .try_inverse()
                .unwrap_or_else(Matrix5::zeros),
        }
    }

    /// Of pose and lean at a frame's exposure, what is not known of the latency included.
    fn sight_covariance(&self, lean: LeanPrior) -> Matrix5 {
        match self {
            Belief::Joint(joint) => joint.sight_covariance(lean),
            Belief::Decentralised(one) => {
                let std = match lean {
                    LeanPrior::Own => 1.0,
                    LeanPrior::Fresh(std) => std,
                };
                let mut full = Matrix5::from_diagonal_element(std * std);
                full.fixed_view_mut::<3, 3>(0, 0)
                    .copy_from(&one.covariance());
                full
            }
        }
    }

    /// Squared deviation of a match under this belief's expectation in its own standard deviations (3 degrees of
    /// freedom): an update x⁺ − x has covariance P − P⁺.
    pub fn surprise(&self, matched: &Match) -> f32 {
        let expected = self.sight_covariance(LeanPrior::Own);
        let expected = expected.fixed_view::<3, 3>(0, 0);
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
        if let Belief::Joint(joint) = self {
            let expected = joint.sight_covariance(LeanPrior::Own);
            if let Some(shown) = sight::fused(joint.pose(), &expected, pose, sight) {
                joint.absorb(&shown, LeanPrior::Own, config);
            }
        }
    }

    /// Takes over what a match found under this belief's expectation, and draws from it what it says about everything
    /// else.
    pub fn absorb(&mut self, matched: &Match, lean: LeanPrior, config: &FilterConfig) {
        match self {
            Belief::Joint(joint) => {
                let shown = Shown {
                    pose: matched.pose,
                    lean: matched.lean,
                    covariance: matched.with_lean,
                };
                joint.absorb(&shown, lean, config);
            }
            Belief::Decentralised(one) => {
                let expected = one.covariance();
                let found = (matched.pose, &matched.covariance);
                let sight = sight::alone(one.pose(), &expected, found.0, found.1);
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
