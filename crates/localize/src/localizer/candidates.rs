//! Pose hypotheses of an ambiguous start. Odometry moves them until the images decide between them.

use nalgebra::Matrix3;

use crate::advice::{Advisor, CheckedMarkings, Considered, MotionAdvice};
use crate::field::goal_colours::ColouredGoals;
use crate::filter::{FilterConfig, OdometryPrior, PoseFilter, TiltPrior};
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::{BranchAndBound, HeadingPrior, Hypothesis, half_turn};
use crate::map_correction::MapCorrection;
use crate::matching::distance_field::DistanceField;
use crate::matching::{Match, MatchStart, Matcher, TYPICAL_RANGE};
use crate::math;
use crate::sample::{GoalObservation, LinePoint};

use super::evidence::Evidence;

/// Maximum number of hypotheses.
const CANDIDATES_MAX: usize = 32;

/// Hypotheses whose log probability is this far below the best are dropped.
const LOG_WEIGHT_RANGE: f32 = 10.0;

/// Penalty in log probability for a hypothesis that earlier images did not support.
const NEW_CANDIDATE_PENALTY: f32 = 3.0;

/// Images after which the best hypothesis may be tracked, if no other pose could explain clearly more points, and else: two
/// images that lean far may both point to one wrong place, and hide the right one.
const IMAGES_MIN: u32 = 2;
const DOUBTED_IMAGES_MIN: u32 = 3;

/// A hypothesis less certain than this is not tracked, metres: its points still fit places so far apart.
const TRACKED_STD_MAX: f32 = 0.4;

#[derive(Debug, Clone)]
struct Candidate {
    filter: PoseFilter,
    hypothesis: Hypothesis,
    evidence: Evidence,
    /// Images that it was matched to.
    images: u32,
    /// Markings in view so far.
    checked: CheckedMarkings,
    /// Direction of the displacement advised last, radians on the field under this hypothesis.
    advised_direction: Option<f32>,
}

/// Weighted hypotheses, most probable first.
#[derive(Debug, Clone, Default)]
pub(super) struct Candidates {
    candidates: Vec<Candidate>,
    /// Images in a row that no pose of the field explains.
    unexplained: u32,
}

/// Measurements of one image.
pub(super) struct ImageMeasurements<'a> {
    pub(super) distances: &'a DistanceField,
    pub(super) points: &'a [LinePoint],
    pub(super) heading_prior: Option<HeadingPrior>,
    /// The field's coloured goals and the observed ones.
    pub(super) goals: (&'a ColouredGoals, &'a [GoalObservation]),
    /// Each pose stands for its half turn too.
    pub(super) fold_half_turn: bool,
    /// Exponent of the points' likelihood, below 1 since their errors are correlated.
    pub(super) likelihood_exponent: f32,
    /// A map whose errors may explain more than those of the points.
    pub(super) map: Option<&'a MapCorrection>,
}

impl Candidates {
    pub(super) fn is_empty(&self) -> bool {
        self.candidates.is_empty()
    }

    /// Counts an image that no pose of the field explains, and tells how many there have been in a row.
    pub(super) fn count_unexplained(&mut self) -> u32 {
        self.unexplained += 1;
        self.unexplained
    }

    /// All filters, for odometry to move.
    pub(super) fn filters_mut(&mut self) -> impl Iterator<Item = &mut PoseFilter> {
        self.candidates
            .iter_mut()
            .map(|candidate| &mut candidate.filter)
    }

    /// The most probable hypothesis and its filter.
    pub(super) fn best(&self) -> Option<(&PoseFilter, &Hypothesis)> {
        let best = self.candidates.first()?;
        Some((&best.filter, &best.hypothesis))
    }

    /// Notes the motion advised at this image, so that the next advice goes on with it.
    pub(super) fn note_advice(&mut self, advice: Option<MotionAdvice>) {
        let [x, y, _] = advice.map_or([0.0; 3], |advice| advice.motion);
        let direction = (x != 0.0 || y != 0.0).then(|| math::atan2(y, x));
        for candidate in &mut self.candidates {
            let heading = candidate.filter.pose().theta;
            candidate.advised_direction = direction.map(|angle| heading + angle);
        }
    }

    /// Direction of the displacement advised last, radians in the present robot frame.
    pub(super) fn advised_direction(&self) -> Option<f32> {
        self.candidates.iter().find_map(|candidate| {
            Some(wrap_angle(
                candidate.advised_direction? - candidate.filter.pose().theta,
            ))
        })
    }

