//! The constant tilt error of the inertial unit (docs/methods.md 7.4).
//!
//! An accelerometer bias of 0.1 m/s² appears as a constant tilt of 0.6°. The unit therefore measures changes of the tilt
//! better than the tilt itself. The constant error is estimated from the tilts that matching finds.

use crate::filter::TiltEstimate;
use crate::sensors::attitude::AttitudeConfig;

/// Random walk of the constant error, degrees per square root of a second.
const TILT_BIAS_DRIFT_DEG: f32 = 0.05;

/// Share by which each image and axis changes the noise variance: a time constant of about a second.
const NOISE_ADAPTATION_RATE: f32 = 0.02;

/// Tilt of one image by the inertial unit.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImuTilt {
    /// (a, b), radians.
    pub(super) measured: [f32; 2],
    /// The tilt by which the points were compensated.
    pub(super) expected: TiltEstimate,
}

/// Estimate of the unit's constant tilt error, radians.
#[derive(Debug, Clone)]
pub(super) struct TiltBias {
    mean: [f32; 2],
    variance: f32,
    /// Learned variance of the remaining error, rad².
    noise_variance: f32,
}

impl TiltBias {
    pub(super) fn new(config: &AttitudeConfig) -> Self {
        TiltBias {
            mean: [0.0; 2],
            variance: config.tilt_bias_std_deg.to_radians().powi(2),
            noise_variance: (3.0 * config.tilt_std_deg).to_radians().powi(2),
        }
    }

    /// Fuses the unit's tilt with the prior of a robot at rest, zero with a standard deviation of `prior_std` radians.
    pub(super) fn correct_tilt(&self, measured: [f32; 2], prior_std: f32) -> TiltEstimate {
        let variance = self.variance + self.noise_variance;
        let prior_variance = prior_std * prior_std;
        let gain = prior_variance / (prior_variance + variance).max(1e-12);
        TiltEstimate {
            mean: std::array::from_fn(|k| gain * (measured[k] - self.mean[k])),
            std: (gain * variance).sqrt(),
        }
    }

    /// Kalman update of the constant error by the tilt that matching `found` beyond the expected one.
    ///
    /// `posterior`: variances of the matched tilt, rad². `seconds`: time since the last image.
    pub(super) fn update(
        &mut self,
        imu_tilt: &ImuTilt,
        found: [f32; 2],
        posterior: [f32; 2],
        seconds: f32,
        config: &AttitudeConfig,
    ) {
        let ImuTilt { measured, expected } = imu_tilt;
        let prior = expected.std * expected.std;
        let drift = TILT_BIAS_DRIFT_DEG.to_radians();
        self.variance += drift * drift * seconds;
        let mut variance = self.variance;
        for k in 0..2 {
            // Removes the prior from the match: x⁺ = P⁺ (P⁻¹ x + R⁻¹ z) solved for z and R.
            let information = 1.0 / posterior[k].max(1e-9) - 1.0 / prior.max(1e-9);
            if information <= 1e-3 / prior.max(1e-9) {
                continue;
            }
            let image_variance = 1.0 / information;
            let image_tilt = expected.mean[k] + found[k] * image_variance / posterior[k].max(1e-9);
            let innovation = measured[k] - image_tilt - self.mean[k];
            let excess = (innovation * innovation - image_variance - self.variance)
                .clamp(0.0, 25.0 * self.noise_variance);
            let noise_min = config.tilt_std_deg.to_radians().powi(2);
            self.noise_variance = (self.noise_variance
                + NOISE_ADAPTATION_RATE * (excess - self.noise_variance))
                .max(noise_min);
            let gain = self.variance / (self.variance + image_variance + self.noise_variance);
            self.mean[k] += gain * innovation;
            variance = variance.min(self.variance * (1.0 - gain));
        }
        self.variance = variance;
    }
}
