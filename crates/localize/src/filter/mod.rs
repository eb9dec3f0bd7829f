//! Pose filters: fusion of wheels, inertial unit and matched images (docs/methods.md 8).
//!
//! `joint` is one extended Kalman filter over motion and sensor errors. `decentralised` is the filter of minho2016,
//! `curvature` that of nubot2013.

mod config;
pub mod curvature;
mod dead_reckoning;
pub mod decentralised;
mod inputs;
pub mod joint;
pub(crate) mod log_variance;
mod pose_gaussian;

pub use config::{FilterConfig, FilterKind};
pub use inputs::{
    ImuInterval, MotionEstimate, PredictionInput, TiltEstimate, TiltPrior, WheelIncrement,
};

use nalgebra::{Matrix3, Vector3};

use crate::frames::Pose;
use crate::matching::{
    Match, Matrix5, PARAMETERS, PosePrior, RigidDifference, UNINFORMATIVE_PRIOR, information_of,
};
use crate::math;
use crate::omni::{Twist, UNCORRECTED_MOTION};
use crate::wheel_steps::OriginOffset;

use curvature::CurvatureFilter;
use decentralised::DecentralisedFilter;
use joint::JointFilter;
pub use joint::{ERRORS_PER_MATE, MateInnovation, MateMeasurement, OdometryPrior};
use pose_gaussian::{PoseMeasurement, PosePosterior};

/// Estimate of pose and motion with its covariance.
#[derive(Debug, Clone, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "one filter is in use; a box would cost each filter an allocation"
)]
pub enum PoseFilter {
    /// See [`FilterKind::Joint`].
    Joint(JointFilter),
    /// See [`FilterKind::Decentralised`].
    Decentralised(DecentralisedFilter),
    /// See [`FilterKind::Curvature`].
    Curvature(CurvatureFilter),
}

macro_rules! either {
    ($either:expr, $filter:ident => $call:expr) => {
        match $either {
            PoseFilter::Joint($filter) => $call,
            PoseFilter::Decentralised($filter) => $call,
            PoseFilter::Curvature($filter) => $call,
        }
    };
}

