//! Tracking: matches an image's points under the prediction and decides whether the pose is still right.
//!
//! Evidence for suspicion goes beyond the two thresholds of nubot2013 4: inlier share, consistency with the prediction
//! (docs/methods.md 8.9), the best pose of the whole field, and the compass.

use nalgebra::{Matrix3, Vector3};

use super::Localizer;
use super::match_figures::MatchFigures;
use super::state::{PoseTrack, Suspicion};
use crate::config::{SuspectRule, Tracker};
use crate::estimate::{Estimate, Reason};
use crate::filter::{PoseFilter, TiltPrior};
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::Hypothesis;
use crate::global_search::heading_histogram::histogram_heading;
use crate::global_search::scan_map::CellMatch;
use crate::matching::{Match, MatchStart, PosePrior, TYPICAL_RANGE};
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// Share of `inlier_share_min` below which a match under the prediction is due to chance.
const CHANCE_SHARE: f32 = 0.5;

/// Largest squared innovation, in standard deviations of a single image, that errors which repeat may explain (97 % of χ² with 3
/// degrees of freedom). Repeated errors make innovations small.
const REPEATED_INNOVATION_MAX: f32 = 9.0;

/// Number of tilted starts of a match that failed from an upright one, their size in standard deviations, and the size
/// from which a tilt may move points to other markings, degrees.
const TILTED_STARTS: usize = 6;
const TILTED_START_SIGMAS: f32 = 2.0;
const TILTED_START_MIN_DEG: f32 = 0.3;

/// A match under the prediction.
struct TrackedMatch {
    matched: Match,
    agreement: Agreement,
}

/// How a match relates to the prediction.
#[derive(Clone, Copy, PartialEq)]
enum Agreement {
    Consistent,
    /// It contradicted the prediction, whose covariance was therefore inflated.
    Inflated,
    /// It contradicts the prediction, and few points support it.
    Contradicts,
}

impl TrackedMatch {
    fn new(matched: Match, agreement: Agreement) -> Self {
        TrackedMatch { matched, agreement }
    }
}

/// Probability of a tracked place that no point of an image supports: such an image shows another place, or clutter alone.
const UNSUPPORTED_PROBABILITY: f32 = 0.5;

