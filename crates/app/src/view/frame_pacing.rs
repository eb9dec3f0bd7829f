//! When is the next frame drawn while something plays? At a steady rate, whatever a frame takes.

use std::time::{Duration, Instant};

/// Time between frames while something plays: 60 frames per second.
pub(super) const FRAME_INTERVAL: Duration = Duration::from_micros(16_667);
/// Least time until the next frame: none at all would ask the window library for two.
const DELAY_MIN: Duration = Duration::from_micros(100);

/// Times of the frames.
#[derive(Debug, Default)]
pub(super) struct FramePacer {
    /// When the next frame is due.
    due: Option<Instant>,
}

impl FramePacer {
    /// Time from `now` to the next frame, after one that began at `start`.
    ///
    /// A timer that wakes late does not slow down the frames after it. A frame that takes longer than its interval is
    /// followed at once, and the lost frames are not made up for.
    pub(super) fn delay(&mut self, start: Instant, now: Instant) -> Duration {
        let due = match self.due {
            // Input has asked for a frame in between.
            Some(due) if start < due => due,
            Some(due) if start - due < FRAME_INTERVAL => due + FRAME_INTERVAL,
            _ => start + FRAME_INTERVAL,
        };
        self.due = Some(due);
        due.saturating_duration_since(now).max(DELAY_MIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of a second if each takes `work` and each timer wakes late by `late`.
    fn frames(work: Duration, late: Duration) -> usize {
        let first = Instant::now();
        let (mut pacer, mut start, mut count) = (FramePacer::default(), first, 0);
        while start - first < Duration::from_secs(1) {
            count += 1;
            // The delay is asked for in the middle of the work.
            let asked = start + work / 2;
            let wake = asked + pacer.delay(start, asked) + late;
            start = wake.max(start + work);
        }
        count
    }

    #[test]
    fn rate_does_not_depend_on_the_time_of_a_frame() {
        for work in [0, 5, 12] {
            for late in [0, 1, 3] {
                let (work, late) = (Duration::from_millis(work), Duration::from_millis(late));
                let count = frames(work, late);
                assert!((59..=61).contains(&count), "{count}: {work:?}, {late:?}");
            }
        }
    }

    #[test]
    fn slow_frames_follow_one_another_at_once() {
        let count = frames(Duration::from_millis(40), Duration::ZERO);
        assert_eq!(count, 25);
    }

    #[test]
    fn frames_between_do_not_raise_the_rate() {
        let start = Instant::now();
        let mut pacer = FramePacer::default();
        let due = start + pacer.delay(start, start);
        let between = start + Duration::from_millis(4);
        assert_eq!(between + pacer.delay(between, between), due);
    }
}