    /// Adds the markings that an image has in view to those that each hypothesis has had in view.
    pub(super) fn mark_checked(&mut self, advisor: &Advisor, points: &[LinePoint]) {
        for candidate in &mut self.candidates {
            advisor.mark_checked(&mut candidate.checked, candidate.filter.pose(), points);
        }
    }

    /// The two most probable hypotheses.
    pub(super) fn best_two(&self) -> Option<[Considered<'_>; 2]> {
        match &self.candidates[..] {
            [best, rival, ..] => Some([best, rival].map(|candidate| Considered {
                pose: candidate.filter.pose(),
                checked: &candidate.checked,
            })),
            _ => None,
        }
    }

    /// Did enough images support the best hypothesis, and do they leave one place? A robot that leans far in one image shows
    /// its points beside the markings, and another place may then explain them better. `margin_share`: share of the points
    /// by which another pose is clearly better.
    pub(super) fn best_is_confirmed(&self, margin_share: f32) -> bool {
        self.candidates.first().is_some_and(|best| {
            let is_doubted = 1.0 - best.hypothesis.score >= margin_share;
            let images_min = if is_doubted {
                DOUBTED_IMAGES_MIN
            } else {
                IMAGES_MIN
            };
            best.images >= images_min && best.filter.position_std() < TRACKED_STD_MAX
        })
    }

