//! Can a frame's stamp be true? A camera's clock may be set, or run from another zero; odometry must still fit its frames.

use localize::Stamp;

/// Longest time from exposure to arrival, seconds: a camera of 10 Hz that is read out while it exposes the next frame.
const DELAY_MAX: f64 = 0.15;
/// How fast the usual delay follows when frames come later than it, per frame.
const DELAY_INCREASE_GAIN: f64 = 0.01;

/// The stamps of one camera.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StampValidator {
    last: Option<Stamp>,
    /// Least time from exposure to arrival of late, seconds.
    min_delay: f64,
}

impl StampValidator {
    /// The stamp to go by, and whether it is the camera's own; else it is the arrival less the usual delay.
    pub(super) fn validate(&mut self, stamp: Stamp, arrival: Stamp) -> (Stamp, bool) {
        let delay = arrival - stamp;
        let later = self.last.is_none_or(|last| stamp > last);
        let own = later && (0.0..=DELAY_MAX).contains(&delay);
        let judged = if own {
            let first = self.last.is_none() || delay < self.min_delay;
            let share = if first { 1.0 } else { DELAY_INCREASE_GAIN };
            self.min_delay += share * (delay - self.min_delay);
            stamp
        } else {
            // Not before the last one, whatever the usual delay.
            let judged = arrival + -self.min_delay;
            self.last.map_or(judged, |last| judged.max(last + 1e-6))
        };
        self.last = Some(judged);
        (judged, own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn implausible_camera_stamps_are_replaced_by_arrival_time() {
        let mut stamps = StampValidator::default();
        let mut owned = 0;
        for index in 0..200i64 {
            let taken = index * 33_000_000;
            let arrival = Stamp(taken + 12_000_000 + (index % 3) * 1_000_000);
            let shift = match index {
                0..50 => 0,
                50..100 => 40_000_000_000,
                100..150 => -300_000_000,
                _ => 0,
            };
            let (judged, own) = stamps.validate(Stamp(taken + shift), arrival);
            assert!((judged - Stamp(taken)).abs() < 0.004, "{index}: {judged:?}");
            assert_eq!(own, shift == 0 || index == 0, "{index}");
            owned += usize::from(own);
        }
        assert_eq!(owned, 100);
    }
}