impl Localizer {
    /// Tracking or Suspect: updates the pose by an image.
    pub(super) fn track(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        mut track: PoseTrack,
        suspicion: Option<Suspicion>,
    ) -> Estimate {
        let goals = self.take_goals(stamp);
        let log_odds = self
            .coloured_goals
            .half_log_odds(track.filter.pose(), &goals);
        track
            .half_evidence
            .update_goals(log_odds, &self.config.compass);
        if points.len() < self.config.mode.points_min {
            return self.dead_reckon(stamp, track, suspicion, Reason::FewPoints);
        }
        let wrong_half = self.search.is_half_turn_symmetric()
            && track.half_evidence.log_odds() <= -self.config.compass.half_known_log_odds;
        if wrong_half {
            track.filter = track.filter.half_turned();
            track.half_evidence.apply_half_turn(&self.config.compass);
            self.half_turn_map();
        }
        if self.config.tracker == Tracker::ScanMap {
            return self.track_by_scan_map(stamp, points, track, suspicion);
        }
        let (predicted, heading_std) = (track.filter.pose(), track.filter.heading_std());
        let TrackedMatch { matched, agreement } = self.match_points(&mut track.filter, points);
        if self.motion_inputs.imu_active(stamp, &self.config.attitude) {
            let std = math::hypot(heading_std, matched.covariance[(2, 2)].sqrt());
            let contradicts = agreement == Agreement::Inflated;
            self.gyro_conflict
                .add(predicted, matched.pose, std, contradicts);
        }
        if self.config.mode.suspect_rule == SuspectRule::Thresholds {
            track
                .filter
                .update(&matched, self.tilt_prior, &self.config.filter);
            return self.check_thresholds(stamp, track, suspicion, &matched);
        }
        let few_inliers = self.is_poor_match(matched.inlier_share);
        if !few_inliers {
            self.learn_spread(stamp, &matched, &track.filter);
        }
        let poor = agreement != Agreement::Consistent || few_inliers;
        if self.detect_knock(stamp, points, &matched, poor, &mut track.filter) {
            self.confirm_pose(track);
            let reason = Some(Reason::CameraKnocked);
            return self.estimate(stamp, reason, MatchFigures::from(&matched), Vec::new());
        }
        let mut alternatives = Vec::new();
        let mut contradicted = false;
        if let Some(checked) = self.check_gradually(stamp, points, &matched, &mut track) {
            contradicted = checked.is_contradicted;
            alternatives = checked.alternatives;
        }
        if poor || contradicted || suspicion.is_some() {
            track.last_global_check = stamp;
            self.global_check = None;
            alternatives = self.find_alternatives(stamp, points, &matched);
            if let Some(better) = self.better_alternative(&alternatives, &matched, points.len()) {
                return self.suspect(stamp, track, suspicion, &better, alternatives);
            }
        }
        if agreement == Agreement::Contradicts || self.explains_nothing(&matched, points.len()) {
            let mut estimate = self.dead_reckon(stamp, track, suspicion, Reason::PoorMatch);
            // So many points would show the place, were it this one, unless all of them are clutter.
            if estimate.pose.is_some() && points.len() as f32 >= 2.0 * self.config.mode.inliers_min
            {
                estimate.covariance =
                    self.with_probability(UNSUPPORTED_PROBABILITY, &estimate.covariance);
            }
            return estimate;
        }
        let prior = track.filter.pose_prior(self.tilt_prior);
        let predicted = (agreement == Agreement::Consistent).then_some(prior);
        track
            .filter
            .update(&matched, self.tilt_prior, &self.config.filter);
        self.learn_map(stamp, points, &matched, predicted, &mut track.filter);
        self.repeated_error.update(
            matched.pose,
            &matched.covariance,
            matched.repeated_factor,
            &prior,
        );
        self.tilt_variances = Some([3, 4].map(|k| matched.pose_tilt_covariance[(k, k)]));
        self.mean_inlier_share += 0.05 * (matched.inlier_share - self.mean_inlier_share);
        self.confirm_pose(track);
        let reason = if wrong_half {
            Some(Reason::CompassConflict)
        } else {
            poor.then_some(Reason::PoorMatch)
        };
        self.estimate(stamp, reason, MatchFigures::from(&matched), alternatives)
    }

    /// minho2016 IV and V.B: heading from histograms near the predicted one, then the best cell of the local search.
    fn track_by_scan_map(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        mut track: PoseTrack,
        suspicion: Option<Suspicion>,
    ) -> Estimate {
        let histogram = &self.config.global_search.heading_histogram;
        let predicted = track.filter.pose();
        let heading = histogram_heading(points, predicted.theta, histogram);
        let centre = Pose::new(predicted.x, predicted.y, heading.unwrap_or(predicted.theta));
        let found = self
            .scan_map
            .as_ref()
            .and_then(|map| map.find_pose_near(points, centre));
        if let Some(CellMatch { pose, .. }) = found {
            // Standard deviations: one cell, and one step of the histograms.
            let cell = self.config.global_search.scan_map.cell;
            let step = histogram.step_deg.to_radians();
            let variances = Vector3::new(cell * cell, cell * cell, step * step);
            let covariance = Matrix3::from_diagonal(&variances);
            track
                .filter
                .update_pose(pose, &covariance, &self.config.filter);
        }
        let matched =
            self.matcher
                .evaluate(&self.distance_field, points, track.filter.pose(), [0.0; 2]);
        self.check_thresholds(stamp, track, suspicion, &matched)
    }

    /// nubot2013 4: an image is suspect if its mean deviation and the deviation from the compass both exceed a threshold.
    /// Five consecutive ones restart the localization.
    fn check_thresholds(
        &mut self,
        stamp: Stamp,
        track: PoseTrack,
        suspicion: Option<Suspicion>,
        matched: &Match,
    ) -> Estimate {
        let mode = &self.config.mode;
        let points_deviate = matched.mean_distance > mode.mean_distance_max;
        let compass_deviates = self.heading_prior(stamp).is_none_or(|prior| {
            wrap_angle(track.filter.pose().theta - prior.heading).abs()
                > mode.compass_deviation_max_deg.to_radians()
        });
        let reason = if points_deviate && compass_deviates {
            self.suspect_poor_match(track, suspicion);
            Some(Reason::PoorMatch)
        } else {
            self.confirm_pose(track);
            None
        };
        self.estimate(stamp, reason, MatchFigures::from(matched), Vec::new())
    }

