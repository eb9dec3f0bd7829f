//! Which of several poses is it most probably? Each matched to the end, told apart, and weighed by likelihood.

use super::{HeadingPrior, Hypothesis, Search, half_turn};
use crate::distance::DistanceField;
use crate::frame::{Pose, wrap_angle};
use crate::matching::Matcher;
use crate::sample::LinePoint;

impl Search {
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
        self.choose(points);
        self.folded = prior.is_none() && self.symmetric;
        let used = std::mem::take(&mut self.used);
        let mut found: Vec<(f32, Hypothesis)> = Vec::new();
        for start in screen(distances, &used, starts, spread) {
            let matched = matcher.refine(distances, &used, start, spread);
            let known = |(_, other): &(f32, Hypothesis)| self.same_folded(other.pose, matched.pose);
            if found.iter().any(known) {
                continue;
            }
            let turned = prior.map_or(0.0, |prior| {
                0.5 * (wrap_angle(matched.pose.theta - prior.heading) / prior.std).powi(2)
            });
            let cost = self.config.evidence_share * matched.cost + turned;
            found.push((cost, Hypothesis::of(&matched)));
        }
        self.used = used;
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        if self.folded {
            found = found
                .into_iter()
                .flat_map(|(cost, one)| {
                    let other = half_turned(&one);
                    [(cost, one), (cost, other)]
                })
                .collect();
        }
        weigh(found)
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
const MATCHED: usize = 24;

/// Points that many starts are screened with.
const SCREENED: usize = 40;

/// The starts themselves if they are few, or those under which some of the points lie nearest to markings.
fn screen(
    distances: &DistanceField,
    points: &[LinePoint],
    starts: &[Pose],
    reach: f32,
) -> Vec<Pose> {
    if starts.len() <= MATCHED {
        return starts.to_vec();
    }
    let some: Vec<&LinePoint> = points
        .iter()
        .step_by(points.len().div_ceil(SCREENED).max(1))
        .collect();
    let squared = reach * reach;
    let mut scored: Vec<(f32, Pose)> = starts
        .iter()
        .map(|&pose| {
            let score = some
                .iter()
                .map(|point| {
                    let at = pose * point.at;
                    let distance = distances.nearest(at.x, at.y).distance;
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
        .take(MATCHED)
        .collect()
}

/// Probabilities from costs (negative log likelihoods, ascending).
fn weigh(found: Vec<(f32, Hypothesis)>) -> Vec<Hypothesis> {
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
