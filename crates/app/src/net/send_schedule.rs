//! At which images is a message sent, so that there are as many per second as configured?

/// Share of the newest interval in the estimated time between images.
const INTERVAL_GAIN: f64 = 0.2;

/// Sends at the image that is nearest to each due time. These are a period apart, whenever the images come.
#[derive(Debug)]
pub(super) struct SendSchedule {
    /// Seconds.
    period: f64,
    /// Time of the next message; None before the first image.
    due: Option<f64>,
    last_image: f64,
    /// Estimated time between images, seconds.
    interval: f64,
}

impl SendSchedule {
    /// `rate`: messages per second.
    pub(super) fn new(rate: f64) -> Self {
        SendSchedule {
            period: 1.0 / rate,
            due: None,
            last_image: 0.0,
            interval: 0.0,
        }
    }

    /// True if a message is sent with the image that is there at `now`, seconds.
    pub(super) fn is_due(&mut self, now: f64) -> bool {
        let Some(due) = self.due else {
            (self.due, self.last_image) = (Some(now + self.period), now);
            return true;
        };
        // A pause is no interval between images.
        let interval = (now - self.last_image).clamp(0.0, self.period);
        self.last_image = now;
        self.interval = if self.interval == 0.0 {
            interval
        } else {
            self.interval + INTERVAL_GAIN * (interval - self.interval)
        };
        // The next image would be later than this one is early.
        if now + 0.5 * self.interval < due {
            return false;
        }
        // What could not be sent in time, because there were no images, is not made up for.
        self.due = Some((due + self.period).max(now));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Messages per second with `images` per second, each late by up to `jitter`, seconds.
    fn measured(rate: f64, images: f64, jitter: f64) -> f64 {
        let mut schedule = SendSchedule::new(rate);
        let seconds = 200.0;
        let sent = (0..(seconds * images) as u32).filter(|k| {
            // Pseudo-random, uniform.
            let late = f64::from(k.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24);
            schedule.is_due(f64::from(*k) / images + jitter * late)
        });
        sent.count() as f64 / seconds
    }

    #[test]
    fn mean_rate_is_kept_and_bounded_by_the_images() {
        for (rate, images, expected) in [
            (30.0, 30.0, 30.0),
            (15.0, 30.0, 15.0),
            (15.0, 15.0, 15.0),
            (20.0, 30.0, 20.0),
            (10.0, 30.0, 10.0),
            (15.0, 20.0, 15.0),
            (7.0, 50.0, 7.0),
            (15.0, 10.0, 10.0),
            (1000.0, 30.0, 30.0),
            (5.0, 10.0, 5.0),
        ] {
            for jitter in [0.0, 0.002, 0.01] {
                let rate_sent = measured(rate, images, jitter);
                assert!(
                    (rate_sent - expected).abs() < 0.02 * expected,
                    "rate {rate}, images {images}, jitter {jitter}: {rate_sent}"
                );
            }
        }
    }

    #[test]
    fn pause_of_the_images_is_not_made_up_for() {
        let mut schedule = SendSchedule::new(15.0);
        assert!(schedule.is_due(0.0));
        assert!(schedule.is_due(100.0));
        let after = (1..=30).filter(|k| schedule.is_due(100.0 + f64::from(*k) / 30.0));
        assert!(after.count() <= 16);
    }
}
