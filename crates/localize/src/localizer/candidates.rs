//! Which of several poses is it? Hypotheses that odometry carries along until the frames' points have decided.

use nalgebra::{Matrix3, Vector3};

use crate::field::goal_colours::ColouredGoals;
use crate::filter::{FilterConfig, PoseFilter, TiltPrior};
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::{BranchAndBound, HeadingPrior, Hypothesis, half_turn};
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::sample::{GoalObservation, LinePoint};

/// Most hypotheses kept.
const CANDIDATES_MAX: usize = 12;

/// Log probability below the best at which a hypothesis is dropped.
const LOG_WEIGHT_RANGE: f32 = 10.0;

/// Log probability of a hypothesis that this frame brought up, below those that earlier frames had found already.
const NEW_CANDIDATE_PENALTY: f32 = 3.0;

#[derive(Debug, Clone)]
struct Candidate {
    filter: PoseFilter,
    hypothesis: Hypothesis,
    /// Logarithm of the probability, up to a constant.
    log_weight: f32,
}

/// Hypotheses with their weights, best first.
#[derive(Debug, Clone, Default)]
pub(crate) struct Candidates {
    candidates: Vec<Candidate>,
}

/// What one frame has to say.
pub(crate) struct FrameMeasurements<'a> {
    pub(crate) distances: &'a DistanceField,
    pub(crate) points: &'a [LinePoint],
    pub(crate) prior: Option<HeadingPrior>,
    /// Goals that tell the halves apart, and what was seen of them.
    pub(crate) goals: (&'a ColouredGoals, &'a [GoalObservation]),
    /// Poses stand for their half turns too.
    pub(crate) fold_half_turn: bool,
    /// By how much the points' joint likelihood is tempered.
    pub(crate) likelihood_exponent: f32,
}

impl Candidates {
    pub(crate) fn is_empty(&self) -> bool {
        self.candidates.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.candidates.clear();
    }

    /// All beliefs, for odometry to move.
    pub(crate) fn filters_mut(&mut self) -> impl Iterator<Item = &mut PoseFilter> {
        self.candidates
            .iter_mut()
            .map(|candidate| &mut candidate.filter)
    }

    /// The best, with its probability.
    pub(crate) fn best(&self) -> Option<(&PoseFilter, &Hypothesis)> {
        let best = self.candidates.first()?;
        Some((&best.filter, &best.hypothesis))
    }

    /// All but the best; with their half turns (the best's first) where these are as probable.
    pub(crate) fn runners_up(&self, folded: bool) -> Vec<Hypothesis> {
        let mut all = Vec::new();
        for (k, one) in self.candidates.iter().enumerate() {
            let mut hypothesis = one.hypothesis.clone();
            if folded {
                hypothesis.probability *= 0.5;
                all.push(Hypothesis {
                    pose: half_turn(hypothesis.pose),
                    ..hypothesis.clone()
                });
            }
            if k > 0 {
                all.push(hypothesis);
            }
        }
        all
    }

    /// Covariance about the best with all others at their probabilities.
    pub(crate) fn covariance(&self) -> Matrix3<f32> {
        let Some(best) = self.candidates.first() else {
            return Matrix3::zeros();
        };
        self.candidates.iter().fold(Matrix3::zeros(), |sum, one| {
            let apart = pose_difference(one.filter.pose(), best.filter.pose());
            let spread = one.filter.covariance() + apart * apart.transpose();
            sum + spread * one.hypothesis.probability
        })
    }

    /// Weighs the hypotheses by a frame's points and compass, and takes in those that the search `found` anew.
    pub(crate) fn update(
        &mut self,
        matcher: &mut Matcher,
        search: &BranchAndBound,
        evidence: &FrameMeasurements,
        found: &[Hypothesis],
        config: &FilterConfig,
    ) {
        for one in &mut self.candidates {
            one.update(matcher, search, evidence, config);
        }
        let start = if self.candidates.is_empty() {
            0.0
        } else {
            -NEW_CANDIDATE_PENALTY
        };
        for hypothesis in found {
            let pose = hypothesis.pose;
            let known = self.candidates.iter().any(|one| {
                let carried = one.filter.pose();
                search.is_same_hypothesis(carried, pose)
                    || evidence.fold_half_turn
                        && search.is_same_hypothesis(half_turn(carried), pose)
            });
            if known {
                continue;
            }
            let cost = matcher
                .evaluate(evidence.distances, evidence.points, pose)
                .cost;
            self.candidates.push(Candidate {
                filter: PoseFilter::new(pose, &hypothesis.covariance, None, config),
                hypothesis: hypothesis.clone(),
                log_weight: start
                    - evidence.likelihood_exponent * cost
                    - evidence.negative_log_likelihood(pose),
            });
        }
        self.normalise();
    }

    /// Sorts, drops the improbable and sets the probabilities.
    fn normalise(&mut self) {
        self.candidates
            .sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
        let top = self.candidates.first().map_or(0.0, |best| best.log_weight);
        self.candidates.truncate(CANDIDATES_MAX);
        self.candidates
            .retain(|one| one.log_weight >= top - LOG_WEIGHT_RANGE);
        for one in &mut self.candidates {
            one.log_weight -= top;
        }
        let total: f32 = self.candidates.iter().map(|one| one.log_weight.exp()).sum();
        for one in &mut self.candidates {
            one.hypothesis.probability = one.log_weight.exp() / total;
        }
    }
}

impl Candidate {
    /// Matches the moved hypothesis to the frame and notes what that cost.
    fn update(
        &mut self,
        matcher: &mut Matcher,
        search: &BranchAndBound,
        evidence: &FrameMeasurements,
        config: &FilterConfig,
    ) {
        let pose = self.filter.pose();
        if search.is_half_turn_symmetric()
            && evidence.negative_log_likelihood(pose)
                > evidence.negative_log_likelihood(half_turn(pose))
        {
            self.filter = self.filter.half_turned();
        }
        let spread = self.filter.position_std() + 3.0 * self.filter.heading_std();
        let lean = TiltPrior::Independent(matcher.tilt_std());
        let expected = self.filter.pose_prior(lean);
        let matched =
            matcher.refine_with_prior(evidence.distances, evidence.points, expected, spread);
        self.filter.update(&matched, lean, config);
        self.log_weight -= evidence.likelihood_exponent
            * (matched.cost + 0.5 * matched.mahalanobis_squared)
            + evidence.negative_log_likelihood(matched.pose);
        self.hypothesis = Hypothesis::from_match(&matched);
    }
}

impl FrameMeasurements<'_> {
    /// What compass and goals have against a pose (negative log likelihood).
    fn negative_log_likelihood(&self, pose: Pose) -> f32 {
        let by_compass = self.prior.map_or(0.0, |prior| {
            0.5 * (wrap_angle(pose.theta - prior.heading) / prior.std).powi(2)
        });
        let (goals, sights) = self.goals;
        by_compass + goals.cost(pose, sights)
    }
}

/// From pose b to pose a, headings on the circle.
pub(crate) fn pose_difference(a: Pose, b: Pose) -> Vector3<f32> {
    Vector3::new(a.x - b.x, a.y - b.y, wrap_angle(a.theta - b.theta))
}
