//! Check of a trusted pose against the whole field: a part of the search in each image (docs/methods.md 9.4).
//!
//! The search compares the points of one image. If another pose explains them clearly better, the current image is
//! searched at once, so a check only ever raises a suspicion.

use super::Localizer;
use super::state::{GlobalCheck, PoseTrack};
use crate::frames::Pose;
use crate::global_search::branch_and_bound::Hypothesis;
use crate::matching::Match;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// Checks one after the other at the start of a track: the rivals of its first images may not have been among the hypotheses.
const FIRST_CHECKS: u32 = 4;

/// Result of a check.
pub(super) struct GlobalCheckResult {
    /// Another pose explained the points of the checked image clearly better.
    pub(super) is_contradicted: bool,
    /// The other poses that explain the points, moved to the current image.
    pub(super) alternatives: Vec<Hypothesis>,
}

impl Localizer {
    /// Starts a check if one is due, or continues it. Returns its result once it is complete.
    pub(super) fn check_gradually(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
        track: &mut PoseTrack,
    ) -> Option<GlobalCheckResult> {
        let Some(check) = &mut self.global_check else {
            let period = self.config.mode.global_check_period;
            let is_new = track.passed_checks < FIRST_CHECKS;
            let elapsed = track.last_global_check.seconds_until(stamp);
            let is_due = period > 0.0 && (is_new || elapsed >= period);
            if is_due {
                track.last_global_check = stamp;
                let prior = self.heading_prior(stamp);
                self.global_check = Some(GlobalCheck {
                    search: self.search.start_gradually(points, prior),
                    matched: matched.clone(),
                    count: points.len(),
                    fold_half_turn: prior.is_none() && self.search.is_half_turn_symmetric(),
                });
            }
            return None;
        };
        let mut found = self.search.continue_gradually(
            &mut check.search,
            &self.distance_field,
            &mut self.matcher,
        )?;
        let check = self.global_check.take()?;
        self.retain_alternatives(&mut found, check.matched.pose, check.fold_half_turn);
        let is_contradicted = self
            .better_alternative(&found, &check.matched, check.count)
            .is_some();
        if !is_contradicted {
            track.passed_checks = track.passed_checks.saturating_add(1);
        }
        let since = check.matched.pose.inverse() * matched.pose;
        for hypothesis in &mut found {
            let Pose { x, y, theta, .. } = hypothesis.pose * since;
            hypothesis.pose = Pose::new(x, y, theta);
        }
        Some(GlobalCheckResult {
            is_contradicted,
            alternatives: found,
        })
    }
}
