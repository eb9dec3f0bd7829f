//! Where is the robot, when nothing leads there? The whole field, and the hypotheses that earlier frames left.

use super::Localizer;
use super::field_half::HalfEvidence;
use crate::estimate::{Estimate, Mode, Reason};
use crate::global_search::SearchInput;
use crate::global_search::branch_and_bound::HeadingPrior;
use crate::localizer::candidates::FrameMeasurements;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

impl Localizer {
    /// The heading by a compass reading that is young enough for this frame.
    pub(super) fn heading_prior(&self, stamp: Stamp) -> Option<HeadingPrior> {
        let compass = self.last_compass?;
        let age = compass.stamp.seconds_until(stamp).abs();
        (age <= self.config.compass.age_max).then(|| HeadingPrior {
            heading: compass.heading,
            std: self.config.compass.std_deg.to_radians(),
        })
    }

    /// Looks for the pose on the whole field, together with the hypotheses that earlier frames left.
    pub(super) fn localize_globally(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let goals = self.take_goals(stamp);
        let mode = &self.config.mode;
        if points.len() < mode.points_min {
            return self.lost_estimate(stamp, Reason::FewPoints, Vec::new());
        }
        let prior = self.heading_prior(stamp);
        let sight = SearchInput {
            distances: &self.distance_field,
            points,
            heading_prior: prior,
            goals: &goals,
            single_image: self.last_odometry.is_none(),
        };
        let found = self
            .global_search
            .find_hypotheses(&mut self.search, &mut self.matcher, &sight);
        if found.is_empty() && self.global_search.is_in_progress() {
            return self.lost_estimate(stamp, Reason::Searching, found);
        }
        let known = self.config.compass.half_known_log_odds;
        let tell = |pose| self.coloured_goals.half_log_odds(pose, &goals).abs() >= known;
        let told = prior.is_some() || found.iter().any(|one| tell(one.pose));
        let folded = self.search.is_half_turn_symmetric() && !told;
        let count = points.len() as f32;
        let fits = found.first().is_some_and(|best| {
            best.inlier_share >= mode.global_inlier_share_min
                && best.inlier_share * count >= mode.inliers_min
        });
        if !fits {
            self.candidates.clear();
            self.global_search.reset();
            return self.lost_estimate(stamp, Reason::NoMatch, found);
        }
        let used = self.config.branch_and_bound.points_max as f32;
        let evidence = FrameMeasurements {
            distances: &self.distance_field,
            points,
            prior,
            goals: (&self.coloured_goals, &goals),
            fold_half_turn: folded,
            likelihood_exponent: self.config.branch_and_bound.likelihood_exponent
                * (used / count).min(1.0),
        };
        self.candidates.update(
            &mut self.matcher,
            &self.search,
            &evidence,
            &found,
            &self.config.filter,
        );
        let Some((belief, best)) = self.candidates.best() else {
            return self.lost_estimate(stamp, Reason::NoMatch, found);
        };
        let decided = best.probability >= mode.decision_probability;
        let estimate = Estimate {
            stamp,
            pose: Some(belief.pose()),
            covariance: self.candidates.covariance(),
            mode: Mode::Global,
            reason: (folded || !decided).then_some(Reason::Ambiguous),
            residual: best.residual,
            inlier_share: best.inlier_share,
            line_points: points.len(),
            tilt: best.tilt,
            half_known: decided && !folded,
            odometry_scales: belief.scales(),
            twist: Some(belief.twist()),
            collision: belief.in_collision(),
            gyro_bias: belief.gyro_bias(),
            latency: belief.latency(),
            runners_up: self.candidates.runners_up(folded),
        };
        if decided {
            self.filter = Some(belief.clone());
            self.candidates.clear();
            self.global_search.reset();
            let odds = if folded {
                0.0
            } else {
                self.config.compass.half_known_log_odds
            };
            self.half_evidence = HalfEvidence::with_log_odds(odds);
            self.mean_inlier_share = estimate.inlier_share;
            self.last_global_check = stamp;
            self.alternative = None;
        }
        estimate
    }
}
