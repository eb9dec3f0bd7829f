//! Where is the robot, when nothing leads there? The whole field, and the hypotheses that earlier frames left.

use super::Localizer;
use super::half::HalfEvidence;
use crate::candidates::Evidence;
use crate::estimate::{Estimate, Mode, Reason};
use crate::relocalise::Sight;
use crate::sample::LinePoint;
use crate::search::HeadingPrior;
use crate::stamp::Stamp;

impl Localizer {
    /// The heading by a compass reading that is young enough for this frame.
    pub(super) fn heading_prior(&self, stamp: Stamp) -> Option<HeadingPrior> {
        let compass = self.compass?;
        let age = compass.stamp.seconds_until(stamp).abs();
        (age <= self.config.compass.age_max).then(|| HeadingPrior {
            heading: compass.heading,
            std: self.config.compass.std_deg.to_radians(),
        })
    }

    /// Looks for the pose on the whole field, together with the hypotheses that earlier frames left.
    pub(super) fn relocate(&mut self, stamp: Stamp, points: &[LinePoint]) -> Estimate {
        let goals = self.goals_of(stamp);
        let mode = &self.config.mode;
        if points.len() < mode.points_min {
            return self.lost(stamp, Reason::FewPoints, Vec::new());
        }
        let prior = self.heading_prior(stamp);
        let sight = Sight {
            distances: &self.distances,
            points,
            prior,
            goals: &goals,
            alone: self.odometry.is_none(),
        };
        let found = self
            .relocaliser
            .find(&mut self.search, &mut self.matcher, &sight);
        if found.is_empty() && self.relocaliser.active() {
            return self.lost(stamp, Reason::Searching, found);
        }
        let known = self.config.compass.known;
        let tell = |pose| self.coloured.odds(pose, &goals).abs() >= known;
        let told = prior.is_some() || found.iter().any(|one| tell(one.pose));
        let folded = self.search.symmetric() && !told;
        let count = points.len() as f32;
        let fits = found.first().is_some_and(|best| {
            best.inlier_share >= mode.found_share_min
                && best.inlier_share * count >= mode.inliers_min
        });
        if !fits {
            self.candidates.clear();
            self.relocaliser.restart();
            return self.lost(stamp, Reason::NothingFits, found);
        }
        let used = self.config.search.points_max as f32;
        let evidence = Evidence {
            distances: &self.distances,
            points,
            prior,
            goals: (&self.coloured, &goals),
            folded,
            share: self.config.search.evidence_share * (used / count).min(1.0),
        };
        self.candidates.weigh(
            &mut self.matcher,
            &self.search,
            &evidence,
            &found,
            &self.config.filter,
        );
        let Some((belief, best)) = self.candidates.best() else {
            return self.lost(stamp, Reason::NothingFits, found);
        };
        let decided = best.probability >= mode.decided;
        let estimate = Estimate {
            stamp,
            pose: Some(belief.pose()),
            covariance: self.candidates.covariance(),
            mode: Mode::Global,
            reason: (folded || !decided).then_some(Reason::Ambiguous),
            residual: best.residual,
            inlier_share: best.inlier_share,
            line_points: points.len(),
            lean: best.lean,
            half_known: decided && !folded,
            odometry_scales: belief.scales(),
            twist: Some(belief.twist()),
            collision: belief.colliding(),
            gyro_bias: belief.gyro_bias(),
            latency: belief.latency(),
            runners_up: self.candidates.runners_up(folded),
        };
        if decided {
            self.belief = Some(belief.clone());
            self.candidates.clear();
            self.relocaliser.restart();
            let odds = if folded {
                0.0
            } else {
                self.config.compass.known
            };
            self.half = HalfEvidence::with_odds(odds);
            self.usual_share = estimate.inlier_share;
            self.checked = stamp;
            self.rival = None;
        }
        estimate
    }
}