    /// All hypotheses but the best. With `fold_half_turn`, half turns are included, that of the best first.
    pub(super) fn runners_up(&self, fold_half_turn: bool) -> Vec<Hypothesis> {
        let mut all = Vec::new();
        for (k, candidate) in self.candidates.iter().enumerate() {
            let mut hypothesis = candidate.hypothesis.clone();
            if fold_half_turn {
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

    /// Covariance of the mixture about the best hypothesis.
    pub(super) fn covariance(&self) -> Matrix3<f32> {
        let Some(best) = self.candidates.first() else {
            return Matrix3::zeros();
        };
        self.candidates
            .iter()
            .fold(Matrix3::zeros(), |sum, candidate| {
                let offset = candidate.filter.pose().difference(best.filter.pose());
                let scatter = candidate.filter.covariance() + offset * offset.transpose();
                sum + scatter * candidate.hypothesis.probability
            })
    }

    /// Updates and weights the hypotheses by an image, and adds new ones that the search `found`.
    pub(super) fn update(
        &mut self,
        matcher: &mut Matcher,
        search: &BranchAndBound,
        measurements: &ImageMeasurements,
        found: &[Hypothesis],
        config: &FilterConfig,
        odometry_prior: &OdometryPrior,
    ) {
        self.unexplained = 0;
        self.leave_place();
        for candidate in &mut self.candidates {
            candidate.update(matcher, search, measurements, config);
        }
        self.merge_met(search, measurements.fold_half_turn);
        let known_best = self.candidates.first().map(|best| best.evidence.clone());
        for hypothesis in found {
            let pose = hypothesis.pose;
            let is_known = |candidate: &Candidate| {
                is_same(
                    search,
                    measurements.fold_half_turn,
                    [candidate.filter.pose(), pose],
                )
            };
            if self.candidates.iter().any(is_known) {
                continue;
            }
            let tilt = hypothesis.tilt;
            let matched = matcher.evaluate(measurements.distances, measurements.points, pose, tilt);
            let cost =
                measurements.cost(matcher, &matched) + measurements.negative_log_likelihood(pose);
            let mut evidence = match &known_best {
                Some(best) => best.of_rival(pose, NEW_CANDIDATE_PENALTY),
                None => Evidence::new(pose, 0.0),
            };
            evidence.add(-cost);
            self.candidates.push(Candidate {
                filter: PoseFilter::new(pose, &hypothesis.covariance, None, config, odometry_prior),
                hypothesis: hypothesis.clone(),
                images: 1,
                checked: CheckedMarkings::default(),
                advised_direction: None,
                evidence,
            });
        }
        self.normalize();
    }

    /// Begins another place for all hypotheses at once, so that their places have the same images.
    fn leave_place(&mut self) {
        let share = self
            .candidates
            .first()
            .and_then(|best| best.evidence.share_at_next_place(best.filter.pose()));
        if let Some(share) = share {
            for candidate in &mut self.candidates {
                candidate
                    .evidence
                    .leave_place(candidate.filter.pose(), share);
            }
        }
    }

    /// Makes one of the hypotheses that matches have led to the same place: it would share its probability with itself,
    /// and never be decided.
    fn merge_met(&mut self, search: &BranchAndBound, fold_half_turn: bool) {
        self.sort();
        let mut kept: Vec<Candidate> = Vec::with_capacity(self.candidates.len());
        for candidate in self.candidates.drain(..) {
            let poses = |other: &Candidate| [other.filter.pose(), candidate.filter.pose()];
            match kept
                .iter_mut()
                .find(|other| is_same(search, fold_half_turn, poses(other)))
            {
                Some(same) => same.images = same.images.max(candidate.images),
                None => kept.push(candidate),
            }
        }
        self.candidates = kept;
    }

    /// Most probable first.
    fn sort(&mut self) {
        self.candidates
            .sort_by(|a, b| b.evidence.log_weight().total_cmp(&a.evidence.log_weight()));
    }

    /// Sorts, drops improbable hypotheses and computes the probabilities.
    fn normalize(&mut self) {
        let log_weight = |candidate: &Candidate| candidate.evidence.log_weight();
        self.sort();
        let top = self.candidates.first().map_or(0.0, log_weight);
        self.candidates.truncate(CANDIDATES_MAX);
        self.candidates
            .retain(|candidate| log_weight(candidate) >= top - LOG_WEIGHT_RANGE);
        for candidate in &mut self.candidates {
            candidate.evidence.lower_by(top);
        }
        let weights = self.candidates.iter().map(log_weight);
        let total: f32 = weights.map(math::exp).sum();
        for candidate in &mut self.candidates {
            candidate.hypothesis.probability = math::exp(log_weight(candidate)) / total;
        }
    }
}

/// Are two poses one hypothesis, modulo the half turn with `fold_half_turn`?
fn is_same(search: &BranchAndBound, fold_half_turn: bool, [a, b]: [Pose; 2]) -> bool {
    search.is_same_hypothesis(a, b) || fold_half_turn && search.is_same_hypothesis(half_turn(a), b)
}

impl Candidate {
    /// Matches the predicted hypothesis to the image and lowers its weight by the cost.
    fn update(
        &mut self,
        matcher: &mut Matcher,
        search: &BranchAndBound,
        measurements: &ImageMeasurements,
        config: &FilterConfig,
    ) {
        let pose = self.filter.pose();
        if search.is_half_turn_symmetric()
            && measurements.negative_log_likelihood(pose)
                > measurements.negative_log_likelihood(half_turn(pose))
        {
            self.filter = self.filter.half_turned();
            self.evidence.turn_half();
            self.checked = CheckedMarkings::default();
            self.advised_direction = None;
        }
        let start_error = self.filter.position_std()
            + TYPICAL_RANGE * self.filter.heading_std()
            + matcher.tilt_displacement();
        let tilt_prior = TiltPrior::Independent(matcher.tilt_std());
        let matched = matcher.refine_with_prior(
            measurements.distances,
            measurements.points,
            self.filter.pose_prior(tilt_prior),
            MatchStart::new(start_error),
        );
        self.filter.update(&matched, tilt_prior, config);
        self.images = self.images.saturating_add(1);
        // The priors of pose and tilt count in full: their errors are not those of neighbouring points.
        let by_pose = 0.5 * matched.mahalanobis_squared - matcher.tilt_cost(matched.tilt);
        let cost = measurements.cost(matcher, &matched)
            + by_pose
            + measurements.negative_log_likelihood(matched.pose);
        self.evidence.add(-cost);
        self.hypothesis = Hypothesis::from_match(&matched);
    }
}

impl ImageMeasurements<'_> {
    /// Negative log likelihood of points and tilt.
    fn cost(&self, matcher: &Matcher, matched: &Match) -> f32 {
        match self.map {
            Some(map) => map.image_cost(
                matched.pose,
                matched.tilt,
                (matcher.tilt_std(), self.likelihood_exponent),
                self.distances,
                matcher.config(),
            ),
            None => self.likelihood_exponent * matched.cost + matcher.tilt_cost(matched.tilt),
        }
    }

    /// Negative log likelihood of a pose by compass and goals.
    fn negative_log_likelihood(&self, pose: Pose) -> f32 {
        let compass = self.heading_prior.map_or(0.0, |prior| {
            0.5 * (wrap_angle(pose.theta - prior.heading) / prior.std).powi(2)
        });
        let (goals, observed) = self.goals;
        compass + goals.cost(pose, observed)
    }
}
