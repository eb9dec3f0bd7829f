//! Which poses explain the points of one keyframe? Tables of a field for their search.

use crate::config::LocalizeConfig;
use crate::field::Field;
use crate::frames::Pose;
use crate::global_search::branch_and_bound::{
    BranchAndBound, BranchAndBoundConfig, Hypothesis, half_turn,
};
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;

use super::chain::KeyframeHypotheses;
use super::keyframe::Keyframe;

/// Largest displacement that a refinement of known poses follows, metres.
const START_ERROR: f32 = 0.3;
/// Exponent of the joint likelihood of a keyframe's points. Above that of a search: a wrong place bends to the points of one
/// image, a wrong set-up must explain those of many.
const LIKELIHOOD_EXPONENT: f32 = 0.3;

/// Tables of one field for the search of poses.
#[derive(Debug, Clone)]
pub struct FieldTables {
    field: Field,
    pub(super) distances: DistanceField,
    /// Built by the first search: [`refine`] does without.
    search: Option<BranchAndBound>,
    matcher: Matcher,
    config: BranchAndBoundConfig,
    kernel_squared: f32,
}

impl FieldTables {
    /// Builds the tables of a field.
    pub fn new(field: &Field, config: &LocalizeConfig) -> Self {
        let distances = DistanceField::new(field, &config.distance_field);
        FieldTables {
            field: field.clone(),
            search: None,
            matcher: Matcher::new(config.matching.clone()),
            distances,
            config: config.branch_and_bound.clone(),
            kernel_squared: config.matching.kernel_scale_sigmas.powi(2),
        }
    }

    /// The poses that explain the points of one keyframe, half turns included.
    pub(super) fn hypotheses(&mut self, keyframe: &Keyframe) -> KeyframeHypotheses {
        let FieldTables {
            field,
            distances,
            search,
            matcher,
            config,
            ..
        } = self;
        let search =
            search.get_or_insert_with(|| BranchAndBound::new(field, distances, config.clone()));
        let found = search.find_hypotheses(distances, matcher, &keyframe.points, None);
        let symmetric = search.is_half_turn_symmetric();
        let mut poses: Vec<Hypothesis> = Vec::new();
        for hypothesis in found {
            let turned = Hypothesis {
                pose: half_turn(hypothesis.pose),
                ..hypothesis.clone()
            };
            let both = [Some(hypothesis), symmetric.then_some(turned)];
            for each in both.into_iter().flatten() {
                let known = |other: &Hypothesis| search.is_same_hypothesis(other.pose, each.pose);
                if !poses.iter().any(known) {
                    poses.push(each);
                }
            }
        }
        let cost = |hypothesis: Hypothesis| (self.cost(keyframe, hypothesis.score), hypothesis);
        KeyframeHypotheses {
            hypotheses: poses.into_iter().map(cost).collect(),
        }
    }

    /// The pose near another one that explains a keyframe best, with its cost.
    pub(super) fn hypothesis_near(&mut self, keyframe: &Keyframe, pose: Pose) -> (f32, Hypothesis) {
        let FieldTables {
            distances, matcher, ..
        } = &mut *self;
        let matched = matcher.refine(distances, &keyframe.points, pose, START_ERROR);
        let hypothesis = Hypothesis::from_match(&matched);
        (self.cost(keyframe, hypothesis.score), hypothesis)
    }

    /// The pose near another one that explains a keyframe best, added to its hypotheses unless it is one of them. `added`: becomes true if so.
    pub(super) fn add_near(
        &mut self,
        keyframe: &Keyframe,
        near: Pose,
        own: &mut KeyframeHypotheses,
        added: &mut bool,
    ) -> Pose {
        if keyframe.points.is_empty() {
            return near;
        }
        let found = self.hypothesis_near(keyframe, near);
        let pose = found.1.pose;
        let is_same = |other: &(f32, Hypothesis)| {
            let search = self.search.as_ref();
            search.is_some_and(|search| search.is_same_hypothesis(other.1.pose, pose))
        };
        if !own.hypotheses.iter().any(is_same) {
            own.hypotheses.push(found);
            *added = true;
        }
        pose
    }

    /// Negative log likelihood of a keyframe's points, tempered (their errors are correlated).
    fn cost(&self, keyframe: &Keyframe, score: f32) -> f32 {
        let points = keyframe.points.iter();
        let within = points.filter(|point| point.at.distance() < self.config.range_max);
        let used = within.count().min(self.config.points_max) as f32;
        0.5 * self.kernel_squared * LIKELIHOOD_EXPONENT * used * (1.0 - score)
    }
}