    /// Matches the points under the filter's prediction (docs/methods.md 8.9).
    ///
    /// If the match is inconsistent with the prediction, or clearly better without it, something moved the robot that
    /// no sensor reported. The filter's covariance is then inflated.
    fn match_points(&mut self, filter: &mut PoseFilter, points: &[LinePoint]) -> TrackedMatch {
        let prior = filter.pose_prior(self.tilt_prior);
        let start_error = filter.position_std()
            + TYPICAL_RANGE * filter.heading_std()
            + self.matcher.tilt_displacement();
        let start = MatchStart::new(start_error);
        let mut matched =
            self.matcher
                .refine_with_prior(&self.distance_field, points, prior, start);
        if matched.repetition_ratio > 1.0
            && filter
                .single_image_innovation_squared(&matched, &self.map_pose_covariance())
                .is_some_and(|squared| squared > REPEATED_INNOVATION_MAX)
        {
            let start = MatchStart {
                is_single_image: true,
                ..start
            };
            matched = self
                .matcher
                .refine_with_prior(&self.distance_field, points, prior, start);
        }
        let normalized_innovation_max = self.config.mode.normalized_innovation_max;
        let is_consistent = |filter: &PoseFilter, matched: &Match| {
            filter.normalized_innovation_squared(matched) <= normalized_innovation_max
        };
        if !is_consistent(filter, &matched) || self.is_poor_match(matched.inlier_share) {
            matched = self.match_tilted(points, prior, start, matched);
            if (!is_consistent(filter, &matched) || self.is_poor_match(matched.inlier_share))
                && let Some(leaning) = self.match_leaning(filter, points, start, &matched)
            {
                return TrackedMatch::new(leaning, Agreement::Consistent);
            }
        }
        let consistent = is_consistent(filter, &matched);
        let poor = self.is_poor_match(matched.inlier_share);
        let agrees = consistent && !poor;
        let may_be_pulled = matched.repetition_ratio > 1.0
            && self.config.mode.suspect_rule != SuspectRule::Thresholds;
        if agrees && !may_be_pulled {
            return TrackedMatch::new(matched, Agreement::Consistent);
        }
        if let Some(free) = self.match_freely(filter, points, &matched) {
            if agrees {
                // Images that repeat errors count so little that slow wheels pulled the pose off the markings.
                filter.learn_noise(&free, self.tilt_prior);
            }
            filter.admit_motion(free.pose.difference(filter.pose()).into());
            let start = MatchStart {
                pose: Some(free.pose),
                tilt: free.tilt,
                error: 0.0,
                is_single_image: true,
            };
            let prior = filter.pose_prior(self.tilt_prior);
            let matched =
                self.matcher
                    .refine_with_prior(&self.distance_field, points, prior, start);
            return TrackedMatch::new(matched, Agreement::Inflated);
        }
        if consistent {
            return TrackedMatch::new(matched, Agreement::Consistent);
        }
        if poor {
            return TrackedMatch::new(matched, Agreement::Contradicts);
        }
        // What the wheels' noise has to explain, before the inflation explains it.
        filter.learn_noise(&matched, self.tilt_prior);
        filter.inflate_covariance(filter.normalized_innovation_squared(&matched));
        let prior = filter.pose_prior(self.tilt_prior);
        let matched = self
            .matcher
            .refine_with_prior(&self.distance_field, points, prior, start);
        TrackedMatch::new(matched, Agreement::Inflated)
    }

