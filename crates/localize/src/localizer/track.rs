//! Does the pose carry on? A frame's points under the expectation, and what makes a pose suspect.

use nalgebra::{Matrix3, Vector3};

use super::Localizer;
use crate::config::{SuspectRule, Tracker};
use crate::estimate::{Estimate, Reason};
use crate::filter::PoseFilter;
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::Hypothesis;
use crate::global_search::heading_histogram::histogram_heading;
use crate::global_search::scan_map::CellMatch;
use crate::localizer::candidates::pose_difference;
use crate::matching::Match;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

impl Localizer {
    pub(super) fn track(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let Some(mut belief) = self.filter.take() else {
            return self.localize_globally(stamp, points);
        };
        let goals = self.take_goals(stamp);
        let odds = self.coloured_goals.half_log_odds(belief.pose(), &goals);
        self.half_evidence.update_goals(odds, &self.config.compass);
        if points.len() < self.config.mode.points_min {
            return self.dead_reckon(stamp, belief);
        }
        let contradicted = self.search.is_half_turn_symmetric()
            && self.half_evidence.log_odds() <= -self.config.compass.half_known_log_odds;
        if contradicted {
            belief = belief.half_turned();
            self.half_evidence.apply_half_turn();
        }
        if self.config.tracker == Tracker::ScanMap {
            return self.track_by_scan_map(stamp, belief, points);
        }
        let (matched, strained) = self.match_points(&mut belief, points);
        if self.config.mode.suspect_rule == SuspectRule::Thresholds {
            belief.update(&matched, self.tilt_prior, &self.config.filter);
            return self.check_thresholds(stamp, belief, &matched);
        }
        let mode = &self.config.mode;
        let share = matched.inlier_share;
        let poor = strained || self.is_poor_match(share);
        let due = mode.global_check_period > 0.0
            && self.last_global_check.seconds_until(stamp) >= mode.global_check_period;
        let mut rivals = Vec::new();
        if poor || due || self.alternative.is_some() {
            self.last_global_check = stamp;
            rivals = self.find_alternatives(stamp, points, &matched);
            if let Some(rival) = self.better_alternative(&rivals, &matched, points.len()) {
                return self.suspect(stamp, belief, &rival, rivals);
            }
        }
        self.alternative = None;
        belief.update(&matched, self.tilt_prior, &self.config.filter);
        self.tilt_variances = Some([3, 4].map(|k| matched.pose_tilt_covariance[(k, k)]));
        // Forgets over about a second of frames.
        self.mean_inlier_share += 0.05 * (share - self.mean_inlier_share);
        self.filter = Some(belief);
        let reason = if contradicted {
            Some(Reason::CompassConflict)
        } else {
            poor.then_some(Reason::PoorMatch)
        };
        self.estimate(stamp, reason, Some(&matched), rivals)
    }

    /// minho2016 IV and V.B: heading by histograms about the expected one, then the best cell of the local search.
    fn track_by_scan_map(
        &mut self,
        stamp: Stamp,
        mut belief: PoseFilter,
        points: &[LinePoint],
    ) -> Estimate {
        let expected = belief.pose();
        let heading = histogram_heading(
            points,
            expected.theta,
            &self.config.global_search.heading_histogram,
        );
        let centre = Pose::new(expected.x, expected.y, heading.unwrap_or(expected.theta));
        let found = self
            .scan_map
            .as_ref()
            .and_then(|map| map.find_pose_near(points, centre));
        if let Some(CellMatch { pose, .. }) = found {
            // A cell, and about half a step of the histograms.
            let cell = self.config.global_search.scan_map.cell;
            let turn = self
                .config
                .global_search
                .heading_histogram
                .step_deg
                .to_radians();
            let variances = Vector3::new(cell * cell, cell * cell, turn * turn);
            let sight = Matrix3::from_diagonal(&variances);
            belief.update_pose(pose, &sight, &self.config.filter);
        }
        let matched = self
            .matcher
            .evaluate(&self.distance_field, points, belief.pose());
        self.check_thresholds(stamp, belief, &matched)
    }

    /// nubot2013 4: a possible error is a mean deviation above a threshold and a heading off the compass by another;
    /// five such cycles in a row, and localisation starts anew.
    fn check_thresholds(&mut self, stamp: Stamp, belief: PoseFilter, matched: &Match) -> Estimate {
        let mode = &self.config.mode;
        let deviates = matched.mean_distance > mode.mean_distance_max;
        let turned = self.heading_prior(stamp).is_none_or(|prior| {
            wrap_angle(belief.pose().theta - prior.heading).abs()
                > mode.compass_deviation_max_deg.to_radians()
        });
        self.suspect_frames = if deviates && turned {
            self.suspect_frames + 1
        } else {
            0
        };
        if self.suspect_frames >= mode.suspect_frames_max {
            self.reset();
            return self.lost_estimate(stamp, Reason::PoorMatch, Vec::new());
        }
        self.filter = Some(belief);
        let reason = (self.suspect_frames > 0).then_some(Reason::PoorMatch);
        self.estimate(stamp, reason, Some(matched), Vec::new())
    }

