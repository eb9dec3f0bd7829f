//! How quickly is the window drawn? Frames over the last second, and over all.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// The rate is counted over this long.
const RATE_WINDOW: Duration = Duration::from_secs(1);

/// Counts frames.
#[derive(Debug, Default)]
pub(crate) struct FrameRateCounter {
    recent: VecDeque<Instant>,
    first: Option<Instant>,
    frames: u64,
}

impl FrameRateCounter {
    /// A frame begins.
    pub(crate) fn record_frame(&mut self, now: Instant) {
        self.first.get_or_insert(now);
        self.frames += 1;
        self.recent.push_back(now);
        while (self.recent.front()).is_some_and(|first| now - *first > RATE_WINDOW) {
            self.recent.pop_front();
        }
    }

    /// Frames over the last second.
    pub(crate) fn frames_per_second(&self) -> f64 {
        self.recent.len() as f64 / RATE_WINDOW.as_secs_f64()
    }

    /// All frames, and the seconds since the first.
    pub(crate) fn totals(&self) -> (u64, f64) {
        let seconds = self.first.map_or(0.0, |first| {
            self.recent
                .back()
                .map_or(0.0, |last| (*last - first).as_secs_f64())
        });
        (self.frames, seconds)
    }
}
