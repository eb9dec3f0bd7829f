//! Matching of line points to markings: which pose near a given one fits best, and what is its covariance?
//!
//! Minimises Σ e(d(o_i)), e(t) = 1 − c²/(c² + t²) (nubot2013 eq. 4, minho2016 eq. 5), by Gauss-Newton on
//! reweighted squares in place of RPROP (docs/methods.md 5). The c of a point is a multiple of its own standard
//! deviation across its marking, so that near points have larger weights than far ones. The image's tilt (a, b) is
//! estimated together with (x, y, θ) under a prior, since the robot's tilt varies from place to place.

mod config;
pub mod distance_field;
mod learning;
mod minimise;
mod normal_equations;
mod parameters;
mod point_spread;
mod positive_inverse;
mod repeated_errors;
mod rigid_difference;
mod summary;

use crate::frames::Pose;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;
use nalgebra::Matrix3;

pub use config::{MatchConfig, Minimiser};
use normal_equations::{PreparedLanes, PreparedPoint};
pub use parameters::Matrix5;
pub(crate) use parameters::{PARAMETERS, Vector5};
pub use point_spread::SpreadFactor;
use point_spread::{PointSpread, Residual};
pub(crate) use positive_inverse::positive_inverse;
pub use repeated_errors::Repetition;
use repeated_errors::{Remainder, RepeatedErrors};
pub use rigid_difference::RigidDifference;
pub(crate) use summary::information_of;

/// Range of a typical line point, metres.
pub(crate) const TYPICAL_RANGE: f32 = 3.0;

/// Predicted pose before the line points are used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePrior {
    /// Predicted pose.
    pub pose: Pose,
    /// Inverse covariance of (x, y, θ, a, b): m⁻², rad⁻². The tilt is that beyond the compensation of the points.
    pub information: Matrix5,
}

/// Where a match under a prior starts, and as what its points count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchStart {
    /// From where to match; the predicted pose if None.
    pub pose: Option<Pose>,
    /// Possible error of the predicted pose, metres: the reach of the first step.
    pub error: f32,
    /// Tilt beyond the expected one, radians.
    pub tilt: [f32; 2],
    /// The points count as those of a single image, not as one of many of a drive that repeat errors: the robot moved
    /// so much against the prediction that no repeated error explains it.
    pub is_single_image: bool,
}

impl MatchStart {
    /// From the expected tilt, for one of many images.
    pub fn new(error: f32) -> Self {
        MatchStart {
            pose: None,
            error,
            tilt: [0.0; 2],
            is_single_image: false,
        }
    }
}

/// The result of matching: a pose, its covariance and quality.
#[derive(Debug, Clone, PartialEq)]
pub struct Match {
    /// The best pose, from points and prior.
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians; large along unobservable directions.
    pub covariance: Matrix3<f32>,
    /// Squared Mahalanobis distance from the prior pose; 0 without a prior.
    pub mahalanobis_squared: f32,
    /// Tilt (a, b), radians, beyond the compensation of the points (docs/methods.md 3.1).
    pub tilt: [f32; 2],
    /// Of (x, y, θ, a, b).
    pub pose_tilt_covariance: Matrix5,
    /// Variance that the points count with over the one as a single image: above 1 if images on the way repeat errors.
    pub repetition_ratio: f32,
    /// Variance of the points' errors that further images here repeat over that which they count with (docs/methods.md 5.9).
    pub repeated_factor: f32,
    /// Number of parameters that the points determined, at most 5. The prior determined the others.
    pub determined_parameters: f32,
    /// Variance of the residuals over that of the points, from this image alone (docs/methods.md 5.6).
    pub observed_scale: f32,
    /// Variance of the points' errors in the covariance over the one that they state: that of the residuals, and what they
    /// repeat (docs/methods.md 5.6).
    pub variance_scale: f32,
    /// Factor of the variances that the points state (docs/methods.md 5.8).
    pub point_spread: SpreadFactor,
    /// Root mean square distance of the inliers from the markings, metres.
    pub inlier_rms: f32,
    /// Mean distance of all points from the markings, metres (nubot2013 4: "average deviation").
    pub mean_distance: f32,
    /// Share of the points within `kernel_scale_sigmas` of a marking.
    pub inlier_share: f32,
    /// Mean of 1 − e: 1 if all points are on the markings.
    pub score: f32,
    /// Negative log likelihood of the points, Σ c²/2σ² e(d), up to a constant.
    pub cost: f32,
    /// Steps taken.
    pub steps: usize,
}

