//! Where is the robot between sights, and how sure? Wheels, inertial unit and matched poses become one belief.
//!
//! `joint` is one filter over everything that moves or errs; `decentralised` is minho2016's net of filters.

mod config;
pub mod decentralised;
pub mod joint;
mod pose_gaussian;

pub use config::{FilterConfig, FilterKind};

use nalgebra::Matrix3;

use crate::frames::Pose;
use crate::matching::{Match, Matrix5, PosePrior};
use crate::omni::Twist;

use decentralised::DecentralisedFilter;
use joint::JointFilter;
use pose_gaussian::PosePosterior;

/// A stretch of time between two samples, and what is known of the motion in it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PredictionInput {
    /// How long, seconds.
    pub dt: f32,
    /// What the inertial unit says of it; none where there is none.
    pub imu: Option<ImuInterval>,
    /// What the motors were told.
    pub command: Option<Twist>,
    /// Is the acceleration more than motors can do?
    pub shock: bool,
}

/// What the inertial unit says of a stretch of time, robot frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuInterval {
    /// Mean specific force along x and y, gravity's part of it included, m/s².
    pub specific_force: [f32; 2],
    /// Mean rate, rad/s.
    pub rate: [f32; 3],
    /// About z at the stretch's end, rad/s.
    pub yaw_rate: f32,
    /// How much the accelerometer's readings scatter beside one another, m/s² (one sigma).
    pub vibration_std: f32,
    /// From reading to reading, seconds.
    pub sample_period: f32,
}

/// What the wheels said of one of their intervals.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelIncrement {
    /// Metres forward and to the left, radians, robot frame at the interval's start.
    pub motion: [f32; 3],
    /// Length of the interval, seconds; 0 if it is the time since the belief began.
    pub dt: f32,
    /// What no motion explains of the wheels' ways, metres.
    pub slip: f32,
    /// Does an inertial unit watch, so that a collision can be told?
    pub imu_active: bool,
}

/// How is a frame's lean expected to be, beyond what its points were bent by?
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TiltPrior {
    /// As the belief knows of it, errors common with the pose's included.
    FromState,
    /// Another one in every frame: none, with this standard deviation, radians.
    Independent(f32),
}

/// Tilt of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiltEstimate {
    /// (a, b), radians (docs/methods.md 3.1).
    pub mean: [f32; 2],
    /// Standard deviation of each component, radians.
    pub std: f32,
}

/// A pose with its uncertainty, and what else is believed of the robot's motion.
#[derive(Debug, Clone, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "one filter is in use; a box would cost every belief an allocation"
)]
pub enum PoseFilter {
    /// See [`Fusion::Joint`].
    Joint(JointFilter),
    /// See [`Fusion::Decentralised`].
    Decentralised(DecentralisedFilter),
}

macro_rules! either {
    ($belief:expr, $one:ident => $call:expr) => {
        match $belief {
            PoseFilter::Joint($one) => $call,
            PoseFilter::Decentralised($one) => $call,
        }
    };
}

