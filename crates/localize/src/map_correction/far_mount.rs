//! Mounts on trial, and when the next search for some is due.

use super::sums::{TermMatrix, TermVector};
use crate::frames::{Pose, RobotFrame, Tf};
use crate::stamp::Stamp;

/// Largest factor of the time between two searches over the first one's: each one that led to nothing doubles it.
const PERIOD_FACTOR_MAX: f64 = 32.0;

/// A mount on trial.
#[derive(Debug, Clone)]
pub(super) struct MountTrial {
    pub(super) coefficients: TermVector,
    pub(super) covariance: TermMatrix,
    /// The pose under it, seen from the tracked one.
    pub(super) offset: Tf<RobotFrame, RobotFrame>,
    /// Tracked pose of the last image.
    pub(super) pose: Pose,
    /// Images that it explained better by the margin, less those that it did not.
    pub(super) lead: f32,
    /// Points of all images of the trial that it explained.
    pub(super) explained: f32,
    pub(super) images: u32,
}

/// When the next search is due.
#[derive(Debug, Clone, Default)]
pub(super) struct SearchSchedule {
    pub(super) last: Option<Stamp>,
    /// Searches in a row that led to nothing.
    pub(super) failures: u32,
}

impl SearchSchedule {
    pub(super) fn is_due(&self, stamp: Stamp, period: f64) -> bool {
        let factor = 2.0_f64
            .powi(self.failures.min(30) as i32)
            .min(PERIOD_FACTOR_MAX);
        self.last
            .is_none_or(|last| last.seconds_until(stamp) >= factor * period)
    }
}
