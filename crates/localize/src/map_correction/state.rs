//! The estimate of a map's unknowns with what its parts need from image to image.

use super::basis::MapBasis;
use super::block::Block;
use super::certainty::{Claim, SeenImages};
use super::config::MapCorrectionConfig;
use super::far_mount::{MountTrial, SearchSchedule};
use super::origin_by_wheels::OriginByWheels;
use super::sums::{PoseByTerm, TermMatrix, TermVector};
use super::term::{NODES, TERMS_MAX, TermKind};
use crate::frames::{At, Pose};
use crate::matching::{Match, Matrix5, Repetition};
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// Variances of a displaced point, radial and tangential, by node of the range.
pub(super) type NodeVariances = [[f32; 2]; NODES];

/// Variance of the residuals over the stated one before any was seen.
pub(super) const INITIAL_NOISE: f64 = 4.0;

/// One unknown of the map, in the unit of its kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TermEstimate {
    /// What it stands for.
    pub kind: TermKind,
    /// Estimated value.
    pub value: f32,
    /// Its standard deviation.
    pub std: f32,
}

/// What is known about the map's errors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapCorrectionEstimate {
    /// The unknowns.
    pub terms: Vec<TermEstimate>,
    /// Independent images that were used.
    pub images: u32,
    /// Knocks noticed so far.
    pub knocks: u32,
    /// Root mean square displacement of the points 3 m away, metres.
    pub displacement_at_3_m: f32,
    /// Standard deviation of it, metres.
    pub displacement_std_at_3_m: f32,
}

/// One tracked image.
#[derive(Debug, Clone, Copy)]
pub struct TrackedImage<'a> {
    /// Its exposure.
    pub stamp: Stamp,
    /// The points after [`MapCorrection::correct`] and the compensation of the tilt.
    pub points: &'a [LinePoint],
    /// Their match.
    pub matched: &'a Match,
    /// The pose before the match.
    pub predicted: Pose,
    /// Information of pose and tilt before the match. None: the match had no prior.
    pub prior_information: Option<Matrix5>,
    /// Standard deviation of the tilt where it is independent in each image, radians. None: part of the filter's state.
    pub independent_tilt_std: Option<f32>,
    /// What of the points' errors repeats.
    pub repetition: Repetition,
    /// The tilt for which the points were compensated, radians.
    pub expected_tilt: [f32; 2],
}

/// A corrected line point: its own variances, m², and its derivatives by the unknowns.
#[derive(Debug, Clone, Copy)]
pub(super) struct RawPoint {
    /// As the given map says, metres.
    pub(super) given: [f32; 2],
    /// Before the compensation of the tilt, metres.
    pub(super) at: [f32; 2],
    pub(super) radial_variance: f32,
    pub(super) tangential_variance: f32,
    pub(super) derivatives: [[f32; 2]; TERMS_MAX],
}

/// Estimate of a map's errors.
#[derive(Debug, Clone)]
pub struct MapCorrection {
    pub(super) basis: MapBasis,
    pub(super) config: MapCorrectionConfig,
    pub(super) coefficients: TermVector,
    /// Those of the map in use, which follows the estimate once the given map proved wrong.
    pub(super) applied: TermVector,
    /// About which an estimate is plausible: the given map, or the mount taken over last.
    pub(super) plausible_centre: TermVector,
    /// With it learning goes on, as if the errors of all images were independent.
    pub(super) covariance: TermMatrix,
    pub(super) claim: Claim,
    pub(super) prior: TermMatrix,
    pub(super) seen: SeenImages,
    pub(super) origin_by_wheels: OriginByWheels,
    /// Error of (x, y, θ, a, b) per error of each unknown.
    pub(super) sensitivity: PoseByTerm,
    pub(super) points: Vec<RawPoint>,
    pub(super) variances: NodeVariances,
    pub(super) claimed_variances: NodeVariances,
    pub(super) stamp: Option<Stamp>,
    /// Pose of the last tracked image, and of the last one used.
    pub(super) last_pose: Option<Pose>,
    pub(super) used_pose: Option<Pose>,
    /// Learned variance of the residuals over the stated one.
    pub(super) noise: f64,
    pub(super) block: Block,
    pub(super) images: u32,
    pub(super) knocks: u32,
    /// Exposure of the last image tested for a large knock, and the tests in a row that found one.
    pub(super) knock_checked: Option<Stamp>,
    pub(super) knock_tests: u32,
    /// Mounts far from the one in use that explain the images better, best first.
    pub(super) trials: Vec<MountTrial>,
    pub(super) schedule: SearchSchedule,
}