impl PoseFilter {
    /// A filter at a new pose. Scales and biases of the `previous` filter are kept, since the sensors are the same.
    pub fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        previous: Option<&PoseFilter>,
        config: &FilterConfig,
        odometry_prior: &OdometryPrior,
    ) -> Self {
        match config.kind {
            FilterKind::Joint => {
                let previous = previous.and_then(|previous| match previous {
                    PoseFilter::Joint(joint) => Some(joint),
                    PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => None,
                });
                PoseFilter::Joint(JointFilter::new(
                    pose,
                    covariance,
                    previous,
                    config,
                    odometry_prior,
                ))
            }
            FilterKind::Decentralised => {
                PoseFilter::Decentralised(DecentralisedFilter::new(pose, covariance, config))
            }
            FilterKind::Curvature => {
                PoseFilter::Curvature(CurvatureFilter::new(pose, covariance, config))
            }
        }
    }

    /// The estimated pose.
    pub fn pose(&self) -> Pose {
        either!(self, filter => filter.pose())
    }

    /// Of (x, y, θ), metres and radians.
    pub fn covariance(&self) -> Matrix3<f32> {
        either!(self, filter => filter.covariance())
    }

    /// Velocity in the robot frame.
    pub fn twist(&self) -> Twist {
        either!(self, filter => filter.twist())
    }

    /// Estimated scales of the odometry: metres per metre, radians per radian.
    pub fn scales(&self) -> [f32; 2] {
        match self {
            PoseFilter::Joint(joint) => joint.scales(),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => [1.0; 2],
        }
    }

    /// Estimated matrix from the measured motion (x, y, θ) of the wheels to the true one.
    pub fn odometry_correction(&self) -> [[f32; 3]; 3] {
        match self {
            PoseFilter::Joint(joint) => joint.odometry_correction(),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => UNCORRECTED_MOTION,
        }
    }

    /// Where the poses' origin lies about the point that the wheels turn about. None before enough steps, and if the filter does not
    /// measure it.
    pub fn origin_offset(&self) -> Option<OriginOffset> {
        match self {
            PoseFilter::Joint(joint) => joint.origin_offset(),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => None,
        }
    }

    /// Estimated gyro bias about z, rad/s.
    pub fn gyro_bias(&self) -> f32 {
        match self {
            PoseFilter::Joint(joint) => joint.gyro_bias(),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => 0.0,
        }
    }

    /// Estimated time from an image's exposure to its stamp, seconds.
    pub fn latency(&self) -> f32 {
        either!(self, filter => filter.latency())
    }

    /// Is a collision in progress, so that wheel samples are skipped?
    pub fn in_collision(&self) -> bool {
        either!(self, filter => filter.in_collision())
    }

    /// Largest standard deviation of the position in any direction, metres.
    pub fn position_std(&self) -> f32 {
        let p = self.covariance();
        let mean = 0.5 * (p[(0, 0)] + p[(1, 1)]);
        let half_difference = 0.5 * (p[(0, 0)] - p[(1, 1)]);
        (mean + math::hypot(half_difference, p[(0, 1)]))
            .max(0.0)
            .sqrt()
    }

    /// Standard deviation of the heading, radians.
    pub fn heading_std(&self) -> f32 {
        self.covariance()[(2, 2)].max(0.0).sqrt()
    }

    /// Predicts over an interval.
    pub fn predict(&mut self, input: &PredictionInput, config: &FilterConfig) {
        either!(self, filter => filter.predict(input, config));
    }

    /// Updates by the wheels at the end of their interval.
    pub fn update_wheels(&mut self, increment: &WheelIncrement, config: &FilterConfig) {
        either!(self, filter => filter.update_wheels(increment, config));
    }

    /// Begins a new wheel interval without an update.
    pub fn restart_wheels(&mut self) {
        if let PoseFilter::Joint(joint) = self {
            joint.interrupt_steps();
        }
        either!(self, filter => filter.restart_wheels());
    }

    /// Updates by an interval of `seconds` in which the robot stood still.
    pub fn zero_velocity_update(&mut self, seconds: f32) {
        if let PoseFilter::Joint(joint) = self {
            joint.zero_velocity_update(seconds);
        }
    }

    /// The motion of [`PoseFilter::image_motion`] begins anew: an image was processed.
    pub fn begin_image_motion(&mut self) {
        if let PoseFilter::Joint(joint) = self {
            joint.begin_image_motion();
        }
    }

    /// Motion since the last image by all sensors and by the images themselves. None for a new filter, and if the filter does not
    /// know it.
    pub fn image_motion(&self) -> Option<MotionEstimate> {
        match self {
            PoseFilter::Joint(joint) => joint.image_motion(),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => None,
        }
    }

    /// Takes note of an image without enough line points.
    pub fn update_without_vision(&mut self) {
        if let PoseFilter::Decentralised(filter) = self {
            filter.fuse(None);
        }
    }

    /// Tilt of the camera. None without an inertial unit.
    pub fn tilt(&self) -> Option<TiltEstimate> {
        match self {
            PoseFilter::Joint(joint) => joint.tilt(),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => None,
        }
    }

    /// Prior of pose and tilt at an image's exposure, for the matcher.
    ///
    /// The curvature filter has none: its match depends on the points alone and starts at the predicted pose.
    pub fn pose_prior(&self, tilt_prior: TiltPrior) -> PosePrior {
        let predicted = self.predicted_covariance(tilt_prior);
        let mut information = information_of(&predicted)
            .or_else(|| predicted.try_inverse())
            .unwrap_or_else(Matrix5::zeros);
        if matches!(self, PoseFilter::Curvature(_)) {
            information
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&UNINFORMATIVE_PRIOR);
        }
        PosePrior {
            pose: self.pose(),
            information,
        }
    }

    /// S: covariance of (x, y, θ, a, b) at an image's exposure, including the latency's uncertainty.
    fn predicted_covariance(&self, tilt_prior: TiltPrior) -> Matrix5 {
        match self {
            PoseFilter::Joint(joint) => joint.predicted_covariance(tilt_prior),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => {
                let std = match tilt_prior {
                    TiltPrior::FromState { .. } => 1.0,
                    TiltPrior::Independent(std) => std,
                };
                let mut full = Matrix5::from_diagonal_element(std * std);
                full.fixed_view_mut::<3, 3>(0, 0)
                    .copy_from(&self.covariance());
                full
            }
        }
    }

    /// D² of docs/methods.md 8.9 with 3 degrees of freedom: the match against the prediction, under the update's
    /// covariance S − P_y.
    pub fn normalized_innovation_squared(&self, matched: &Match) -> f32 {
        let predicted = self.predicted_covariance(TiltPrior::STATE);
        let predicted = predicted.fixed_view::<3, 3>(0, 0);
        let difference = RigidDifference::between(self.pose(), matched.pose);
        // Directions that the match left free are not updated. A tenth of S keeps them invertible: the matcher's robust
        // error moves them a little, too.
        let covariance = match self {
            // The match does not contain the prediction: S + R.
            PoseFilter::Curvature(_) => predicted + matched.covariance,
            _ => predicted * 1.1 - difference.pose_covariance(&matched.covariance),
        };
        let innovation = difference.deviation;
        covariance.try_inverse().map_or(0.0, |inverse| {
            innovation.dot(&(inverse * innovation)).max(0.0)
        })
    }

    /// D² of docs/methods.md 5.9: how far the points alone lie from the prediction, if they counted as those of a single
    /// image. `map`: covariance of the pose by an uncertain map, which may be the reason. None without information.
    pub fn single_image_innovation_squared(
        &self,
        matched: &Match,
        map: &Matrix3<f32>,
    ) -> Option<f32> {
        let predicted = self.predicted_covariance(TiltPrior::STATE);
        let predicted = predicted.fixed_view::<3, 3>(0, 0).into_owned();
        let before = predicted.try_inverse()?;
        let difference = RigidDifference::between(self.pose(), matched.pose);
        let after = difference
            .pose_covariance(&matched.covariance)
            .try_inverse()?;
        // A hundredth of the prior's information keeps directions without markings invertible.
        let noise = (after - before * 0.99).try_inverse()?;
        let innovation = noise * after * difference.deviation;
        let covariance = predicted + noise / matched.repetition_ratio + map;
        Some(innovation.dot(&(covariance.try_inverse()? * innovation)))
    }

    /// Updates by a pose that was measured independently of the prediction.
    pub fn update_pose(&mut self, pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) {
        let measurement = PoseMeasurement {
            pose,
            covariance: *covariance,
        };
        match self {
            PoseFilter::Joint(joint) => {
                let predicted = joint.predicted_covariance(TiltPrior::STATE);
                let posterior =
                    pose_gaussian::kalman_update(joint.pose(), &predicted, &measurement);
                if let Some(posterior) = posterior {
                    joint.update(&posterior, TiltPrior::STATE, config);
                }
            }
            PoseFilter::Decentralised(filter) => filter.fuse(Some(measurement)),
            PoseFilter::Curvature(filter) => filter.update(&measurement),
        }
    }

    /// Updates by a match that already contains this filter's prediction (docs/methods.md 8.7).
    pub fn update(&mut self, matched: &Match, tilt_prior: TiltPrior, config: &FilterConfig) {
        match self {
            PoseFilter::Joint(joint) => {
                let posterior = PosePosterior {
                    pose: matched.pose,
                    tilt: matched.tilt,
                    covariance: matched.pose_tilt_covariance,
                };
                joint.update(&posterior, tilt_prior, config);
            }
            PoseFilter::Decentralised(filter) => {
                let posterior = PoseMeasurement {
                    pose: matched.pose,
                    covariance: matched.covariance,
                };
                let measurement = pose_gaussian::recover_measurement(
                    filter.pose(),
                    &filter.covariance(),
                    &posterior,
                );
                filter.fuse(measurement);
            }
            PoseFilter::Curvature(filter) => filter.update(&PoseMeasurement {
                pose: matched.pose,
                covariance: matched.covariance,
            }),
        }
    }

    /// Learns the wheels' noise from a match under this filter's prediction that [`PoseFilter::update`] will not take.
    pub fn learn_noise(&mut self, matched: &Match, tilt_prior: TiltPrior) {
        if let PoseFilter::Joint(joint) = self {
            let posterior = PosePosterior {
                pose: matched.pose,
                tilt: matched.tilt,
                covariance: matched.pose_tilt_covariance,
            };
            joint.learn_wheel_noise(&posterior, tilt_prior);
        }
    }

    /// Innovation of a mate's measurement (docs/methods.md 12.5). `error_time`: for which the mate's errors last, seconds.
    ///
    /// None if there are too many mates. Only the joint filter knows mates.
    pub fn mate_innovation(
        &mut self,
        measurement: &MateMeasurement,
        error_time: f32,
    ) -> Option<MateInnovation> {
        match self {
            PoseFilter::Joint(joint) => joint.mate_innovation(measurement, error_time),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => None,
        }
    }

    /// Updates by a mate's measurement whose innovation was accepted.
    pub fn update_by_mate(&mut self, measurement: &MateMeasurement, config: &FilterConfig) {
        if let PoseFilter::Joint(joint) = self {
            joint.update_by_mate(measurement, config);
        }
    }

    /// Adds errors of these standard deviations to the pose, metres and radians.
    pub fn doubt_pose(&mut self, position_std: f32, heading_std: f32) {
        if let PoseFilter::Joint(joint) = self {
            joint.doubt_pose(position_std, heading_std);
        }
    }

    /// Multiplies the pose's covariance by `factor` after an unreported motion. Scales and biases keep theirs.
    pub fn inflate_covariance(&mut self, factor: f32) {
        either!(self, filter => filter.inflate_covariance(factor.max(1.0)));
    }

    /// Admits a motion that no sensor reported: as far in any direction as the one that was seen, metres and radians. What the
    /// image says nothing about stays as certain as that.
    pub fn admit_motion(&mut self, [x, y, theta]: [f32; 3]) {
        match self {
            PoseFilter::Joint(joint) => joint.admit_motion(math::hypot(x, y), theta.abs()),
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => {
                let motion = Vector3::new(x, y, theta);
                let information = self.covariance().try_inverse();
                let factor =
                    information.map_or(1.0, |information| motion.dot(&(information * motion)));
                self.inflate_covariance(factor);
            }
        }
    }

    /// Moves pose (x, y, θ) and camera tilt (a, b) by a step that a correction of the map implies. Covariances stay.
    pub fn shift_pose(&mut self, step: [f32; PARAMETERS]) {
        match self {
            PoseFilter::Joint(joint) => joint.shift_pose(step),
            // The members measure the pose again with the next images.
            PoseFilter::Decentralised(_) | PoseFilter::Curvature(_) => {}
        }
    }

    /// What was seen of [`PoseFilter::origin_offset`] is of an earlier map.
    pub fn forget_origin(&mut self) {
        if let PoseFilter::Joint(joint) = self {
            joint.forget_origin();
        }
    }

    /// The same estimate in the other field half.
    pub fn half_turned(&self) -> Self {
        match self {
            PoseFilter::Joint(joint) => PoseFilter::Joint(joint.half_turned()),
            PoseFilter::Decentralised(filter) => PoseFilter::Decentralised(filter.half_turned()),
            PoseFilter::Curvature(filter) => PoseFilter::Curvature(filter.half_turned()),
        }
    }
}
