//! What is said about a frame: the belief, or that there is none.

use super::Localizer;
use crate::estimate::{Estimate, Mode, Reason};
use crate::filter::PoseFilter;
use crate::global_search::branch_and_bound::Hypothesis;
use crate::matching::Match;
use crate::stamp::Stamp;

impl Localizer {
    pub(super) fn half_known(&self) -> bool {
        !self.search.is_half_turn_symmetric()
            || self.half_evidence.log_odds() >= self.config.compass.half_known_log_odds
    }

    /// The half turn of the belief, which explains the points as well.
    fn half_turn_hypothesis(&self, belief: &PoseFilter, matched: Option<&Match>) -> Hypothesis {
        let other = belief.half_turned();
        // The compass's log odds; none heard is as likely as not.
        let probability = 1.0 / (1.0 + self.half_evidence.log_odds().exp());
        Hypothesis {
            pose: other.pose(),
            covariance: other.covariance(),
            score: matched.map_or(0.0, |matched| matched.score),
            inlier_share: matched.map_or(0.0, |matched| matched.inlier_share),
            residual: matched.map_or(0.0, |matched| matched.residual),
            tilt: matched.map_or([0.0; 2], |matched| matched.tilt),
            probability,
        }
    }

    /// What the belief says, with what the frame's points made of it.
    pub(super) fn estimate(
        &self,
        stamp: Stamp,
        reason: Option<Reason>,
        matched: Option<&Match>,
        rivals: Vec<Hypothesis>,
    ) -> Estimate {
        let Some(belief) = &self.filter else {
            return self.lost_estimate(
                stamp,
                reason.unwrap_or(Reason::DeadReckoningTimeout),
                rivals,
            );
        };
        let half_known = self.half_known();
        let mut runners_up = rivals;
        if !half_known {
            runners_up.insert(0, self.half_turn_hypothesis(belief, matched));
        }
        Estimate {
            stamp,
            pose: Some(belief.pose()),
            covariance: belief.covariance(),
            mode: if half_known {
                Mode::Tracking
            } else {
                Mode::Global
            },
            reason: reason.or((!half_known).then_some(Reason::Ambiguous)),
            residual: matched.map_or(0.0, |matched| matched.residual),
            inlier_share: matched.map_or(0.0, |matched| matched.inlier_share),
            line_points: 0,
            tilt: matched.map_or([0.0; 2], |matched| matched.tilt),
            half_known,
            odometry_scales: belief.scales(),
            twist: Some(belief.twist()),
            collision: belief.in_collision(),
            gyro_bias: belief.gyro_bias(),
            latency: belief.latency(),
            runners_up,
        }
    }

    pub(super) fn lost_estimate(
        &self,
        stamp: Stamp,
        reason: Reason,
        runners_up: Vec<Hypothesis>,
    ) -> Estimate {
        Estimate {
            stamp,
            pose: None,
            covariance: self.uniform_covariance,
            mode: Mode::Lost,
            reason: Some(reason),
            residual: 0.0,
            inlier_share: runners_up.first().map_or(0.0, |best| best.inlier_share),
            line_points: 0,
            tilt: [0.0; 2],
            half_known: false,
            odometry_scales: [1.0, 1.0],
            twist: None,
            collision: false,
            gyro_bias: 0.0,
            latency: 0.0,
            runners_up,
        }
    }
}
