//! Does the pose carry on? A frame's points under the expectation, and what makes a pose suspect.

use nalgebra::{Matrix3, Vector3};

use super::Localizer;
use crate::candidates::apart;
use crate::config::{SuspectRule, Tracker};
use crate::estimate::{Estimate, Reason};
use crate::filter::Belief;
use crate::frame::{Pose, wrap_angle};
use crate::heading::heading_by_histogram;
use crate::matching::Match;
use crate::sample::LinePoint;
use crate::search::Hypothesis;
use crate::stamp::Stamp;

impl Localizer {
    pub(super) fn track(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let Some(mut belief) = self.belief.take() else {
            return self.relocate(stamp, points);
        };
        let goals = self.goals_of(stamp);
        let odds = self.coloured.odds(belief.pose(), &goals);
        self.half.sees_goals(odds, &self.config.compass);
        if points.len() < self.config.mode.points_min {
            return self.coast(stamp, belief);
        }
        let contradicted =
            self.search.symmetric() && self.half.odds() <= -self.config.compass.known;
        if contradicted {
            belief = belief.half_turned();
            self.half.half_turned();
        }
        if self.config.tracker == Tracker::ScanMap {
            return self.track_by_scan_map(stamp, belief, points);
        }
        let (matched, strained) = self.fuse(&mut belief, points);
        if self.config.mode.rule == SuspectRule::Thresholds {
            belief.absorb(&matched, self.lean_prior, &self.config.filter);
            return self.judge(stamp, belief, &matched);
        }
        let mode = &self.config.mode;
        let share = matched.inlier_share;
        let poor = strained || self.poor(share);
        let due = mode.check_period > 0.0 && self.checked.seconds_until(stamp) >= mode.check_period;
        let mut rivals = Vec::new();
        if poor || due || self.rival.is_some() {
            self.checked = stamp;
            rivals = self.rivals(stamp, points, &matched);
            if let Some(rival) = self.better(&rivals, &matched, points.len()) {
                return self.suspect(stamp, belief, &rival, rivals);
            }
        }
        self.rival = None;
        belief.absorb(&matched, self.lean_prior, &self.config.filter);
        self.lean_left = Some([3, 4].map(|k| matched.with_lean[(k, k)]));
        // Forgets over about a second of frames.
        self.usual_share += 0.05 * (share - self.usual_share);
        self.belief = Some(belief);
        let reason = if contradicted {
            Some(Reason::CompassContradicts)
        } else {
            poor.then_some(Reason::PoorMatch)
        };
        self.estimate(stamp, reason, Some(&matched), rivals)
    }

    /// minho2016 IV and V.B: heading by histograms about the expected one, then the best cell of the local search.
    fn track_by_scan_map(
        &mut self,
        stamp: Stamp,
        mut belief: Belief,
        points: &[LinePoint],
    ) -> Estimate {
        let expected = belief.pose();
        let heading = heading_by_histogram(points, expected.theta, &self.config.relocalise.heading);
        let centre = Pose::new(expected.x, expected.y, heading.unwrap_or(expected.theta));
        let found = self
            .scan_map
            .as_ref()
            .and_then(|map| map.find_near(points, centre));
        if let Some((_, pose)) = found {
            // A cell, and about half a step of the histograms.
            let cell = self.config.relocalise.scan_map.cell;
            let turn = self.config.relocalise.heading.step_deg.to_radians();
            let variances = Vector3::new(cell * cell, cell * cell, turn * turn);
            let sight = Matrix3::from_diagonal(&variances);
            belief.correct(pose, &sight, &self.config.filter);
        }
        let matched = self.matcher.assess(&self.distances, points, belief.pose());
        self.judge(stamp, belief, &matched)
    }

    /// nubot2013 4: a possible error is a mean deviation above a threshold and a heading off the compass by another;
    /// five such cycles in a row, and localisation starts anew.
    fn judge(&mut self, stamp: Stamp, belief: Belief, matched: &Match) -> Estimate {
        let mode = &self.config.mode;
        let deviates = matched.deviation > mode.deviation_max;
        let turned = self.heading_prior(stamp).is_none_or(|prior| {
            wrap_angle(belief.pose().theta - prior.heading).abs()
                > mode.compass_max_deg.to_radians()
        });
        self.strikes = if deviates && turned {
            self.strikes + 1
        } else {
            0
        };
        if self.strikes >= mode.strikes_max {
            self.forget();
            return self.lost(stamp, Reason::PoorMatch, Vec::new());
        }
        self.belief = Some(belief);
        let reason = (self.strikes > 0).then_some(Reason::PoorMatch);
        self.estimate(stamp, reason, Some(matched), Vec::new())
    }

