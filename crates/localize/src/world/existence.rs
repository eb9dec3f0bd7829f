//! Does a track's object exist? Detected and missed images of it are weighed as a chain in time (docs/methods.md 11.3).

use super::config::ObjectTrackConfig;
use crate::math;
use crate::stamp::Stamp;

/// Largest probability of existence, so that a vanished object is deleted within some images.
const PROBABILITY_MAX: f32 = 0.99;

/// The odds that an object exists, and what the last image that shows its place said.
#[derive(Debug, Clone, Copy)]
pub(super) struct Existence {
    odds: f32,
    /// Stamp of the last image in which the object's place was in view.
    last_view: Stamp,
    /// Was it detected there?
    was_detected: bool,
}

/// How often a place is detected as an object, and for how long one image's answer remains that of the next ones.
#[derive(Debug, Clone, Copy)]
struct DetectionChain {
    /// Share of the images with a detection, in the long run.
    share: f32,
    /// Time after which the correlation of two images has fallen to 1/e, seconds.
    correlation_time: f32,
}

impl Existence {
    /// Of a new track, whose first detection has `score` (0 to 1).
    pub(super) fn newborn(stamp: Stamp, score: f32, config: &ObjectTrackConfig) -> Self {
        let probability = config.birth_probability * score;
        Existence {
            odds: probability / (1.0 - probability),
            last_view: stamp,
            was_detected: true,
        }
    }

    /// An image shows the place, `range` metres away, and detects the object there with a score.
    pub(super) fn detected(
        &mut self,
        stamp: Stamp,
        range: f32,
        score: f32,
        config: &ObjectTrackConfig,
    ) {
        let [exists, does_not] = self.detection_probabilities(stamp, range, config);
        // The ratio is 1 for a score of 0, and that of a certain detection for a score of 1.
        self.view(stamp, true, 1.0 + score * (exists / does_not - 1.0));
    }

    /// An image shows the place, `range` metres away, and detects nothing there.
    pub(super) fn missed(&mut self, stamp: Stamp, range: f32, config: &ObjectTrackConfig) {
        let [exists, does_not] = self.detection_probabilities(stamp, range, config);
        self.view(stamp, false, (1.0 - exists) / (1.0 - does_not));
    }

    /// 0 to 1.
    pub(super) fn probability(&self) -> f32 {
        self.odds / (1.0 + self.odds)
    }

    fn view(&mut self, stamp: Stamp, is_detected: bool, likelihood_ratio: f32) {
        self.odds = (self.odds * likelihood_ratio).min(PROBABILITY_MAX / (1.0 - PROBABILITY_MAX));
        (self.last_view, self.was_detected) = (stamp, is_detected);
    }

    /// Probabilities of a detection in an image if the object exists, and if it does not.
    fn detection_probabilities(
        &self,
        stamp: Stamp,
        range: f32,
        config: &ObjectTrackConfig,
    ) -> [f32; 2] {
        let seconds = self.last_view.seconds_until(stamp).max(0.0) as f32;
        [
            DetectionChain::of_object(range, config),
            DetectionChain::of_false_alarm(config),
        ]
        .map(|chain| chain.probability(self.was_detected, seconds))
    }
}

impl DetectionChain {
    fn of_object(range: f32, config: &ObjectTrackConfig) -> Self {
        let halved = range / config.half_detection_range;
        DetectionChain {
            // What is farther away than a false alarm would be told from says nothing.
            share: (config.detection_probability / (1.0 + halved * halved))
                .max(config.false_alarm_probability),
            correlation_time: config.detection_correlation_time,
        }
    }

    fn of_false_alarm(config: &ObjectTrackConfig) -> Self {
        DetectionChain {
            share: config.false_alarm_probability,
            correlation_time: config.false_alarm_correlation_time,
        }
    }

    /// Probability of a detection, `seconds` after an image in which there was one or not.
    fn probability(&self, was_detected: bool, seconds: f32) -> f32 {
        let before = if was_detected { 1.0 } else { 0.0 };
        let correlation = math::exp(-seconds / self.correlation_time);
        self.share + (before - self.share) * correlation
    }
}

#[cfg(test)]
mod tests {
    use super::Existence;
    use crate::stamp::Stamp;
    use crate::world::ObjectTrackConfig;

    /// Existence after images at the given seconds, in which the object was detected or not.
    fn after(range: f32, images: &[(f64, bool)]) -> f32 {
        let config = ObjectTrackConfig::default();
        let mut existence = Existence::newborn(Stamp::from_seconds(0.0), 1.0, &config);
        for &(seconds, is_detected) in images {
            let stamp = Stamp::from_seconds(seconds);
            if is_detected {
                existence.detected(stamp, range, 1.0, &config);
            } else {
                existence.missed(stamp, range, &config);
            }
        }
        existence.probability()
    }

    #[test]
    fn images_in_quick_succession_say_less_than_spread_ones() {
        let quick: Vec<_> = (1..=8)
            .map(|image| (0.01 * f64::from(image), true))
            .collect();
        let spread: Vec<_> = (1..=8)
            .map(|image| (0.2 * f64::from(image), true))
            .collect();
        assert!(after(2.0, &quick) < after(2.0, &spread));
    }

    #[test]
    fn a_miss_says_less_the_farther_the_object() {
        let seen = [(0.1, true), (0.2, true), (0.3, true)];
        let missed: Vec<_> = seen.into_iter().chain([(0.4, false)]).collect();
        let drop = |range: f32| after(range, &seen) - after(range, &missed);
        assert!(drop(1.0) > drop(6.0));
        // Beyond the distance at which an object is detected no more often than a false alarm, nothing is learned in the long run.
        let far = [(10.0, true), (20.0, false), (30.0, false)];
        let newborn = ObjectTrackConfig::default().birth_probability;
        assert!((after(50.0, &far) - newborn).abs() < 1e-3);
    }
}