    /// The match without the prediction, if it explains clearly more points than the one under it.
    fn match_freely(
        &mut self,
        filter: &PoseFilter,
        points: &[LinePoint],
        matched: &Match,
    ) -> Option<Match> {
        let margin = self.score_margin(points.len());
        let gain = |score: f32| (score - matched.score) * points.len() as f32;
        if gain(1.0) <= margin {
            return None;
        }
        let reach = self.config.mode.unreported_motion_max;
        let free = self
            .matcher
            .refine(&self.distance_field, points, filter.pose(), reach);
        let offset = free.pose.difference(filter.pose());
        let is_better = !self.is_poor_match(free.inlier_share)
            && gain(free.score) > margin
            && math::hypot(offset[0], offset[1]) < 2.0 * reach;
        is_better.then_some(free)
    }

    /// The match of a robot that leans as its inertial unit does not report, if it agrees with the predicted pose and explains clearly
    /// more points.
    fn match_leaning(
        &mut self,
        filter: &PoseFilter,
        points: &[LinePoint],
        start: MatchStart,
        matched: &Match,
    ) -> Option<Match> {
        let unmeasured_std = self.config.matching.tilt_std_deg.to_radians();
        let is_narrow = match self.tilt_prior {
            TiltPrior::FromState {
                unmeasured_std: learned,
            } => learned > 0.0 && learned < unmeasured_std,
            TiltPrior::Independent(_) => false,
        };
        let margin = self.score_margin(points.len());
        let gain = |score: f32| (score - matched.score) * points.len() as f32;
        if !is_narrow || gain(1.0) <= margin {
            return None;
        }
        let before = self.matcher.tilt_std();
        self.matcher.set_tilt_std(unmeasured_std);
        let tilt_prior = TiltPrior::FromState { unmeasured_std };
        let prior = filter.pose_prior(tilt_prior);
        let upright = self
            .matcher
            .refine_with_prior(&self.distance_field, points, prior, start);
        let leaning = self.match_tilted(points, prior, start, upright);
        let agrees = filter.normalized_innovation_squared(&leaning)
            <= self.config.mode.normalized_innovation_max;
        if !agrees || self.is_poor_match(leaning.inlier_share) || gain(leaning.score) <= margin {
            self.matcher.set_tilt_std(before);
            return None;
        }
        self.tilt_prior = tilt_prior;
        self.tilt_spread.widen_unmeasured(leaning.tilt);
        Some(leaning)
    }

    /// The best of a match and of those from tilted starts. A large tilt moves far points to other markings.
    fn match_tilted(
        &mut self,
        points: &[LinePoint],
        prior: PosePrior,
        start: MatchStart,
        upright: Match,
    ) -> Match {
        let size = TILTED_START_SIGMAS * self.matcher.tilt_std();
        if size < TILTED_START_MIN_DEG.to_radians() {
            return upright;
        }
        let objective = |matched: &Match| matched.cost + 0.5 * matched.mahalanobis_squared;
        let mut best = upright;
        for k in 0..TILTED_STARTS {
            let angle = std::f32::consts::TAU * k as f32 / TILTED_STARTS as f32;
            let tilt = [size * math::cos(angle), size * math::sin(angle)];
            let start = MatchStart { tilt, ..start };
            let matched =
                self.matcher
                    .refine_with_prior(&self.distance_field, points, prior, start);
            if objective(&matched) < objective(&best) {
                best = matched;
            }
        }
        best
    }

    /// Is the inlier share too low, absolutely or against its mean?
    fn is_poor_match(&self, inlier_share: f32) -> bool {
        let mode = &self.config.mode;
        inlier_share < mode.inlier_share_min
            || inlier_share < mode.inlier_share_drop_max * self.mean_inlier_share
    }

    /// Are so few points on markings that the match is due to chance?
    fn explains_nothing(&self, matched: &Match, count: usize) -> bool {
        let mode = &self.config.mode;
        matched.inlier_share < CHANCE_SHARE * mode.inlier_share_min
            || matched.inlier_share * (count as f32) < mode.points_min as f32
    }

    /// Number of points that a better pose must explain beyond those of the tracked one.
    pub(super) fn score_margin(&self, count: usize) -> f32 {
        let mode = &self.config.mode;
        (mode.alternative_margin_share * count as f32).max(mode.alternative_margin_points)
    }

