//! Tracking: matches an image's points under the prediction and decides whether the pose is still right.
//!
//! Evidence for suspicion goes beyond the two thresholds of nubot2013 4: inlier share, consistency with the prediction
//! (docs/methods.md 8.9), the best pose of the whole field, and the compass.

use nalgebra::{Matrix3, Vector3};

use super::Localizer;
use super::match_figures::MatchFigures;
use super::state::{Suspicion, Track};
use crate::config::{SuspectRule, Tracker};
use crate::estimate::{Estimate, Reason};
use crate::filter::PoseFilter;
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::Hypothesis;
use crate::global_search::heading_histogram::histogram_heading;
use crate::global_search::scan_map::CellMatch;
use crate::matching::Match;
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// A match under the prediction.
struct TrackedMatch {
    matched: Match,
    /// The match contradicted the prediction, whose covariance was therefore inflated.
    inconsistent: bool,
}

impl Localizer {
    /// Tracking or Suspect: updates the pose by an image.
    pub(super) fn track(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        mut track: Track,
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
            return self.dead_reckon(stamp, track, suspicion);
        }
        let wrong_half = self.search.is_half_turn_symmetric()
            && track.half_evidence.log_odds() <= -self.config.compass.half_known_log_odds;
        if wrong_half {
            track.filter = track.filter.half_turned();
            track.half_evidence.apply_half_turn();
        }
        if self.config.tracker == Tracker::ScanMap {
            return self.track_by_scan_map(stamp, points, track, suspicion);
        }
        let TrackedMatch {
            matched,
            inconsistent,
        } = self.match_points(&mut track.filter, points);
        if self.config.mode.suspect_rule == SuspectRule::Thresholds {
            track
                .filter
                .update(&matched, self.tilt_prior, &self.config.filter);
            return self.check_thresholds(stamp, track, suspicion, &matched);
        }
        let poor = inconsistent || self.is_poor_match(matched.inlier_share);
        let check_period = self.config.mode.global_check_period;
        let due =
            check_period > 0.0 && track.last_global_check.seconds_until(stamp) >= check_period;
        let mut alternatives = Vec::new();
        if poor || due || suspicion.is_some() {
            track.last_global_check = stamp;
            alternatives = self.find_alternatives(stamp, points, &matched);
            if let Some(better) = self.better_alternative(&alternatives, &matched, points.len()) {
                return self.suspect(stamp, track, suspicion, &better, alternatives);
            }
        }
        track
            .filter
            .update(&matched, self.tilt_prior, &self.config.filter);
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
        mut track: Track,
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
        let matched = self
            .matcher
            .evaluate(&self.distance_field, points, track.filter.pose());
        self.check_thresholds(stamp, track, suspicion, &matched)
    }

    /// nubot2013 4: an image is suspect if its mean deviation and the deviation from the compass both exceed a threshold.
    /// Five consecutive ones restart the localization.
    fn check_thresholds(
        &mut self,
        stamp: Stamp,
        track: Track,
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
        let start_error = filter.position_std() + 3.0 * filter.heading_std();
        let prior = filter.pose_prior(self.tilt_prior);
        let matched =
            self.matcher
                .refine_with_prior(&self.distance_field, points, prior, start_error);
        let mode = &self.config.mode;
        let innovation_squared = filter.normalized_innovation_squared(&matched);
        let consistent = innovation_squared <= mode.normalized_innovation_max;
        if consistent && !self.is_poor_match(matched.inlier_share) {
            return TrackedMatch {
                matched,
                inconsistent: false,
            };
        }
        let free = self.matcher.refine(
            &self.distance_field,
            points,
            filter.pose(),
            mode.unreported_motion_max,
        );
        let offset = free.pose.difference(filter.pose());
        if (free.score - matched.score) * points.len() as f32 > self.score_margin(points.len())
            && math::hypot(offset[0], offset[1]) < 2.0 * mode.unreported_motion_max
        {
            let information = prior.information.fixed_view::<3, 3>(0, 0);
            filter.inflate_covariance(offset.dot(&(information * offset)));
            return TrackedMatch {
                matched: free,
                inconsistent: true,
            };
        }
        if consistent {
            return TrackedMatch {
                matched,
                inconsistent: false,
            };
        }
        filter.inflate_covariance(innovation_squared);
        let prior = filter.pose_prior(self.tilt_prior);
        TrackedMatch {
            matched: self.matcher.refine_with_prior(
                &self.distance_field,
                points,
                prior,
                start_error,
            ),
            inconsistent: true,
        }
    }

    /// Is the inlier share too low, absolutely or against its mean?
    fn is_poor_match(&self, inlier_share: f32) -> bool {
        let mode = &self.config.mode;
        inlier_share < mode.inlier_share_min
            || inlier_share < mode.inlier_share_drop_max * self.mean_inlier_share
    }

    /// Number of points that a better pose must explain beyond those of the tracked one.
    fn score_margin(&self, count: usize) -> f32 {
        let mode = &self.config.mode;
        (mode.alternative_margin_share * count as f32).max(mode.alternative_margin_points)
    }

    /// Too few points: odometry alone, until the pose is too uncertain.
    fn dead_reckon(
        &mut self,
        stamp: Stamp,
        mut track: Track,
        suspicion: Option<Suspicion>,
    ) -> Estimate {
        let mode = &self.config.mode;
        if track.filter.position_std() > mode.lost_position_std
            || track.filter.heading_std() > mode.lost_heading_std_deg.to_radians()
        {
            self.lose_pose();
            return self.lost_estimate(stamp, Reason::DeadReckoningTimeout, Vec::new());
        }
        track.filter.update_without_vision(&self.config.filter);
        self.keep_pose(track, suspicion);
        let reason = Some(Reason::FewPoints);
        self.estimate(stamp, reason, MatchFigures::default(), Vec::new())
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
        // Without a compass the half turn explains the points equally well. It is no reason for suspicion.
        let fold_half_turn = heading_prior.is_none() && self.search.is_half_turn_symmetric();
        found.retain(|hypothesis| {
            let rotation = wrap_angle(hypothesis.pose.theta - matched.pose.theta).abs();
            !(self
                .search
                .is_same_hypothesis(hypothesis.pose, matched.pose)
                || fold_half_turn && rotation > std::f32::consts::FRAC_PI_2)
        });
        found
    }

    /// The alternative that explains clearly more points than the tracked pose.
    fn better_alternative(
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
        track: Track,
        suspicion: Option<Suspicion>,
        better: &Hypothesis,
        alternatives: Vec<Hypothesis>,
    ) -> Estimate {
        let alternative = PoseFilter::new(
            better.pose,
            &better.covariance,
            Some(&track.filter),
            &self.config.filter,
        );
        self.suspect_alternative(track, suspicion, alternative);
        let reason = Some(Reason::BetterAlternative);
        let mut estimate = self.estimate(stamp, reason, MatchFigures::default(), alternatives);
        if let Some(pose) = estimate.pose {
            // Both poses count as equally probable until one of them is confirmed.
            let offset = better.pose.difference(pose);
            estimate.covariance += offset * offset.transpose() * 0.5;
        }
        estimate
    }
}