    /// Matches under the belief's expectation. Where the points pull too hard against it, or lie on the markings only
    /// when it is let go, something unreported moved the robot: the expectation is widened. Says whether that was so.
    fn match_points(&mut self, belief: &mut PoseFilter, points: &[LinePoint]) -> (Match, bool) {
        let spread = belief.position_std() + 3.0 * belief.heading_std();
        let expected = belief.pose_prior(self.tilt_prior);
        let matched =
            self.matcher
                .refine_with_prior(&self.distance_field, points, expected, spread);
        let mode = &self.config.mode;
        let surprise = belief.normalized_innovation_squared(&matched);
        if surprise <= mode.normalized_innovation_max && !self.is_poor_match(matched.inlier_share) {
            return (matched, false);
        }
        let free = self.matcher.refine(
            &self.distance_field,
            points,
            belief.pose(),
            mode.unreported_motion_max,
        );
        let count = points.len() as f32;
        let margin = (mode.alternative_margin_share * count).max(mode.alternative_margin_points);
        let apart = pose_difference(free.pose, belief.pose());
        if (free.score - matched.score) * count > margin
            && apart[0].hypot(apart[1]) < 2.0 * mode.unreported_motion_max
        {
            let information = expected.information.fixed_view::<3, 3>(0, 0);
            belief.inflate_covariance(apart.dot(&(information * apart)));
            return (free, true);
        }
        if surprise <= mode.normalized_innovation_max {
            return (matched, false);
        }
        belief.inflate_covariance(surprise);
        let expected = belief.pose_prior(self.tilt_prior);
        let again = self
            .matcher
            .refine_with_prior(&self.distance_field, points, expected, spread);
        (again, true)
    }

    /// Do fewer points lie on the markings than should, or than usually do?
    fn is_poor_match(&self, inlier_share: f32) -> bool {
        let mode = &self.config.mode;
        inlier_share < mode.inlier_share_min
            || inlier_share < mode.inlier_share_drop_max * self.mean_inlier_share
    }

    /// No sight: odometry alone, until it is too uncertain.
    fn dead_reckon(&mut self, stamp: Stamp, belief: PoseFilter) -> Estimate {
        let mode = &self.config.mode;
        if belief.position_std() > mode.lost_position_std
            || belief.heading_std() > mode.lost_heading_std_deg.to_radians()
        {
            self.reset();
            return self.lost_estimate(stamp, Reason::DeadReckoningTimeout, Vec::new());
        }
        let mut belief = belief;
        belief.update_without_vision(&self.config.filter);
        self.filter = Some(belief);
        self.estimate(stamp, Some(Reason::FewPoints), None, Vec::new())
    }

    /// The best poses of the whole field that are not the tracked one.
    pub(super) fn find_alternatives(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
    ) -> Vec<Hypothesis> {
        let prior = self.heading_prior(stamp);
        let mut found =
            self.search
                .find_hypotheses(&self.distance_field, &mut self.matcher, points, prior);
        // Without a compass the half turn of a pose explains as much: it is no rival, nor a reason to turn.
        let folded = prior.is_none() && self.search.is_half_turn_symmetric();
        found.retain(|one| {
            let turned = wrap_angle(one.pose.theta - matched.pose.theta).abs();
            !(self.search.is_same_hypothesis(one.pose, matched.pose)
                || folded && turned > std::f32::consts::FRAC_PI_2)
        });
        found
    }

    /// The rival that explains clearly more points than the tracked pose does.
    fn better_alternative(
        &self,
        rivals: &[Hypothesis],
        matched: &Match,
        count: usize,
    ) -> Option<Hypothesis> {
        let mode = &self.config.mode;
        let count = count as f32;
        let margin = (mode.alternative_margin_share * count).max(mode.alternative_margin_points);
        rivals
            .iter()
            .max_by(|a, b| a.score.total_cmp(&b.score))
            .filter(|rival| {
                (rival.score - matched.score) * count > margin
                    && rival.inlier_share * count >= mode.inliers_min
                    && rival.inlier_share >= mode.global_inlier_share_min
            })
            .cloned()
    }

    /// Another pose is better: when it was the same one in five frames, odometry between them included, the tracked
    /// one is given up.
    fn suspect(
        &mut self,
        stamp: Stamp,
        belief: PoseFilter,
        rival: &Hypothesis,
        rivals: Vec<Hypothesis>,
    ) -> Estimate {
        let config = &self.config.filter;
        let fresh = PoseFilter::new(rival.pose, &rival.covariance, Some(&belief), config);
        let strikes = match self.alternative.take() {
            Some((known, strikes)) if self.search.is_same_hypothesis(known.pose(), rival.pose) => {
                strikes + 1
            }
            _ => 1,
        };
        if strikes >= self.config.mode.suspect_frames_max {
            self.reset();
            return self.lost_estimate(stamp, Reason::BetterAlternative, rivals);
        }
        self.alternative = Some((fresh, strikes));
        self.filter = Some(belief);
        let estimate = self.estimate(stamp, Some(Reason::BetterAlternative), None, rivals);
        let apart = estimate
            .pose
            .map_or_else(Vector3::zeros, |pose| pose_difference(rival.pose, pose));
        Estimate {
            // As likely there as here, until one of them has won.
            covariance: estimate.covariance + apart * apart.transpose() * 0.5,
            ..estimate
        }
    }
}
