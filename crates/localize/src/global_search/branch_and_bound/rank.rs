//! Which of several poses is it most probably? Each matched to the end, told apart, and weighed by likelihood.

use super::{BranchAndBound, HeadingPrior, Hypothesis, half_turn};
use crate::frames::{Pose, wrap_angle};
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;

impl BranchAndBound {
    /// Matches the points from each start (off by about `spread` metres), leaves each pose once, and ranks by
    /// likelihood; without a prior on a symmetric field with each pose's half turn behind it.
    pub fn rank(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        starts: &[Pose],
        prior: Option<HeadingPrior>,
        spread: f32,
    ) -> Vec<Hypothesis> {
        self.select_points(points);
        self.fold_half_turn = prior.is_none() && self.half_turn_symmetric;
        let selected_points = std::mem::take(&mut self.selected_points);
        let mut found: Vec<(f32, Hypothesis)> = Vec::new();
        for start in screen(distances, &selected_points, starts, spread) {
            let matched = matcher.refine(distances, &selected_points, start, spread);
            let known =
                |(_, other): &(f32, Hypothesis)| self.is_same_up_to_fold(other.pose, matched.pose);
            if found.iter().any(known) {
                continue;
            }
            let turned = prior.map_or(0.0, |prior| {
                0.5 * (wrap_angle(matched.pose.theta - prior.heading) / prior.std).powi(2)
            });
            let cost = self.config.likelihood_exponent * matched.cost + turned;
            found.push((cost, Hypothesis::from_match(&matched)));
        }
        self.selected_points = selected_points;
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        if self.fold_half_turn {
            found = found
                .into_iter()
                .flat_map(|(cost, one)| {
                    let other = half_turned(&one);
                    [(cost, one), (cost, other)]
                })
                .collect();
        }
        normalise_probabilities(found)
    }
}

fn half_turned(one: &Hypothesis) -> Hypothesis {
    // Turning by half a turn maps (x, y) to (−x, −y): second moments stay, those with θ change sign.
    let mut covariance = one.covariance;
    for i in 0..2 {
        covariance[(i, 2)] = -covariance[(i, 2)];
        covariance[(2, i)] = -covariance[(2, i)];
    }
    Hypothesis {
        pose: half_turn(one.pose),
        covariance,
        ..one.clone()
    }
}

/// Starts that are matched to the end.
const REFINED_MAX: usize = 24;

/// Points that many starts are screened with.
const SCREENING_POINTS: usize = 40;

/// The starts themselves if they are few, or those under which some of the points lie nearest to markings.
fn screen(
    distances: &DistanceField,
    points: &[LinePoint],
    starts: &[Pose],
    reach: f32,
) -> Vec<Pose> {
    if starts.len() <= REFINED_MAX {
        return starts.to_vec();
    }
    let some: Vec<&LinePoint> = points
        .iter()
        .step_by(points.len().div_ceil(SCREENING_POINTS).max(1))
        .collect();
    let squared = reach * reach;
    let mut scored: Vec<(f32, Pose)> = starts
        .iter()
        .map(|&pose| {
            let score = some
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

/// Probabilities from costs (negative log likelihoods, ascending).
fn normalise_probabilities(found: Vec<(f32, Hypothesis)>) -> Vec<Hypothesis> {
    let least = found.first().map_or(0.0, |(cost, _)| *cost);
    let total: f32 = found.iter().map(|(cost, _)| (least - cost).exp()).sum();
    found
        .into_iter()
        .map(|(cost, hypothesis)| Hypothesis {
            probability: (least - cost).exp() / total,
            ..hypothesis
        })
        .collect()
}