/// Matches the points of one image; keeps its buffers between images.
#[derive(Debug, Clone)]
pub struct Matcher {
    config: MatchConfig,
    points: Vec<PreparedPoint>,
    /// The same, side by side.
    lanes: Vec<PreparedLanes>,
    prior: PosePrior,
    spread: PointSpread,
    /// Of the present image.
    spread_factor: SpreadFactor,
    repeated: RepeatedErrors,
    residuals: Vec<Residual>,
    remainders: Vec<Remainder>,
    /// Variance of the present image's mean error over that of independent points.
    repetition: f32,
    /// Of the last match.
    last_pass: Option<LastPass>,
}

/// Normal equations at the last state of a match.
#[derive(Debug, Clone, Copy)]
struct LastPass {
    state: Vector5,
    normal: Matrix5,
    gradient: Vector5,
}

/// Information of an unknown pose (m⁻², m⁻², rad⁻²): no field is larger than 30 m, no heading error larger than π.
/// Keeps unobservable directions invertible.
pub(crate) const UNINFORMATIVE_PRIOR: Matrix3<f32> =
    Matrix3::new(1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.1);

impl Matcher {
    /// A matcher with empty buffers.
    pub fn new(config: MatchConfig) -> Self {
        Matcher {
            spread: PointSpread::new(config.spread_learning_std),
            spread_factor: SpreadFactor::default(),
            repeated: RepeatedErrors::new(),
            residuals: Vec::new(),
            remainders: Vec::new(),
            repetition: 1.0,
            config,
            points: Vec::new(),
            lanes: Vec::new(),
            last_pass: None,
            prior: PosePrior {
                pose: Pose::new(0.0, 0.0, 0.0),
                information: Matrix5::identity(),
            },
        }
    }

    /// The configuration in use.
    pub fn config(&self) -> &MatchConfig {
        &self.config
    }

    /// Sets the standard deviation of the tilt beyond the compensation of the points, radians.
    pub fn set_tilt_std(&mut self, std: f32) {
        self.config.tilt_std_deg = std.to_degrees();
    }

    /// Standard deviation of the tilt beyond the compensation of the points, radians.
    pub fn tilt_std(&self) -> f32 {
        self.config.tilt_std_deg.to_radians().max(1e-5)
    }

    /// Displacement of a typical point by the standard deviation of the tilt, metres (docs/methods.md 3.1).
    pub(crate) fn tilt_displacement(&self) -> f32 {
        self.tilt_std() * TYPICAL_RANGE * TYPICAL_RANGE / self.config.viewpoint_height
    }

    /// Negative log probability of a tilt by its prior, up to a constant.
    pub(crate) fn tilt_cost(&self, tilt: [f32; 2]) -> f32 {
        0.5 * self.tilt_information() * tilt.iter().map(|angle| angle * angle).sum::<f32>()
    }

    /// Matches `points` (finite; robot frame) from `start`, whose error is about `start_error` metres.
    ///
    /// The kernel scale starts at `start_error` and shrinks to that of the points, so that a start a few decimetres off
    /// converges.
    pub fn refine(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        start: Pose,
        start_error: f32,
    ) -> Match {
        let uninformative = PosePrior {
            pose: start,
            information: self.uninformative_prior(),
        };
        self.repetition = self.repeated.repetition().image_factor();
        Match {
            mahalanobis_squared: 0.0,
            ..self.minimise(
                distances,
                points,
                uninformative,
                MatchStart::new(start_error),
            )
        }
    }

