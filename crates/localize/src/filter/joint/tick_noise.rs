//! Noise of encoders that count whole ticks (docs/methods.md 8.5).
//!
//! A robot that creeps reports no motion in most samples, and now and then a tick. What is learned of the noise from either is wrong for
//! the other. The size of a tick is not known for every base, but samples differ by whole ticks: by one at least.

use super::odometry_correction::BASE_RADIUS;

/// Differences below are of rounding, metres.
const DIFFERENCE_MIN: f32 = 1e-5;

/// The smallest difference between successive samples so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TickNoise {
    previous: Option<[f32; 3]>,
    /// Metres, with the rotation at the wheels. None before a difference was seen.
    tick: Option<f32>,
}

impl TickNoise {
    /// Takes the motion (x, y, θ) of a sample.
    pub(super) fn add_sample(&mut self, motion: [f32; 3]) {
        let Some(previous) = self.previous.replace(motion) else {
            return;
        };
        let [x, y, theta] = [0, 1, 2].map(|k| motion[k] - previous[k]);
        let difference = (x * x + y * y + (BASE_RADIUS * theta).powi(2)).sqrt();
        if difference > DIFFERENCE_MIN {
            self.tick = Some(self.tick.map_or(difference, |tick| tick.min(difference)));
        }
    }

    /// Variances of a sample along x, y, θ: it begins and ends within a tick, each with that of a uniform distribution.
    pub(super) fn variances(&self) -> [f32; 3] {
        let tick = self.tick.unwrap_or(0.0);
        let variance = tick * tick / 6.0;
        let of_rotation = variance / (BASE_RADIUS * BASE_RADIUS);
        [variance, variance, of_rotation]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn std_after(motions: impl Iterator<Item = [f32; 3]>) -> f32 {
        let mut noise = TickNoise::default();
        motions.for_each(|motion| noise.add_sample(motion));
        noise.variances()[0].sqrt()
    }

    #[test]
    fn ticks_have_the_noise_of_rounding() {
        let tick = 0.001;
        let ticks_at = |step: u32| (step as f32 * 0.21 + 0.4).floor();
        let creeping = (0..50).map(|step| [(ticks_at(step + 1) - ticks_at(step)) * tick, 0.0, 0.0]);
        let std = std_after(creeping);
        assert!((std - tick / 6.0_f32.sqrt()).abs() < 1e-6, "{std}");
    }

    #[test]
    fn a_steady_motion_is_no_tick() {
        let steady = (0..50).map(|step| [0.1 + 2e-5 * (step % 2) as f32, 0.0, 0.0]);
        assert!(std_after(steady) < 1e-5);
    }
}
