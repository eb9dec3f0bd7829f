//! Localization without a tracked pose: a search of the whole field, together with the hypotheses of earlier images.

use super::Localizer;
use super::candidates::{Candidates, ImageMeasurements};
use super::field_half::HalfEvidence;
use super::supported_points::supported_points;
use crate::advice::{Advice, MotionAdvice, PointWeights};
use crate::estimate::{Estimate, Reason};
use crate::global_search::branch_and_bound::{
    BranchAndBound, CertifiedHypotheses, HeadingPrior, Hypothesis,
};
use crate::global_search::{GlobalSearch, GlobalSearchMethod, SearchInput};
use crate::matching::Matcher;
use crate::math;
use crate::sample::{Compass, GoalObservation, LinePoint};
use crate::stamp::Stamp;

impl Localizer {
    /// Heading prior from the compass reading next to the exposure of an image. None if it is too old or too young.
    pub(super) fn heading_prior(&self, exposed: Stamp) -> Option<HeadingPrior> {
        let age = |reading: &Compass| reading.stamp.seconds_until(exposed).abs();
        let readings = self.compass_readings.iter();
        let compass = readings.min_by(|a, b| age(a).total_cmp(&age(b)))?;
        let age = age(compass);
        (age <= self.config.compass.age_max).then(|| HeadingPrior {
            heading: compass.heading,
            std: self.config.compass.std_deg.to_radians(),
        })
    }

    /// Lost or Ambiguous: searches the whole field and updates the candidates. The search methods are those of
    /// docs/methods.md 6.
    pub(super) fn localize_globally(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        mut candidates: Candidates,
    ) -> Estimate {
        let goals = self.take_goals(stamp);
        if points.len() < self.config.mode.points_min {
            self.keep_candidates(candidates);
            return self.lost_estimate(stamp, Reason::FewPoints, Vec::new());
        }
        // The papers' methods take all points, as the papers do.
        let supported;
        let points = match self.config.global_search.method {
            GlobalSearchMethod::Exact => {
                supported = supported_points(points);
                &supported
            }
            _ => points,
        };
        let input = SearchInput {
            distances: &self.distance_field,
            points,
            heading_prior: self.heading_prior(stamp),
            goals: &goals,
            single_image: self.last_odometry.is_none(),
        };
        let (result, heading_prior) = search_unless_contradicted(
            &mut self.global_search,
            (&mut self.search, &mut self.matcher),
            input,
            self.config.mode.alternative_margin_share,
        );
        let CertifiedHypotheses {
            hypotheses: found,
            certificate,
        } = result;
        if found.is_empty() && self.global_search.is_in_progress() {
            self.keep_candidates(candidates);
            return self.lost_estimate(stamp, Reason::Searching, found);
        }
        if !self.is_plausible_match(&found, points.len()) {
            let unexplained = candidates.count_unexplained();
            if candidates.is_empty() || unexplained >= self.config.mode.suspect_frames_max {
                self.lose_pose();
            } else {
                self.keep_candidates(candidates);
            }
            return self.lost_estimate(stamp, Reason::NoMatch, found);
        }
        let half_observed = heading_prior.is_some() || self.goals_decide_half(&found, &goals);
        let fold_half_turn = self.search.is_half_turn_symmetric() && !half_observed;
        let points_used = self.config.branch_and_bound.points_max as f32;
        let measurements = ImageMeasurements {
            distances: &self.distance_field,
            points,
            heading_prior,
            goals: (&self.coloured_goals, &goals),
            fold_half_turn,
            likelihood_exponent: self.config.branch_and_bound.likelihood_exponent
                * (points_used / points.len() as f32).min(1.0),
            map: self
                .map_correction
                .as_deref()
                .filter(|map| map.is_uncertain()),
        };
        candidates.update(
            &mut self.matcher,
            &self.search,
            &measurements,
            &found,
            &self.config.filter,
            &self.odometry_prior,
        );
        let estimate = self.candidate_estimate(stamp, &candidates, fold_half_turn);
        let Some((mut estimate, (filter, best))) = estimate.zip(candidates.best()) else {
            self.lose_pose();
            return self.lost_estimate(stamp, Reason::NoMatch, found);
        };
        estimate.certificate = certificate;
        if self.is_decided(best) && self.is_confirmed(&candidates) {
            let log_odds = if fold_half_turn {
                0.0
            } else {
                self.config.compass.half_known_log_odds
            };
            let filter = filter.clone();
            self.mean_inlier_share = estimate.inlier_share;
            self.start_tracking(stamp, filter, HalfEvidence::with_log_odds(log_odds));
        } else {
            if self.config.advice.enabled && !self.is_decided(best) {
                candidates.mark_checked(&self.advisor, points);
                let advice = self.advise(points, &candidates);
                candidates.note_advice(advice);
                estimate.advice = advice.map(Advice::Move).or(estimate.advice);
            }
            self.keep_candidates(candidates);
        }
        estimate
    }

    /// The motion that would tell the best candidate from the second.
    fn advise(&self, points: &[LinePoint], candidates: &Candidates) -> Option<MotionAdvice> {
        let matching = self.matcher.config();
        let probability = self.config.mode.decision_probability;
        let weights = PointWeights {
            kernel_scale_sigmas: matching.kernel_scale_sigmas,
            map_std: matching.map_std,
            likelihood_exponent: self.config.branch_and_bound.likelihood_exponent,
            deciding_log_odds: math::ln(probability / (1.0 - probability).max(1e-6)),
        };
        let direction = candidates.advised_direction();
        candidates.best_two().and_then(|two| {
            self.advisor
                .advise(&self.distance_field, points, two, &weights, direction)
        })
    }

    /// Does the best hypothesis explain enough points?
    fn is_plausible_match(&self, found: &[Hypothesis], count: usize) -> bool {
        let mode = &self.config.mode;
        found.first().is_some_and(|best| {
            best.inlier_share >= mode.global_inlier_share_min
                && best.inlier_share * count as f32 >= mode.inliers_min
        })
    }

    /// Do coloured goals decide the field half of at least one hypothesis?
    fn goals_decide_half(&self, found: &[Hypothesis], goals: &[GoalObservation]) -> bool {
        let log_odds_min = self.config.compass.half_known_log_odds;
        found.iter().any(|hypothesis| {
            let log_odds = self.coloured_goals.half_log_odds(hypothesis.pose, goals);
            log_odds.abs() >= log_odds_min
        })
    }
}

/// Searches with the heading of the compass, and without it where another pose then explains clearly more: the lines contradict the
/// compass. Second: the heading that was used. `margin`: share of the score that is clearly more.
fn search_unless_contradicted(
    global_search: &mut GlobalSearch,
    (search, matcher): (&mut BranchAndBound, &mut Matcher),
    input: SearchInput<'_>,
    margin: f32,
) -> (CertifiedHypotheses, Option<HeadingPrior>) {
    let score = |result: &CertifiedHypotheses| {
        let best = result.hypotheses.first();
        best.map_or(0.0, |best| best.score)
    };
    let result = global_search.find_hypotheses(search, matcher, &input);
    let heading_prior = input.heading_prior;
    let is_exact = matches!(global_search, GlobalSearch::Exact);
    if heading_prior.is_none() || !is_exact || score(&result) >= 1.0 - margin {
        return (result, heading_prior);
    }
    let input = SearchInput {
        heading_prior: None,
        ..input
    };
    let without = global_search.find_hypotheses(search, matcher, &input);
    match score(&without) >= score(&result) + margin {
        true => (without, None),
        false => (result, heading_prior),
    }
}
