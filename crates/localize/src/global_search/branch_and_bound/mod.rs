//! Where on the whole field can these line points have been seen from? Every pose, in a millisecond, provably.
//!
//! Branch and bound over (x, y, θ) on max-pooled score tables (not in the papers; MATH.md 4). A block of 4 × 4 cells
//! is bounded by the sum of its points' pooled scores (`tables`, `bound`). Only blocks whose bound beats the best cell
//! found are opened (`open`). The best cells, distinct from each other, are matched to the end and ranked by
//! likelihood (`rank`): the runners-up say how ambiguous the view is.

mod best_first;
mod bound;
mod rank;
mod tables;

use nalgebra::Matrix3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::frames::{Pose, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::matching::{Match, Matcher};
use crate::sample::LinePoint;

use tables::ScoreTables;

/// How the whole field is searched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BranchAndBoundConfig {
    /// Side of a position cell, metres.
    pub cell: f32,
    /// Step of headings, degrees: half of it moves a point 5 m away by about a cell.
    pub heading_step_deg: f32,
    /// How far outside the boundary lines a robot may stand, metres.
    pub margin: f32,
    /// Line points beyond this distance from the robot are not used, metres: they swing too far per heading step.
    pub range_max: f32,
    /// c of the score c²/(c² + d²), metres: as wide as cell and heading step leave a true pose's points off.
    pub kernel_scale: f32,
    /// Most points used; more are thinned out evenly.
    pub points_max: usize,
    /// Most distinct hypotheses returned (each with its half turn, where the field has one).
    pub hypotheses_max: usize,
    /// Cells that score less than this share of the best are no hypotheses.
    pub runner_up_share: f32,
    /// Most blocks opened for runners-up, after the best cell is certain.
    pub runner_up_blocks: usize,
    /// Hypotheses closer than this are one, metres.
    pub separation_min: f32,
    /// Hypotheses closer than this are one, degrees.
    pub separation_min_deg: f32,
    /// By how much the points' joint likelihood is tempered: neighbouring points are not independent.
    pub likelihood_exponent: f32,
}

impl Default for BranchAndBoundConfig {
    fn default() -> Self {
        BranchAndBoundConfig {
            cell: 0.1,
            heading_step_deg: 2.0,
            margin: 1.0,
            range_max: 10.0,
            kernel_scale: 0.2,
            points_max: 120,
            hypotheses_max: 6,
            runner_up_share: 0.85,
            runner_up_blocks: 600,
            separation_min: 0.4,
            separation_min_deg: 10.0,
            likelihood_exponent: 0.3,
        }
    }
}

/// What is known about the heading beforehand (a compass).
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
    /// The pose, matched to the end.
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians.
    pub covariance: Matrix3<f32>,
    /// Σ (1 − e) over the number of points.
    pub score: f32,
    /// Share of points that are inliers.
    pub inlier_share: f32,
    /// Root mean square distance of the inliers, metres.
    pub residual: f32,
    /// Lean (a, b), radians.
    pub tilt: [f32; 2],
    /// Probability among the hypotheses returned.
    pub probability: f32,
}

impl Hypothesis {
    /// A match that nothing was compared with yet.
    pub(crate) fn from_match(matched: &Match) -> Self {
        Hypothesis {
            pose: matched.pose,
            covariance: matched.covariance,
            score: matched.score,
            inlier_share: matched.inlier_share,
            residual: matched.residual,
            tilt: matched.tilt,
            probability: 0.0,
        }
    }
}

/// Score tables of one field, and what a search over them needs.
#[derive(Debug, Clone)]
pub struct BranchAndBound {
    config: BranchAndBoundConfig,
    tables: ScoreTables,
    /// A half turn maps the markings onto themselves.
    half_turn_symmetric: bool,
    /// Headings of this search go up to half a turn: a pose stands for its half turn too.
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
            half_turn_symmetric: half_turn_symmetric(field, distances),
            fold_half_turn: false,
            bounds: Vec::new(),
            offsets: Vec::new(),
            selected_points: Vec::new(),
            config,
        }
    }

    /// Does a half turn map the field's markings onto themselves?
    pub fn is_half_turn_symmetric(&self) -> bool {
        self.half_turn_symmetric
    }

    /// Memory held by the tables, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.tables.memory_bytes()
    }

    /// The poses that explain `points` (finite; robot frame) best, most probable first; empty without points.
    ///
    /// Without a prior all headings are searched. On a symmetric field every pose then comes with its half turn.
    pub fn find_hypotheses(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> Vec<Hypothesis> {
        self.select_points(points);
        if self.selected_points.is_empty() {
            return Vec::new();
        }
        self.fold_half_turn = prior.is_none() && self.half_turn_symmetric;
        let (first, count) = self.heading_range(prior);
        let step = self.config.heading_step_deg.to_radians();
        self.compute_bounds(first, step, count);
        let cells = self.find_best_cells(first, step, count);
        let starts: Vec<Pose> = cells.iter().map(|cell| cell.pose).collect();
        let reach = self.config.kernel_scale;
        self.rank(distances, matcher, points, &starts, prior, reach)
    }

    /// Thins the points out to those used.
    fn select_points(&mut self, points: &[LinePoint]) {
        let range = self.config.range_max;
        self.selected_points.clear();
        self.selected_points.extend(
            points
                .iter()
                .filter(|point| point.at.distance() < range)
                .copied(),
        );
        let (count, most) = (self.selected_points.len(), self.config.points_max);
        if count > most {
            for k in 0..most {
                self.selected_points[k] = self.selected_points[k * count / most];
            }
            self.selected_points.truncate(most);
        }
    }

    /// First heading and number of headings to search.
    fn heading_range(&self, prior: Option<HeadingPrior>) -> (f32, usize) {
        use std::f32::consts::{PI, TAU};
        let step = self.config.heading_step_deg.to_radians();
        let all = if self.fold_half_turn { PI } else { TAU };
        let Some(prior) = prior else {
            return (0.0, (all / step).ceil() as usize);
        };
        let half = (3.0 * prior.std).min(PI);
        let count = ((2.0 * half / step).ceil() as usize).max(1);
        (prior.heading - half + 0.5 * step, count)
    }

    /// Are two poses too close to be two hypotheses?
    pub fn is_same_hypothesis(&self, a: Pose, b: Pose) -> bool {
        a.origin().distance_to(b.origin()) < self.config.separation_min
            && wrap_angle(a.theta - b.theta).abs() < self.config.separation_min_deg.to_radians()
    }

    /// The same, up to the half turn where headings are searched up to it.
    fn is_same_up_to_fold(&self, a: Pose, b: Pose) -> bool {
        self.is_same_hypothesis(a, b)
            || self.fold_half_turn && self.is_same_hypothesis(a, half_turn(b))
    }
}

/// The pose after the field was turned by half a turn.
pub fn half_turn(pose: Pose) -> Pose {
    Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI)
}

/// Compares distances at points and at their half turns over the carpet.
fn half_turn_symmetric(field: &Field, distances: &DistanceField) -> bool {
    let (half_x, half_y) = field.carpet_half_extent();
    let step = 0.25;
    let (columns, rows) = ((half_x / step) as i32, (2.0 * half_y / step) as i32);
    (0..=columns).all(|column| {
        (0..=rows).all(|row| {
            let (x, y) = (column as f32 * step, row as f32 * step - half_y);
            let here = distances.nearest(x, y).signed_distance.abs();
            let there = distances.nearest(-x, -y).signed_distance.abs();
            (here - there).abs() < 0.02
        })
    })
}
