//! Ranking of pose candidates: each is refined by matching, deduplicated and weighted by likelihood.

use nalgebra::Matrix3;

use super::{BranchAndBound, HeadingPrior, Hypothesis, half_turn};
use crate::frames::{Pose, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::matching::{Match, Matcher};
use crate::math;
use crate::sample::LinePoint;

/// A hypothesis and its cost, a negative log likelihood.
#[derive(Clone)]
struct RankedHypothesis {
    cost: f32,
    hypothesis: Hypothesis,
}

impl BranchAndBound {
    /// Refines each start (off by about `start_error` metres), removes duplicates and ranks by likelihood.
    ///
    /// Without a prior on a symmetric field, each pose is followed by its half turn.
    pub fn rank(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        starts: &[Pose],
        prior: Option<HeadingPrior>,
        start_error: f32,
    ) -> Vec<Hypothesis> {
        self.select_points(points);
        self.search.fold_half_turn = prior.is_none() && self.half_turn_symmetric;
        let selected_points = std::mem::take(&mut self.search.selected_points);
        let mut ranked: Vec<RankedHypothesis> = Vec::new();
        for start in screen(distances, &selected_points, starts, start_error) {
            let matched = matcher.refine(distances, &selected_points, start, start_error);
            let is_duplicate = |other: &RankedHypothesis| {
                self.is_same_up_to_fold(other.hypothesis.pose, matched.pose)
            };
            if ranked.iter().any(is_duplicate) {
                continue;
            }
            ranked.push(self.ranked(matcher, &matched, prior));
        }
        ranked.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if let Some(best) = ranked.first_mut() {
            let nearby: Vec<RankedHypothesis> = nearby_starts(&best.hypothesis)
                .map(|start| {
                    let matched = matcher.refine(distances, &selected_points, start, NEARBY_STEP);
                    self.ranked(matcher, &matched, prior)
                })
                .filter(|other| {
                    self.is_same_hypothesis(best.hypothesis.pose, other.hypothesis.pose)
                })
                .collect();
            best.join(nearby);
        }
        self.search.selected_points = selected_points;
        if self.search.fold_half_turn {
            ranked = ranked
                .into_iter()
                .flat_map(|first| {
                    let second = RankedHypothesis {
                        cost: first.cost,
                        hypothesis: half_turned(&first.hypothesis),
                    };
                    [first, second]
                })
                .collect();
        }
        normalise_probabilities(ranked)
    }

    fn ranked(
        &self,
        matcher: &Matcher,
        matched: &Match,
        prior: Option<HeadingPrior>,
    ) -> RankedHypothesis {
        let heading_cost = prior.map_or(0.0, |prior| {
            0.5 * (wrap_angle(matched.pose.theta - prior.heading) / prior.std).powi(2)
        });
        RankedHypothesis {
            cost: self.config.likelihood_exponent * matched.cost
                + matcher.tilt_cost(matched.tilt)
                + heading_cost,
            hypothesis: Hypothesis::from_match(matched),
        }
    }
}

/// Steps from the best pose along its least certain direction, metres, from which the points are matched again: where few
/// markings tell, the cost has several minima closer together than two hypotheses.
const NEARBY_STEP: f32 = 0.1;
const NEARBY_STEPS: [f32; 6] = [-3.0, -2.0, -1.0, 1.0, 2.0, 3.0];

/// Minima nearer than this are one, metres.
const SAME_MINIMUM: f32 = 0.03;

/// Poses beside a hypothesis along its least certain direction, with the heading that goes with them.
fn nearby_starts(hypothesis: &Hypothesis) -> impl Iterator<Item = Pose> {
    let (pose, p) = (hypothesis.pose, &hypothesis.covariance);
    // Eigenvector of the larger eigenvalue.
    let angle = 0.5 * math::atan2(2.0 * p[(0, 1)], p[(0, 0)] - p[(1, 1)]);
    let (sin, cos) = math::sin_cos(angle);
    let variance = cos * cos * p[(0, 0)] + 2.0 * sin * cos * p[(0, 1)] + sin * sin * p[(1, 1)];
    let turn = (cos * p[(0, 2)] + sin * p[(1, 2)]) / variance.max(f32::MIN_POSITIVE);
    NEARBY_STEPS.into_iter().map(move |steps| {
        let step = steps * NEARBY_STEP;
        Pose::new(
            pose.x + step * cos,
            pose.y + step * sin,
            pose.theta + step * turn,
        )
    })
}

impl RankedHypothesis {
    /// Becomes the best of minima near each other, with the covariance of all of them.
    fn join(&mut self, nearby: Vec<RankedHypothesis>) {
        let mut minima = vec![self.clone()];
        for other in nearby {
            let at = other.hypothesis.pose.origin();
            let same = minima
                .iter_mut()
                .find(|known| known.hypothesis.pose.origin().distance_to(at) < SAME_MINIMUM);
            match same {
                Some(known) if other.cost < known.cost => *known = other,
                Some(_) => {}
                None => minima.push(other),
            }
        }
        minima.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let best = &minima[0];
        let (mut weights, mut covariance) = (0.0, Matrix3::zeros());
        for minimum in &minima {
            let weight = math::exp(best.cost - minimum.cost);
            let offset = (minimum.hypothesis.pose).difference(best.hypothesis.pose);
            covariance += (minimum.hypothesis.covariance + offset * offset.transpose()) * weight;
            weights += weight;
        }
        *self = best.clone();
        self.hypothesis.covariance = covariance / weights;
    }
}

fn half_turned(hypothesis: &Hypothesis) -> Hypothesis {
    // A half turn maps (x, y) to (−x, −y): only the covariances of θ with x and y change sign.
    let mut covariance = hypothesis.covariance;
    for i in 0..2 {
        covariance[(i, 2)] = -covariance[(i, 2)];
        covariance[(2, i)] = -covariance[(2, i)];
    }
    Hypothesis {
        pose: half_turn(hypothesis.pose),
        covariance,
        ..hypothesis.clone()
    }
}

/// Largest number of starts that are refined by matching.
const REFINED_MAX: usize = 24;

/// Number of points used for screening.
const SCREENING_POINTS: usize = 40;

/// All starts if they are few, else those with the best scores of a subset of the points.
fn screen(
    distances: &DistanceField,
    points: &[LinePoint],
    starts: &[Pose],
    kernel_scale: f32,
) -> Vec<Pose> {
    if starts.len() <= REFINED_MAX {
        return starts.to_vec();
    }
    let subset: Vec<&LinePoint> = points
        .iter()
        .step_by(points.len().div_ceil(SCREENING_POINTS).max(1))
        .collect();
    let squared = kernel_scale * kernel_scale;
    let mut scored: Vec<(f32, Pose)> = starts
        .iter()
        .map(|&pose| {
            let score = subset
                .iter()
                .map(|point| {
                    let at = pose * point.at;
                    let distance = distances.nearest(at.x, at.y).signed_distance;
                    squared / (squared + distance * distance)
                })
                .sum();
            (score, pose)
        })
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored
        .into_iter()
        .map(|(_, pose)| pose)
        .take(REFINED_MAX)
        .collect()
}

/// Probabilities from costs; `ranked` is sorted by cost, ascending.
fn normalise_probabilities(ranked: Vec<RankedHypothesis>) -> Vec<Hypothesis> {
    let cost_min = ranked.first().map_or(0.0, |best| best.cost);
    let total: f32 = ranked
        .iter()
        .map(|each| math::exp(cost_min - each.cost))
        .sum();
    ranked
        .into_iter()
        .map(|RankedHypothesis { cost, hypothesis }| Hypothesis {
            probability: math::exp(cost_min - cost) / total,
            ..hypothesis
        })
        .collect()
}