    /// Matches under the belief's expectation. Where the points pull too hard against it, or lie on the markings only
    /// when it is let go, something unreported moved the robot: the expectation is widened. Says whether that was so.
    fn fuse(&mut self, belief: &mut Belief, points: &[LinePoint]) -> (Match, bool) {
        let spread = belief.position_std() + 3.0 * belief.heading_std();
        let expected = belief.expected(self.lean_prior);
        let matched = self.matcher.fuse(&self.distances, points, expected, spread);
        let mode = &self.config.mode;
        let surprise = belief.surprise(&matched);
        if surprise <= mode.surprise_max && !self.poor(matched.inlier_share) {
            return (matched, false);
        }
        let free = self
            .matcher
            .refine(&self.distances, points, belief.pose(), mode.push_max);
        let count = points.len() as f32;
        let margin = (mode.rival_share * count).max(mode.rival_points);
        let apart = apart(free.pose, belief.pose());
        if (free.score - matched.score) * count > margin
            && apart[0].hypot(apart[1]) < 2.0 * mode.push_max
        {
            let information = expected.information.fixed_view::<3, 3>(0, 0);
            belief.widen(apart.dot(&(information * apart)));
            return (free, true);
        }
        if surprise <= mode.surprise_max {
            return (matched, false);
        }
        belief.widen(surprise);
        let expected = belief.expected(self.lean_prior);
        let again = self.matcher.fuse(&self.distances, points, expected, spread);
        (again, true)
    }

    /// Do fewer points lie on the markings than should, or than usually do?
    fn poor(&self, inlier_share: f32) -> bool {
        let mode = &self.config.mode;
        inlier_share < mode.inlier_share_min
            || inlier_share < mode.usual_share_part * self.usual_share
    }

    /// No sight: odometry alone, until it is too uncertain.
    fn coast(&mut self, stamp: Stamp, belief: Belief) -> Estimate {
        let mode = &self.config.mode;
        if belief.position_std() > mode.lost_std
            || belief.heading_std() > mode.lost_std_deg.to_radians()
        {
            self.forget();
            return self.lost(stamp, Reason::Blind, Vec::new());
        }
        let mut belief = belief;
        belief.unseen(&self.config.filter);
        self.belief = Some(belief);
        self.estimate(stamp, Some(Reason::FewPoints), None, Vec::new())
    }

    /// The best poses of the whole field that are not the tracked one.
    pub(super) fn rivals(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
    ) -> Vec<Hypothesis> {
        let prior = self.heading_prior(stamp);
        let mut found = self
            .search
            .find(&self.distances, &mut self.matcher, points, prior);
        // Without a compass the half turn of a pose explains as much: it is no rival, nor a reason to turn.
        let folded = prior.is_none() && self.search.symmetric();
        found.retain(|one| {
            let turned = wrap_angle(one.pose.theta - matched.pose.theta).abs();
            !(self.search.same(one.pose, matched.pose)
                || folded && turned > std::f32::consts::FRAC_PI_2)
        });
        found
    }

    /// The rival that explains clearly more points than the tracked pose does.
    fn better(&self, rivals: &[Hypothesis], matched: &Match, count: usize) -> Option<Hypothesis> {
        let mode = &self.config.mode;
        let count = count as f32;
        let margin = (mode.rival_share * count).max(mode.rival_points);
        rivals
            .iter()
            .max_by(|a, b| a.score.total_cmp(&b.score))
            .filter(|rival| {
                (rival.score - matched.score) * count > margin
                    && rival.inlier_share * count >= mode.inliers_min
                    && rival.inlier_share >= mode.found_share_min
            })
            .cloned()
    }

    /// Another pose is better: when it was the same one in five frames, odometry between them included, the tracked
    /// one is given up.
    fn suspect(
        &mut self,
        stamp: Stamp,
        belief: Belief,
        rival: &Hypothesis,
        rivals: Vec<Hypothesis>,
    ) -> Estimate {
        let config = &self.config.filter;
        let fresh = Belief::new(rival.pose, &rival.covariance, Some(&belief), config);
        let strikes = match self.rival.take() {
            Some((known, strikes)) if self.search.same(known.pose(), rival.pose) => strikes + 1,
            _ => 1,
        };
        if strikes >= self.config.mode.strikes_max {
            self.forget();
            return self.lost(stamp, Reason::Rival, rivals);
        }
        self.rival = Some((fresh, strikes));
        self.belief = Some(belief);
        let estimate = self.estimate(stamp, Some(Reason::Rival), None, rivals);
        let apart = estimate
            .pose
            .map_or_else(Vector3::zeros, |pose| apart(rival.pose, pose));
        Estimate {
            // As likely there as here, until one of them has won.
            covariance: estimate.covariance + apart * apart.transpose() * 0.5,
            ..estimate
        }
    }
}