    /// Matches `points` (finite; robot frame) under a prior: the iterated update of an EKF. Directions that the points
    /// do not determine keep their prior, and a few points cannot rotate the robot.
    pub fn refine_with_prior(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        prior: PosePrior,
        start: MatchStart,
    ) -> Match {
        self.repetition = if start.is_single_image {
            self.repeated.repetition().image_factor()
        } else {
            self.repeated.sequence_factor(prior.pose)
        };
        self.minimise(distances, points, prior, start)
    }

    fn minimise(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        prior: PosePrior,
        start: MatchStart,
    ) -> Match {
        self.prepare(points, prior);
        let Pose { x, y, theta, .. } = start.pose.unwrap_or(prior.pose);
        let [a, b] = start.tilt;
        let mut state = Vector5::from([x, y, theta, a, b]);
        let kernel_factor = self.kernel_start_factor(start.error);
        let steps = match self.config.minimiser {
            Minimiser::GaussNewton => self.gauss_newton(distances, &mut state, kernel_factor),
            Minimiser::Rprop => self.rprop(distances, &mut state, kernel_factor),
        };
        let sums = self.accumulate(distances, &state, 1.0);
        self.last_pass = Some(LastPass {
            state,
            normal: sums.normal,
            gradient: sums.gradient,
        });
        self.summarize(&sums, distances, &state, steps)
    }

    /// The quality of a given pose and tilt (radians), without minimisation.
    pub fn evaluate(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        pose: Pose,
        [a, b]: [f32; 2],
    ) -> Match {
        let information = self.uninformative_prior();
        self.repetition = self.repeated.repetition().image_factor();
        self.prepare(points, PosePrior { pose, information });
        let state = Vector5::from([pose.x, pose.y, pose.theta, a, b]);
        let sums = self.accumulate(distances, &state, 1.0);
        self.summarize(&sums, distances, &state, 0)
    }

    fn prepare(&mut self, points: &[LinePoint], prior: PosePrior) {
        self.prior = prior;
        self.last_pass = None;
        let map_variance = self.config.map_std * self.config.map_std;
        let spread = self.spread.factor();
        self.spread_factor = spread;
        self.points.clear();
        self.points.extend(points.iter().map(|point| {
            let tangential = point.std_tangential * point.std_tangential;
            let radial = point.std_radial * point.std_radial;
            let (x, y) = (point.at.x, point.at.y);
            let squared_range = x * x + y * y;
            let factor = spread.at(squared_range.sqrt());
            PreparedPoint {
                x,
                y,
                tangential_variance: factor * (tangential + map_variance),
                radial_excess_variance: factor * (radial - tangential) / squared_range.max(1e-6),
            }
        }));
        self.lanes.clear();
        self.lanes.extend(PreparedLanes::groups(&self.points));
    }

    /// What is known about errors that repeat.
    pub fn repetition(&self) -> Repetition {
        self.repeated.repetition()
    }

    /// Information of an unknown pose with the tilt's prior.
    fn uninformative_prior(&self) -> Matrix5 {
        let mut information = Matrix5::from_diagonal_element(self.tilt_information());
        information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&UNINFORMATIVE_PRIOR);
        information
    }

    /// 1/σ² of the tilt, bounded so that σ = 0 fixes the robot upright.
    fn tilt_information(&self) -> f32 {
        let std = self.config.tilt_std_deg.to_radians();
        1.0 / (std * std).max(1e-10)
    }

    /// Difference of a state from the prior.
    fn prior_difference(&self, state: &Vector5) -> RigidDifference {
        RigidDifference::between(self.prior.pose, Pose::new(state[0], state[1], state[2]))
    }
}