impl MapCorrection {
    /// Nothing seen yet.
    pub fn new(basis: MapBasis, config: MapCorrectionConfig) -> Self {
        let prior = TermMatrix::from_fn(|i, j| match basis.terms().get(i) {
            Some(term) if i == j => f64::from(term.std).powi(2),
            _ => 0.0,
        });
        let mut correction = MapCorrection {
            coefficients: TermVector::zeros(),
            applied: TermVector::zeros(),
            plausible_centre: TermVector::zeros(),
            covariance: prior,
            claim: Claim::of_new_map(&prior),
            prior,
            seen: SeenImages::default(),
            origin_by_wheels: OriginByWheels::default(),
            sensitivity: PoseByTerm::zeros(),
            points: Vec::new(),
            variances: [[0.0; 2]; NODES],
            claimed_variances: [[0.0; 2]; NODES],
            stamp: None,
            last_pose: None,
            used_pose: None,
            noise: INITIAL_NOISE,
            block: Block::new(TermVector::zeros(), prior),
            images: 0,
            knocks: 0,
            knock_checked: None,
            knock_tests: 0,
            trials: Vec::new(),
            schedule: SearchSchedule::default(),
            basis,
            config,
        };
        correction.update_variances();
        correction
    }

    /// Mean square of the unknowns' deviation from the map in use, as far as learning goes.
    pub(super) fn deviation(&self) -> TermMatrix {
        let step = self.coefficients - self.applied;
        self.covariance + step * step.transpose()
    }

    /// The same as far as it may be claimed.
    pub(super) fn claimed_deviation(&self) -> TermMatrix {
        let step = self.best_step();
        self.claim.covariance + step * step.transpose()
    }

    /// Did the given map prove wrong, so that points are corrected?
    pub fn is_in_use(&self) -> bool {
        self.applied != TermVector::zeros()
    }

    /// The fields of the unknowns.
    pub fn basis(&self) -> &MapBasis {
        &self.basis
    }

    /// The settings.
    pub fn config(&self) -> &MapCorrectionConfig {
        &self.config
    }

    /// The estimate, for logs and views.
    pub fn estimate(&self) -> MapCorrectionEstimate {
        let terms = self.basis.terms().iter().enumerate();
        let [mut squares, mut variance] = [0.0; 2];
        const DIRECTIONS: usize = 8;
        for k in 0..DIRECTIONS {
            let (sin, cos) = math::sin_cos(std::f32::consts::TAU * k as f32 / DIRECTIONS as f32);
            let at = At::new(3.0 * cos, 3.0 * sin);
            squares += at.distance_to(self.correct_point(at)).powi(2) / DIRECTIONS as f32;
            let [xx, _, yy] = self.point_covariance(at);
            variance += (xx + yy) / DIRECTIONS as f32;
        }
        MapCorrectionEstimate {
            terms: terms
                .map(|(k, term)| TermEstimate {
                    kind: term.kind,
                    value: self.coefficients[k] as f32,
                    std: self.claim.covariance[(k, k)].max(0.0).sqrt() as f32,
                })
                .collect(),
            images: self.images,
            knocks: self.knocks,
            displacement_at_3_m: squares.sqrt(),
            displacement_std_at_3_m: variance.sqrt(),
        }
    }
}