impl PoseFilter {
    /// A pose just found; scales and biases of an earlier belief are kept, since wheels and units are the same.
    pub fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        known: Option<&PoseFilter>,
        config: &FilterConfig,
    ) -> Self {
        match config.kind {
            FilterKind::Joint => {
                let known = known.and_then(|known| match known {
                    PoseFilter::Joint(joint) => Some(joint),
                    PoseFilter::Decentralised(_) => None,
                });
                PoseFilter::Joint(JointFilter::new(pose, covariance, known, config))
            }
            FilterKind::Decentralised => {
                PoseFilter::Decentralised(DecentralisedFilter::new(pose, covariance, config))
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
            PoseFilter::Joint(joint) => joint.scales(),
            PoseFilter::Decentralised(_) => [1.0; 2],
        }
    }

    /// The gyro's estimated bias about the vertical, rad/s.
    pub fn gyro_bias(&self) -> f32 {
        match self {
            PoseFilter::Joint(joint) => joint.gyro_bias(),
            PoseFilter::Decentralised(_) => 0.0,
        }
    }

    /// Estimated time from a frame's exposure to its stamp, seconds.
    pub fn latency(&self) -> f32 {
        match self {
            PoseFilter::Joint(joint) => joint.latency(),
            PoseFilter::Decentralised(one) => one.latency(),
        }
    }

    /// Does a collision last, so that the wheels are not believed?
    pub fn in_collision(&self) -> bool {
        either!(self, one => one.in_collision())
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
    pub fn predict(&mut self, span: &PredictionInput, config: &FilterConfig) {
        either!(self, one => one.predict(span, config));
    }

    /// Hears the wheels at the end of their interval.
    pub fn update_wheels(&mut self, way: &WheelIncrement, config: &FilterConfig) {
        either!(self, one => one.update_wheels(way, config));
    }

    /// The wheels' counting was interrupted: it begins anew here.
    pub fn restart_wheels(&mut self) {
        either!(self, one => one.restart_wheels());
    }

    /// The robot stands still, and has for `seconds` more.
    pub fn zero_velocity_update(&mut self, seconds: f32) {
        if let PoseFilter::Joint(joint) = self {
            joint.zero_velocity_update(seconds);
        }
    }

    /// A frame showed nothing.
    pub fn update_without_vision(&mut self, config: &FilterConfig) {
        if let PoseFilter::Decentralised(one) = self {
            one.fuse(None, config);
        }
    }

    /// Lean of the camera and its standard deviation, radians; none where no inertial unit tells.
    pub fn tilt(&self) -> Option<TiltEstimate> {
        match self {
            PoseFilter::Joint(joint) => joint.tilt(),
            PoseFilter::Decentralised(_) => None,
        }
    }

    /// What a matcher is told beforehand of pose and lean at a frame's exposure.
    pub fn pose_prior(&self, lean: TiltPrior) -> PosePrior {
        PosePrior {
            pose: self.pose(),
            information: self
                .predicted_covariance(lean)
                .try_inverse()
                .unwrap_or_else(Matrix5::zeros),
        }
    }

    /// Of pose and lean at a frame's exposure, what is not known of the latency included.
    fn predicted_covariance(&self, lean: TiltPrior) -> Matrix5 {
        match self {
            PoseFilter::Joint(joint) => joint.predicted_covariance(lean),
            PoseFilter::Decentralised(one) => {
                let std = match lean {
                    TiltPrior::FromState => 1.0,
                    TiltPrior::Independent(std) => std,
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
    pub fn normalized_innovation_squared(&self, matched: &Match) -> f32 {
        let expected = self.predicted_covariance(TiltPrior::FromState);
        let expected = expected.fixed_view::<3, 3>(0, 0);
        // Directions that the match left free do not move; a hundredth of P keeps them invertible.
        let update = expected * 1.01 - matched.covariance;
        let innovation = pose_gaussian::innovation(self.pose(), matched.pose);
        update.try_inverse().map_or(0.0, |inverse| {
            innovation.dot(&(inverse * innovation)).max(0.0)
        })
    }

    /// Fuses a pose that was found without this belief's expectation, with its covariance.
    pub fn update_pose(&mut self, pose: Pose, sight: &Matrix3<f32>, config: &FilterConfig) {
        if let PoseFilter::Decentralised(one) = self {
            one.fuse(Some((pose, *sight)), config);
            return;
        }
        if let PoseFilter::Joint(joint) = self {
            let expected = joint.predicted_covariance(TiltPrior::FromState);
            if let Some(shown) = pose_gaussian::kalman_update(joint.pose(), &expected, pose, sight)
            {
                joint.update(&shown, TiltPrior::FromState, config);
            }
        }
    }

    /// Takes over what a match found under this belief's expectation, and draws from it what it says about everything
    /// else.
    pub fn update(&mut self, matched: &Match, lean: TiltPrior, config: &FilterConfig) {
        match self {
            PoseFilter::Joint(joint) => {
                let shown = PosePosterior {
                    pose: matched.pose,
                    lean: matched.tilt,
                    covariance: matched.pose_tilt_covariance,
                };
                joint.update(&shown, lean, config);
            }
            PoseFilter::Decentralised(one) => {
                let expected = one.covariance();
                let found = (matched.pose, &matched.covariance);
                let sight =
                    pose_gaussian::recover_measurement(one.pose(), &expected, found.0, found.1);
                one.fuse(sight, config);
            }
        }
    }

    /// Widens the pose's uncertainty by `factor` (variance): something moved the robot that no witness reported, which
    /// says nothing about scales and biases.
    pub fn inflate_covariance(&mut self, factor: f32) {
        either!(self, one => one.inflate_covariance(factor.max(1.0)));
    }

    /// The same belief seen from the other half of the field.
    pub fn half_turned(&self) -> Self {
        match self {
            PoseFilter::Joint(joint) => PoseFilter::Joint(joint.half_turned()),
            PoseFilter::Decentralised(one) => PoseFilter::Decentralised(one.half_turned()),
        }
    }
}
