//! Branch and bound over all poses of the field: from which poses do the line points fit the markings best?
//!
//! The search over (x, y, θ) uses max-pooled score tables (own, docs/methods.md 6.1) and takes about a millisecond. A
//! block of 4 × 4 cells is bounded by the sum of its points' pooled scores (`tables`, `bound`). Only blocks whose bound
//! exceeds the best cell so far are searched (`best_first`). The best distinct cells are refined by matching and ranked
//! by likelihood (`rank`); the runners-up show how ambiguous the measurement is.

mod best_first;
mod bound;
mod certificate;
mod certified_share;
mod config;
mod gradual;
mod rank;
mod tables;

use nalgebra::Matrix3;

pub use certified_share::Certificate;
pub use config::BranchAndBoundConfig;
pub use gradual::GradualSearch;

use crate::field::Field;
use crate::frames::{Pose, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::matching::{Match, Matcher};
use crate::sample::LinePoint;

use tables::ScoreTables;

/// A heading known beforehand, from a compass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingPrior {
    /// Expected heading, radians.
    pub heading: f32,
    /// Its standard deviation, radians.
    pub std: f32,
}

/// A pose that explains the points.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// The pose, refined by matching.
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians.
    pub covariance: Matrix3<f32>,
    /// Σ (1 − e) over the number of points.
    pub score: f32,
    /// Share of points that are inliers.
    pub inlier_share: f32,
    /// Root mean square distance of the inliers, metres.
    pub inlier_rms: f32,
    /// Tilt (a, b), radians (docs/methods.md 3.1).
    pub tilt: [f32; 2],
    /// Probability among the hypotheses returned.
    pub probability: f32,
}

impl Hypothesis {
    /// A hypothesis from a match; its probability is not computed yet.
    pub(crate) fn from_match(matched: &Match) -> Self {
        Hypothesis {
            pose: matched.pose,
            covariance: matched.covariance,
            score: matched.score,
            inlier_share: matched.inlier_share,
            inlier_rms: matched.inlier_rms,
            tilt: matched.tilt,
            probability: 0.0,
        }
    }
}

/// The result of a search with its proof.
#[derive(Debug, Clone, Default)]
pub struct CertifiedHypotheses {
    /// The poses that explain the points best, most probable first.
    pub hypotheses: Vec<Hypothesis>,
    /// What all other poses explain at most. None without hypotheses.
    pub certificate: Option<Certificate>,
}

/// Score tables of one field, and the buffers of a search.
#[derive(Debug, Clone)]
pub struct BranchAndBound {
    config: BranchAndBoundConfig,
    tables: ScoreTables,
    /// True if a half turn maps the markings onto themselves.
    half_turn_symmetric: bool,
    search: SearchBuffers,
}

/// Points and tables of one search.
#[derive(Debug, Clone, Default)]
struct SearchBuffers {
    /// True if this search covers headings up to π only: a pose then represents its half turn, too.
    fold_half_turn: bool,
    bounds: Vec<u16>,
    offsets: Vec<(u32, u32)>,
    selected_points: Vec<LinePoint>,
}

impl BranchAndBound {
    /// Fills the tables for a field.
    pub fn new(field: &Field, distances: &DistanceField, config: BranchAndBoundConfig) -> Self {
        BranchAndBound {
            tables: ScoreTables::new(field, distances, &config),
            half_turn_symmetric: is_half_turn_symmetric(field, distances),
            search: SearchBuffers::default(),
            config,
        }
    }

    /// True if a half turn maps the field's markings onto themselves.
    pub fn is_half_turn_symmetric(&self) -> bool {
        self.half_turn_symmetric
    }