    /// No use of the points: odometry alone, until the pose is too uncertain.
    fn dead_reckon(
        &mut self,
        stamp: Stamp,
        mut track: PoseTrack,
        suspicion: Option<Suspicion>,
        reason: Reason,
    ) -> Estimate {
        let mode = &self.config.mode;
        if track.filter.position_std() > mode.lost_position_std
            || track.filter.heading_std() > mode.lost_heading_std_deg.to_radians()
        {
            self.lose_pose();
            return self.lost_estimate(stamp, Reason::DeadReckoningTimeout, Vec::new());
        }
        track.filter.update_without_vision();
        let alternative = match &suspicion {
            Some(Suspicion::BetterAlternative(alternative)) => Some(alternative.filter.pose()),
            Some(Suspicion::PoorMatch { .. }) | None => None,
        };
        self.keep_pose(track, suspicion);
        let mut estimate = self.estimate(stamp, Some(reason), MatchFigures::default(), Vec::new());
        // An image that shows nothing ends no suspicion.
        if let Some(alternative) = alternative {
            self.add_alternative(&mut estimate, alternative);
        }
        estimate
    }

    /// Makes a suspect pose as uncertain as it is beside a pose that explained the points better. Both count as equally probable until one
    /// of them is confirmed, and neither may be right.
    fn add_alternative(&self, estimate: &mut Estimate, alternative: Pose) {
        if let Some(pose) = estimate.pose {
            let offset = alternative.difference(pose);
            estimate.covariance += offset * offset.transpose() * 0.5;
            estimate.covariance = self.or_any_place(&estimate.covariance);
        }
    }

    /// The best poses of the whole field that differ from the tracked one.
    fn find_alternatives(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
    ) -> Vec<Hypothesis> {
        let heading_prior = self.heading_prior(stamp);
        let mut found = self.search.find_hypotheses(
            &self.distance_field,
            &mut self.matcher,
            points,
            heading_prior,
        );
        let fold_half_turn = heading_prior.is_none() && self.search.is_half_turn_symmetric();
        self.retain_alternatives(&mut found, matched.pose, fold_half_turn);
        found
    }

    /// Keeps the poses that differ from the tracked one.
    ///
    /// Without a compass the half turn explains the points equally well. It is no reason for suspicion.
    pub(super) fn retain_alternatives(
        &self,
        found: &mut Vec<Hypothesis>,
        tracked: Pose,
        fold_half_turn: bool,
    ) {
        let folds = |pose: Pose| {
            fold_half_turn
                && wrap_angle(pose.theta - tracked.theta).abs() > std::f32::consts::FRAC_PI_2
        };
        found.retain(|hypothesis| {
            !self.search.is_same_hypothesis(hypothesis.pose, tracked) && !folds(hypothesis.pose)
        });
    }

    /// The alternative that explains clearly more points than the tracked pose.
    pub(super) fn better_alternative(
        &self,
        alternatives: &[Hypothesis],
        matched: &Match,
        count: usize,
    ) -> Option<Hypothesis> {
        let mode = &self.config.mode;
        let margin = self.score_margin(count);
        let count = count as f32;
        alternatives
            .iter()
            .max_by(|a, b| a.score.total_cmp(&b.score))
            .filter(|best| {
                (best.score - matched.score) * count > margin
                    && best.inlier_share * count >= mode.inliers_min
                    && best.inlier_share >= mode.global_inlier_share_min
            })
            .cloned()
    }

    /// Another pose is better: the tracked pose is suspect and is not updated by this image.
    fn suspect(
        &mut self,
        stamp: Stamp,
        track: PoseTrack,
        suspicion: Option<Suspicion>,
        better: &Hypothesis,
        alternatives: Vec<Hypothesis>,
    ) -> Estimate {
        let alternative = PoseFilter::new(
            better.pose,
            &better.covariance,
            Some(&track.filter),
            &self.config.filter,
            &self.odometry_prior,
        );
        self.suspect_alternative(track, suspicion, alternative);
        let reason = Some(Reason::BetterAlternative);
        let mut estimate = self.estimate(stamp, reason, MatchFigures::default(), alternatives);
        self.add_alternative(&mut estimate, better.pose);
        estimate
    }
}
