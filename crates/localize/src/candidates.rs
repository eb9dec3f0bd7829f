//! Which of several poses is it? Hypotheses that odometry carries along until the frames' points have decided.

use nalgebra::{Matrix3, Vector3};

use crate::distance::DistanceField;
use crate::filter::{Belief, FilterConfig, LeanPrior};
use crate::frame::{Pose, wrap_angle};
use crate::goals::ColouredGoals;
use crate::matching::Matcher;
use crate::sample::{GoalSight, LinePoint};
use crate::search::{HeadingPrior, Hypothesis, Search, half_turn};

/// Most hypotheses kept.
const KEPT: usize = 12;

/// Log probability below the best at which a hypothesis is dropped.
const DROPPED: f32 = 10.0;

/// Log probability of a hypothesis that this frame brought up, below those that earlier frames had found already.
const NEWCOMER: f32 = 3.0;

#[derive(Debug, Clone)]
struct Candidate {
    belief: Belief,
    hypothesis: Hypothesis,
    /// Logarithm of the probability, up to a constant.
    weight: f32,
}

/// Hypotheses with their weights, best first.
#[derive(Debug, Clone, Default)]
pub(crate) struct Candidates {
    all: Vec<Candidate>,
}

/// What one frame has to say.
pub(crate) struct Evidence<'a> {
    pub(crate) distances: &'a DistanceField,
    pub(crate) points: &'a [LinePoint],
    pub(crate) prior: Option<HeadingPrior>,
    /// Goals that tell the halves apart, and what was seen of them.
    pub(crate) goals: (&'a ColouredGoals, &'a [GoalSight]),
    /// Poses stand for their half turns too.
    pub(crate) folded: bool,
    /// By how much the points' joint likelihood is tempered.
    pub(crate) share: f32,
}

impl Candidates {
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.all.clear();
    }

    /// All beliefs, for odometry to move.
    pub(crate) fn beliefs(&mut self) -> impl Iterator<Item = &mut Belief> {
        self.all.iter_mut().map(|candidate| &mut candidate.belief)
    }

    /// The best, with its probability.
    pub(crate) fn best(&self) -> Option<(&Belief, &Hypothesis)> {
        let best = self.all.first()?;
        Some((&best.belief, &best.hypothesis))
    }

    /// All but the best; with their half turns (the best's first) where these are as probable.
    pub(crate) fn runners_up(&self, folded: bool) -> Vec<Hypothesis> {
        let mut all = Vec::new();
        for (k, one) in self.all.iter().enumerate() {
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
        let Some(best) = self.all.first() else {
            return Matrix3::zeros();
        };
        self.all.iter().fold(Matrix3::zeros(), |sum, one| {
            let apart = apart(one.belief.pose(), best.belief.pose());
            let spread = one.belief.covariance() + apart * apart.transpose();
            sum + spread * one.hypothesis.probability
        })
    }

    /// Weighs the hypotheses by a frame's points and compass, and takes in those that the search `found` anew.
    pub(crate) fn weigh(
        &mut self,
        matcher: &mut Matcher,
        search: &Search,
        evidence: &Evidence,
        found: &[Hypothesis],
        config: &FilterConfig,
    ) {
        for one in &mut self.all {
            one.advance(matcher, search, evidence, config);
        }
        let start = if self.all.is_empty() { 0.0 } else { -NEWCOMER };
        for hypothesis in found {
            let pose = hypothesis.pose;
            let known = self.all.iter().any(|one| {
                let carried = one.belief.pose();
                search.same(carried, pose)
                    || evidence.folded && search.same(half_turn(carried), pose)
            });
            if known {
                continue;
            }
            let cost = matcher
                .assess(evidence.distances, evidence.points, pose)
                .cost;
            self.all.push(Candidate {
                belief: Belief::new(pose, &hypothesis.covariance, None, config),
                hypothesis: hypothesis.clone(),
                weight: start - evidence.share * cost - evidence.against(pose),
            });
        }
        self.normalise();
    }

    /// Sorts, drops the improbable and sets the probabilities.
    fn normalise(&mut self) {
        self.all.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let top = self.all.first().map_or(0.0, |best| best.weight);
        self.all.truncate(KEPT);
        self.all.retain(|one| one.weight >= top - DROPPED);
        for one in &mut self.all {
            one.weight -= top;
        }
        let total: f32 = self.all.iter().map(|one| one.weight.exp()).sum();
        for one in &mut self.all {
            one.hypothesis.probability = one.weight.exp() / total;
        }
    }
}

impl Candidate {
    /// Matches the moved hypothesis to the frame and notes what that cost.
    fn advance(
        &mut self,
        matcher: &mut Matcher,
        search: &Search,
        evidence: &Evidence,
        config: &FilterConfig,
    ) {
        let pose = self.belief.pose();
        if search.symmetric() && evidence.against(pose) > evidence.against(half_turn(pose)) {
            self.belief = self.belief.half_turned();
        }
        let spread = self.belief.position_std() + 3.0 * self.belief.heading_std();
        let lean = LeanPrior::Fresh(matcher.lean_std());
        let expected = self.belief.expected(lean);
        let matched = matcher.fuse(evidence.distances, evidence.points, expected, spread);
        self.belief.absorb(&matched, lean, config);
        self.weight -=
            evidence.share * (matched.cost + 0.5 * matched.strain) + evidence.against(matched.pose);
        self.hypothesis = Hypothesis::of(&matched);
    }
}

impl Evidence<'_> {
    /// What compass and goals have against a pose (negative log likelihood).
    fn against(&self, pose: Pose) -> f32 {
        let by_compass = self.prior.map_or(0.0, |prior| {
            0.5 * (wrap_angle(pose.theta - prior.heading) / prior.std).powi(2)
        });
        let (goals, sights) = self.goals;
        by_compass + goals.cost(pose, sights)
    }
}

/// From pose b to pose a, headings on the circle.
pub(crate) fn apart(a: Pose, b: Pose) -> Vector3<f32> {
    Vector3::new(a.x - b.x, a.y - b.y, wrap_angle(a.theta - b.theta))
}