    /// Memory held by the tables, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.tables.memory_bytes()
    }

    /// The poses that explain `points` (finite; robot frame) best, most probable first; empty without points.
    ///
    /// Without a prior all headings are searched; on a symmetric field each pose is then followed by its half turn.
    pub fn find_hypotheses(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> Vec<Hypothesis> {
        self.search_headings(distances, matcher, points, prior).0
    }

    /// As `find_hypotheses`, with a bound on what all other poses explain.
    pub fn find_certified(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> CertifiedHypotheses {
        let (hypotheses, headings) = self.search_headings(distances, matcher, points, prior);
        let certificate = self.certify(distances, &headings, &hypotheses);
        CertifiedHypotheses {
            hypotheses,
            certificate,
        }
    }

    /// The hypotheses, and the headings whose bounds the buffers hold.
    fn search_headings(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> (Vec<Hypothesis>, HeadingRange) {
        self.select_points(points);
        if self.search.selected_points.is_empty() {
            return Default::default();
        }
        self.search.fold_half_turn = prior.is_none() && self.half_turn_symmetric;
        let headings = self.heading_range(prior);
        self.start_bounds(&headings);
        self.compute_bounds(&headings, 0..headings.count);
        let mut blocks = self.sort_blocks(headings);
        self.search_blocks(&mut blocks, usize::MAX);
        let cells = self.best_cells(blocks);
        let starts: Vec<Pose> = cells.iter().map(|cell| cell.pose).collect();
        let start_error = self.config.kernel_scale;
        let hypotheses = self.rank(distances, matcher, points, &starts, prior, start_error);
        (hypotheses, headings)
    }

    /// Selects the points within range, evenly thinned out.
    fn select_points(&mut self, points: &[LinePoint]) {
        let range = self.config.range_max;
        self.search.selected_points.clear();
        self.search.selected_points.extend(
            points
                .iter()
                .filter(|point| point.at.distance() < range)
                .copied(),
        );
        let (count, most) = (self.search.selected_points.len(), self.config.points_max);
        if count > most {
            for k in 0..most {
                self.search.selected_points[k] = self.search.selected_points[k * count / most];
            }
            self.search.selected_points.truncate(most);
        }
    }

    /// Headings to search.
    fn heading_range(&self, prior: Option<HeadingPrior>) -> HeadingRange {
        use std::f32::consts::{PI, TAU};
        let step = self.config.heading_step_deg.to_radians();
        let all = if self.search.fold_half_turn { PI } else { TAU };
        let Some(prior) = prior else {
            return HeadingRange {
                first: 0.0,
                step,
                count: (all / step).ceil() as usize,
            };
        };
        let half = (3.0 * prior.std).min(PI);
        let count = ((2.0 * half / step).ceil() as usize).max(1);
        HeadingRange {
            first: prior.heading - half + 0.5 * step,
            step,
            count,
        }
    }

    /// True if two poses are too close to be two hypotheses.
    pub fn is_same_hypothesis(&self, a: Pose, b: Pose) -> bool {
        a.origin().distance_to(b.origin()) < self.config.separation_min
            && wrap_angle(a.theta - b.theta).abs() < self.config.separation_min_deg.to_radians()
    }

    /// As `is_same_hypothesis`, modulo the half turn if headings up to π are searched.
    fn is_same_up_to_fold(&self, a: Pose, b: Pose) -> bool {
        self.is_same_hypothesis(a, b)
            || self.search.fold_half_turn && self.is_same_hypothesis(a, half_turn(b))
    }
}

/// Headings of a search, radians.
#[derive(Debug, Clone, Copy, Default)]
struct HeadingRange {
    first: f32,
    step: f32,
    count: usize,
}

impl HeadingRange {
    fn heading(&self, index: usize) -> f32 {
        self.first + index as f32 * self.step
    }
}

/// The pose after a rotation of the field by 180°.
pub fn half_turn(pose: Pose) -> Pose {
    Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI)
}

/// Does a half turn leave the markings as they are? Compares the distances at points of the carpet and at the opposite points.
pub(crate) fn is_half_turn_symmetric(field: &Field, distances: &DistanceField) -> bool {
    let (half_x, half_y) = field.carpet_half_extent();
    let step = 0.25;
    let (columns, rows) = ((half_x / step) as i32, (2.0 * half_y / step) as i32);
    (0..=columns).all(|column| {
        (0..=rows).all(|row| {
            let (x, y) = (column as f32 * step, row as f32 * step - half_y);
            let distance = distances.nearest(x, y).signed_distance.abs();
            let opposite = distances.nearest(-x, -y).signed_distance.abs();
            (distance - opposite).abs() < 0.02
        })
    })
}
