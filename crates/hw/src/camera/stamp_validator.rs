//! Is an image's stamp plausible? A camera's clock may step or have another zero; odometry must still match its images.

use localize::Stamp;

/// Longest usual time from exposure to arrival, seconds: a camera of 10 Hz that is read out during the next exposure.
const DELAY_MAX: f64 = 0.15;
/// Longest time of an image that a busy computer delivers late, seconds. Its stamp follows those of images that came in time, which that
/// of a clock which was set back does not.
const LATE_MAX: f64 = 1.0;
/// Gain per image with which the usual delay follows longer delays.
const DELAY_INCREASE_GAIN: f64 = 0.01;

/// An image's stamp after validation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ValidatedStamp {
    pub(super) stamp: Stamp,
    /// True for the camera's stamp, false for the arrival less the usual delay.
    pub(super) from_camera: bool,
}

/// Validates the stamps of one camera.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StampValidator {
    last: Option<Stamp>,
    /// Smallest recent time from exposure to arrival, seconds.
    min_delay: f64,
}

impl StampValidator {
    /// Keeps a plausible stamp; replaces another by the arrival less the usual delay.
    pub(super) fn validate(&mut self, stamp: Stamp, arrival: Stamp) -> ValidatedStamp {
        let delay = arrival - stamp;
        let later = self.last.is_none_or(|last| stamp > last);
        let follows = self.last.is_some() && self.min_delay <= DELAY_MAX;
        let delay_max = if follows { LATE_MAX } else { DELAY_MAX };
        let from_camera = later && (0.0..=delay_max).contains(&delay);
        let stamp = if from_camera {
            let shorter = self.last.is_none() || delay < self.min_delay;
            let gain = if shorter { 1.0 } else { DELAY_INCREASE_GAIN };
            self.min_delay += gain * (delay - self.min_delay);
            stamp
        } else {
            // Stamps must increase, whatever the usual delay.
            let estimated = arrival + -self.min_delay;
            self.last
                .map_or(estimated, |last| estimated.max(last + 1e-6))
        };
        self.last = Some(stamp);
        ValidatedStamp { stamp, from_camera }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn implausible_camera_stamps_are_replaced_by_arrival_time() {
        let mut validator = StampValidator::default();
        let mut from_camera = 0;
        for index in 0..200i64 {
            let exposure = index * 33_000_000;
            let arrival = Stamp(exposure + 12_000_000 + (index % 3) * 1_000_000);
            let shift = match index {
                0..50 => 0,
                50..100 => 40_000_000_000,
                100..150 => -300_000_000,
                _ => 0,
            };
            let validated = validator.validate(Stamp(exposure + shift), arrival);
            let error = (validated.stamp - Stamp(exposure)).abs();
            assert!(error < 0.004, "{index}: {validated:?}");
            assert_eq!(validated.from_camera, shift == 0 || index == 0, "{index}");
            from_camera += usize::from(validated.from_camera);
        }
        assert_eq!(from_camera, 100);
    }

    #[test]
    fn images_that_are_delivered_late_keep_their_stamps_unless_all_are() {
        let mut validator = StampValidator::default();
        let late = |index: i64| match index {
            // A busy computer delivers eight images almost at once, and from the 100th on a clock is slow for good.
            30..38 => 30_000_000 + (38 - index) * 32_000_000,
            100.. => 400_000_000,
            _ => 12_000_000,
        };
        let from_camera = (0..500i64).map(|index| {
            let exposure = Stamp(index * 33_000_000);
            let arrival = Stamp(exposure.0 + late(index));
            validator.validate(exposure, arrival).from_camera
        });
        let from_camera: Vec<bool> = from_camera.collect();
        assert!(from_camera[..100].iter().all(|kept| *kept));
        assert!(from_camera[200..].iter().all(|kept| !*kept));
    }
}
