//! Wheel update of the joint filter: h, H and R of a wheel increment (docs/methods.md 8.5).

use nalgebra::Vector2;

use super::JointFilter;
use super::odometry_correction::entry;
use super::state::{POSE, ROW_STRIDE, SLIP, WHEEL_INCREMENT};
use crate::filter::{FilterConfig, WheelIncrement};
use crate::math;
use crate::sensors::collision::{Measured, WheelMismatch};

/// Share of rolling noise in the wheels' noise. The rest is slip, which has its own state with an inertial unit.
const ROLLING_NOISE_SHARE: f32 = 0.5;
/// Range of the scales. Beyond it encoders are broken, not worn.
const SCALE_RANGE: (f32, f32) = (0.7, 1.4);
/// Largest number of lost wheel samples that one sample may stand for.
const LOST_INTERVALS_MAX: f32 = 20.0;
/// Shortest motion that has a direction, metres, and the smallest turn, radians. Less is rest, or lies between two ticks.
const DIRECTED_MOTION_MIN: f32 = 1e-5;
const TURN_MIN: f32 = 4e-5;

/// Time over which the wheels' velocity is smoothed at which their correction and noise are learned, seconds: a few samples.
const VELOCITY_SMOOTHING_TIME: f32 = 0.05;

/// Nonzero entries of a row of H: increment, slip and correction of two components at most.
type Jacobian = [(usize, f32); 10];

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
            self.add_wheel_step(measured);
            self.update_increment(measured, share * increment.slip, config);
            self.clamp_scales();
        } else {
            self.interrupt_steps();
        }
        self.restart_wheels();
    }

    /// Scalar updates along the motion, across it and in rotation, each with its learned noise.
    ///
    /// `slip`: residual of the wheels' least squares, metres.
    fn update_increment(&mut self, measured: [f32; 3], slip: f32, config: &FilterConfig) {
        let smooth = self.smooth_motion(measured);
        // The direction of a single tick is that of a wheel, not of the robot.
        let along = Vector2::new(smooth[0], smooth[1])
            .try_normalize(DIRECTED_MOTION_MIN)
            .unwrap_or_else(Vector2::x);
        let heading = self.state[POSE + 2] - self.state[WHEEL_INCREMENT + 2];
        let (sin, cos) = math::sin_cos(heading);
        self.wheel_noise.set_direction(Vector2::new(
            cos * along.x - sin * along.y,
            sin * along.x + cos * along.y,
        ));
        let rolling = if self.imu_active {
            ROLLING_NOISE_SHARE * ROLLING_NOISE_SHARE
        } else {
            1.0
        };
        let noise = config.wheel_noise(smooth, self.wheel_interval);
        let variances = self.wheel_noise.variances(&noise);
        let axes = [
            [along.x, along.y, 0.0],
            [-along.y, along.x, 0.0],
            [0.0, 0.0, 1.0],
        ];
        let terms = variances.map(|terms| terms.map(|variance| rolling * variance));
        let slip = rolling * slip * slip;
        let variances = [slip, slip, 0.0];
        let variances = [0, 1, 2].map(|k| terms[k].iter().sum::<f32>() + variances[k]);
        let moves = math::hypot(measured[0], measured[1]) >= DIRECTED_MOTION_MIN;
        let reported = [moves, moves, measured[2].abs() >= TURN_MIN];
        for (direction, axis) in axes.into_iter().enumerate() {
            let (terms, variance) = (terms[direction], variances[direction]);
            let innovation = self.wheel_innovation(measured, axis);
            let (jacobian, count) = self.wheel_jacobian(smooth, axis);
            let total = self.update_scalar(&jacobian[..count], innovation, variance);
            if self.imu_active && reported[direction] {
                // Without an inertial unit the prediction is deliberately vague, and the innovation says nothing. Samples between
                // two ticks would count as certain.
                self.wheel_noise
                    .update_by_wheels(direction, terms, innovation, total);
            }
            // The posterior's variance P R/(P + R) grows with R by (P/(P + R))².
            let share = ((total - variance) / total.max(f32::MIN_POSITIVE)).powi(2);
            self.wheel_noise.add_variances(direction, terms, share);
        }
    }

    /// Takes a sample into the smoothed velocity. Returns the motion at the mean of that before and after.
    ///
    /// The smoothed velocity before lags behind the sample's error, the one after leads: both would correlate with the innovation, their
    /// mean does not.
    fn smooth_motion(&mut self, measured: [f32; 3]) -> [f32; 3] {
        let interval = self.wheel_interval;
        let share = 1.0 - math::exp(-interval / VELOCITY_SMOOTHING_TIME);
        let before = self.smoothed_velocity;
        for (velocity, motion) in self.smoothed_velocity.iter_mut().zip(measured) {
            *velocity += share * (motion / interval - *velocity);
        }
        [0, 1, 2].map(|k| 0.5 * interval * (before[k] + self.smoothed_velocity[k]))
    }

    /// Innovation 0 − h(x) along `axis`, with h = Δ + T s − C m: increment, slip and corrected measurement.
    fn wheel_innovation(&self, measured: [f32; 3], axis: [f32; 3]) -> f32 {
        let innovation = |i: usize| {
            let corrected: f32 = (0..3).map(|j| self.state[entry(i, j)] * measured[j]).sum();
            corrected - self.state[WHEEL_INCREMENT + i] - self.wheel_interval * self.state[SLIP + i]
        };
        (0..3)
            .filter(|&i| axis[i] != 0.0)
            .map(|i| axis[i] * innovation(i))
            .sum()
    }

    /// Variance of the predicted wheel motion Δ + T s along `axis`.
    fn predicted_variance(&self, axis: [f32; 3]) -> f32 {
        let (p, dt) = (&self.covariance, self.wheel_interval);
        let of_pair = |i: usize, j: usize| {
            let (increments, slips) = (
                [WHEEL_INCREMENT + i, WHEEL_INCREMENT + j],
                [SLIP + i, SLIP + j],
            );
            p[increments[0]][increments[1]]
                + dt * (p[increments[0]][slips[1]] + p[slips[0]][increments[1]])
                + dt * dt * p[slips[0]][slips[1]]
        };
        let pairs = (0..3).flat_map(|i| (0..3).map(move |j| [i, j]));
        pairs
            .map(|[i, j]| axis[i] * axis[j] * of_pair(i, j))
            .sum::<f32>()
            .max(0.0)
    }

    /// Row of H along `axis`, the derivative of h at a motion, and the number of its entries.
    fn wheel_jacobian(&self, motion: [f32; 3], axis: [f32; 3]) -> (Jacobian, usize) {
        let mut row = Jacobian::default();
        let mut count = 0;
        for (i, factor) in axis.into_iter().enumerate().filter(|(_, a)| *a != 0.0) {
            row[count] = (WHEEL_INCREMENT + i, factor);
            row[count + 1] = (SLIP + i, factor * self.wheel_interval);
            for j in 0..3 {
                row[count + 2 + j] = (entry(i, j), -factor * motion[j]);
            }
            count += 5;
        }
        (row, count)
    }

    /// Velocity of the wheels against the predicted one, for the collision detector.
    fn wheel_mismatch(&self, measured: [f32; 3]) -> WheelMismatch {
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let innovation = axes.map(|axis| self.wheel_innovation(measured, axis));
        let per_second = 1.0 / self.wheel_interval;
        let variance = |k: usize| self.predicted_variance(axes[k]);
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
        for k in 0..3 {
            let scale = &mut self.state[entry(k, k)];
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
        if let Some(errors) = &mut self.mate_errors {
            errors.restart_wheels();
        }
        if let Some(clone) = &mut self.image_clone {
            clone.restart_wheels();
        }
    }
}
