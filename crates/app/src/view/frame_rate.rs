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
    /// Processor time of the process at the start of the first frame that counts, and of the last one.
    process_cpu: Option<(Duration, Duration)>,
    /// Frames whose processor time counts.
    cpu_frames: u32,
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

    /// Records the processor times that this thread and the process have used so far: a busy machine does not change
    /// them. The first second does not count.
    pub(crate) fn record_cpu(&mut self, thread: Duration, process: Duration) {
        let last = self.last_cpu.replace(thread);
        if let Some(last) = last.filter(|_| self.totals().1 > RATE_WINDOW.as_secs_f64()) {
            let used = thread.saturating_sub(last);
            self.longest_cpu = self.longest_cpu.max(used);
            self.total_cpu += used;
            let (first, _) = *self.process_cpu.get_or_insert((process, process));
            self.process_cpu = Some((first, process));
            self.cpu_frames += 1;
        }
    }

    /// Mean and longest processor time of this thread for one frame.
    pub(crate) fn frame_cpu(&self) -> (Duration, Duration) {
        (self.total_cpu / self.cpu_frames.max(1), self.longest_cpu)
    }

    /// Mean processor time of all threads for one frame.
    pub(crate) fn process_cpu(&self) -> Duration {
        let used = self.process_cpu.map(|(first, last)| last - first);
        // The first counted frame begins the measurement.
        used.unwrap_or_default() / self.cpu_frames.saturating_sub(1).max(1)
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
