//! Wheel update of the joint filter: h, H and R of a wheel increment (docs/methods.md 8.5).

use super::JointFilter;
use super::state::{ODOMETRY_SCALES, ROW_STRIDE, SLIP, WHEEL_INCREMENT};
use crate::filter::config::WheelNoise;
use crate::filter::{FilterConfig, WheelIncrement};
use crate::math;
use crate::sensors::collision::{Measured, WheelMismatch};

/// Share of rolling noise in the wheels' noise. The rest is slip, which has its own state with an inertial unit.
const ROLLING_NOISE_SHARE: f32 = 0.5;
/// Odometry scales outside this range indicate broken encoders, not wear.
const SCALE_RANGE: (f32, f32) = (0.7, 1.4);
/// Largest number of lost wheel samples that one sample may stand for.
const LOST_INTERVALS_MAX: f32 = 20.0;

impl JointFilter {
    /// Updates by the motion since the last wheel sample, then starts a new increment.
    ///
    /// During a collision the sample is skipped (docs/methods.md 10).
    pub(in crate::filter) fn update_wheels(
        &mut self,
        increment: &WheelIncrement,
        config: &FilterConfig,
    ) {
        if !(self.wheel_interval > 0.0) {
            self.restart_wheels();
            return;
        }
        // The sample's interval differs from the state's after a restart within it, or if samples were lost.
        let share = if increment.dt > 0.0 {
            (self.wheel_interval / increment.dt).min(LOST_INTERVALS_MAX)
        } else {
            1.0
        };
        let measured = increment.motion.map(|value| share * value);
        let mismatch = self.wheel_mismatch(measured);
        if !increment.imu_active || self.collision.accepts_wheels(&mismatch, &config.collision) {
            let variances = self.wheel_noise(measured, share * increment.slip, config);
            for (k, variance) in variances.into_iter().enumerate() {
                let innovation = self.wheel_innovation(measured)[k];
                let jacobian = self.wheel_jacobian(measured, k);
                self.update_scalar(&jacobian, innovation, variance);
            }
            self.clamp_scales();
        }
        self.restart_wheels();
    }

    /// Innovation 0 − h(x) with h = Δ + T s − k m: increment, slip and scaled measurement.
    fn wheel_innovation(&self, measured: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| {
            self.state[ODOMETRY_SCALES + k / 2] * measured[k]
                - self.state[WHEEL_INCREMENT + k]
                - self.wheel_interval * self.state[SLIP + k]
        })
    }

    /// Row `k` of H, the derivative of h.
    fn wheel_jacobian(&self, measured: [f32; 3], k: usize) -> [(usize, f32); 3] {
        [
            (WHEEL_INCREMENT + k, 1.0),
            (SLIP + k, self.wheel_interval),
            (ODOMETRY_SCALES + k / 2, -measured[k]),
        ]
    }

    /// Diagonal of R. `slip`: residual of the wheels' least squares, metres.
    fn wheel_noise(&self, measured: [f32; 3], slip: f32, config: &FilterConfig) -> [f32; 3] {
        let WheelNoise { position, heading } = config.wheel_noise(measured, self.wheel_interval);
        let position = position + slip * slip;
        let share = if self.imu_active {
            ROLLING_NOISE_SHARE
        } else {
            1.0
        };
        let factor = self.wheel_noise_factor * share * share;
        [position, position, heading].map(|variance| variance * factor)
    }

    /// Velocity of the wheels against the predicted one, for the collision detector.
    fn wheel_mismatch(&self, measured: [f32; 3]) -> WheelMismatch {
        let innovation = self.wheel_innovation(measured);
        let per_second = 1.0 / self.wheel_interval;
        let variance = |k: usize| {
            let p = &self.covariance;
            let (increment, slip, dt) = (WHEEL_INCREMENT + k, SLIP + k, self.wheel_interval);
            p[increment][increment] + dt * (2.0 * p[increment][slip] + dt * p[slip][slip])
        };
        let std = |variance: f32| variance.max(0.0).sqrt() * per_second;
        WheelMismatch {
            speed: Measured {
                value: math::hypot(innovation[0], innovation[1]) * per_second,
                std: std(variance(0) + variance(1)),
            },
            yaw_rate: Measured {
                value: innovation[2].abs() * per_second,
                std: std(variance(2)),
            },
        }
    }

    pub(super) fn clamp_scales(&mut self) {
        for scale in &mut self.state[ODOMETRY_SCALES..ODOMETRY_SCALES + 2] {
            *scale = scale.clamp(SCALE_RANGE.0, SCALE_RANGE.1);
        }
    }

    /// Starts a new increment: zero, without uncertainty.
    pub(in crate::filter) fn restart_wheels(&mut self) {
        self.wheel_interval = 0.0;
        for k in WHEEL_INCREMENT..WHEEL_INCREMENT + 3 {
            self.state[k] = 0.0;
            self.covariance[k] = [0.0; ROW_STRIDE];
            for line in &mut self.covariance {
                line[k] = 0.0;
            }
        }
    }
}
