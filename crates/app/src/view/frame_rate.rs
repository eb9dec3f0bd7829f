//! Frame rate of the window: over the last second, and over the whole session.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Averaging window of the rate.
const RATE_WINDOW: Duration = Duration::from_secs(1);

/// Counts drawn frames.
#[derive(Debug, Default)]
pub(crate) struct FrameRateCounter {
    recent: VecDeque<Instant>,
    first: Option<Instant>,
    frames: u64,
}

impl FrameRateCounter {
    /// Records the start of a frame.
    pub(crate) fn record_frame(&mut self, now: Instant) {
        self.first.get_or_insert(now);
        self.frames += 1;
        self.recent.push_back(now);
        while (self.recent.front()).is_some_and(|first| now - *first > RATE_WINDOW) {
            self.recent.pop_front();
        }
    }

    /// Frames per second over the last second.
    pub(crate) fn frames_per_second(&self) -> f64 {
        self.recent.len() as f64 / RATE_WINDOW.as_secs_f64()
    }

    /// Number of all frames, and seconds from the first to the last.
    pub(crate) fn totals(&self) -> (u64, f64) {
        let seconds = self.first.map_or(0.0, |first| {
            self.recent
                .back()
                .map_or(0.0, |last| (*last - first).as_secs_f64())
        });
        (self.frames, seconds)
    }
}
