//! The odd moments of the run: a log's come from its reader, those of a live run are sought as it goes.

use pipeline::Cycle;
use pipeline::findings::{Finding, FindingKind, RunHistory};

/// A live run is searched this far back, seconds: usual values are those of this time.
const LIVE_WINDOW: f64 = 600.0;
/// A live run is searched again after this many cycles.
const SEARCH_INTERVAL: u64 = 30;
/// A seek to a moment ends this much behind its stamp, seconds: stamps since the epoch are rounded by less.
pub(crate) const STAMP_ROUNDING: f64 = 1e-6;

/// The findings so far, in order of time.
#[derive(Debug, Default)]
pub(crate) struct RunFindings {
    found: Vec<Finding>,
    /// True once the whole log is read.
    pub(crate) complete: bool,
    history: RunHistory,
    received: u64,
    number: u64,
}

impl RunFindings {
    /// All findings.
    pub(crate) fn all(&self) -> &[Finding] {
        &self.found
    }

    /// Takes those of a log.
    pub(crate) fn set(&mut self, found: Vec<Finding>) {
        self.found = found;
    }

    /// Adds a cycle of a live run, before which the view dropped `dropped` cycles.
    pub(crate) fn push_live(&mut self, cycle: &Cycle, dropped: u64) {
        let before = self.history.len();
        self.number += 1 + dropped;
        self.history.push(self.number, cycle);
        if self.history.len() < before {
            self.found.clear();
        }
        self.received += 1;
        if self.received.is_multiple_of(SEARCH_INTERVAL) {
            self.search();
        }
    }

    fn search(&mut self) {
        let Some((_, end)) = self.history.span() else {
            return;
        };
        self.history.forget_before(end - LIVE_WINDOW);
        let start = self.history.span().map_or(end, |(start, _)| start);
        self.found.retain(|finding| finding.start < start);
        let fresh = self.history.findings().into_iter();
        // Numbers that are missing here were dropped by the view, not by the robot.
        self.found
            .extend(fresh.filter(|finding| finding.kind != FindingKind::Dropped));
    }

    /// The worst stamp of the next finding after a time (`ahead`) or of the last one before it, as a time to seek to, seconds.
    pub(crate) fn next(&self, time: f64, ahead: bool) -> Option<f64> {
        let times = self
            .found
            .iter()
            .map(|finding| finding.worst + STAMP_ROUNDING);
        if ahead {
            times
                .filter(|at| *at > time + STAMP_ROUNDING)
                .min_by(f64::total_cmp)
        } else {
            times
                .filter(|at| *at < time - STAMP_ROUNDING)
                .max_by(f64::total_cmp)
        }
    }
}
