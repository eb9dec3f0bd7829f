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
    /// Longest time for one frame, seconds.
    longest: f32,
    /// Processor time of this thread at the start of the last frame.
    last_cpu: Option<Duration>,
    /// Longest processor time of this thread for one frame, and the sum over all.
    longest_cpu: Duration,
    total_cpu: Duration,
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

    /// Records how long a frame took, drawing included, seconds. The first second does not count.
    pub(crate) fn record_duration(&mut self, seconds: f32) {
        if self.totals().1 > RATE_WINDOW.as_secs_f64() {
            self.longest = self.longest.max(seconds);
        }
    }

    /// Records the processor time that this thread has used so far: a busy machine does not change it.
    pub(crate) fn record_cpu(&mut self, now: Duration) {
        let last = self.last_cpu.replace(now);
        if let Some(last) = last.filter(|_| self.totals().1 > RATE_WINDOW.as_secs_f64()) {
            let used = now.saturating_sub(last);
            self.longest_cpu = self.longest_cpu.max(used);
            self.total_cpu += used;
        }
    }

    /// Mean and longest processor time of this thread for one frame.
    pub(crate) fn frame_cpu(&self) -> (Duration, Duration) {
        let frames = u32::try_from(self.frames).unwrap_or(u32::MAX).max(1);
        (self.total_cpu / frames, self.longest_cpu)
    }

    /// Longest time for one frame, seconds.
    pub(crate) fn longest(&self) -> f32 {
        self.longest
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
