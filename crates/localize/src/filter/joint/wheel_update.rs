//! What do wheels say of the way, and when are they not believed?

use super::{
    JointFilter, LOST_INTERVALS_MAX, ODOMETRY_SCALES, ROW_STRIDE, SCALE_RANGE, SLIP,
    STATIONARY_NOISE, TWIST, WHEEL_INCREMENT,
};
use crate::filter::{FilterConfig, WheelIncrement};
use crate::sensors::collision::WheelMismatch;

/// What rolling wheels err by of all that wheels err by: the rest is slip, which has a state of its own where an inertial
/// unit tells it.
const ROLLING_NOISE_SHARE: f32 = 0.5;

impl JointFilter {
    pub(in crate::filter) fn update_wheels(&mut self, way: &WheelIncrement, config: &FilterConfig) {
        if !(self.wheel_interval > 0.0) {
            self.restart_wheels();
            return;
        }
        // A belief born within the interval, or a sample that came late, knows another part of it.
        let part = if way.dt > 0.0 {
            (self.wheel_interval / way.dt).min(LOST_INTERVALS_MAX)
        } else {
            1.0
        };
        let [dx, dy, turn] = way.motion.map(|value| part * value);
        let residual = self.wheel_innovation([dx, dy, turn]);
        let per_second = 1.0 / self.wheel_interval;
        let variance = |k: usize| {
            let p = &self.covariance;
            let (way, slip, since) = (WHEEL_INCREMENT + k, SLIP + k, self.wheel_interval);
            p[way][way] + since * (2.0 * p[way][slip] + since * p[slip][slip])
        };
        let std = |variance: f32| variance.max(0.0).sqrt() * per_second;
        let off = WheelMismatch {
            speed: [
                residual[0].hypot(residual[1]) * per_second,
                std(variance(0) + variance(1)),
            ],
            yaw_rate: [residual[2].abs() * per_second, std(variance(2))],
        };
        if !way.imu_active || self.collision.accepts_wheels(&off, &config.collision) {
            let length = dx.hypot(dy);
            let slip = part * way.slip;
            let position =
                config.odometry_noise_per_metre * config.odometry_noise_per_metre * length
                    + config.odometry_drift * config.odometry_drift * self.wheel_interval
                    + slip * slip;
            let heading = config.heading_noise_per_metre_deg.to_radians().powi(2) * length
                + config.heading_noise_per_radian * config.heading_noise_per_radian * turn.abs()
                + config.odometry_drift_deg.to_radians().powi(2) * self.wheel_interval;
            let motion = [dx, dy, turn];
            let known = if self.imu_active {
                ROLLING_NOISE_SHARE
            } else {
                1.0
            };
            let noise = self.wheel_noise_factor * known * known;
            for (k, variance) in [position, position, heading].into_iter().enumerate() {
                let scale = ODOMETRY_SCALES + k / 2;
                let residual = self.wheel_innovation(motion)[k];
                let terms = [
                    (WHEEL_INCREMENT + k, 1.0),
                    (SLIP + k, self.wheel_interval),
                    (scale, -motion[k]),
                ];
                self.update_scalar(&terms, residual, variance * noise);
            }
            self.clamp_scales();
        }
        self.restart_wheels();
    }

    /// What the wheels say of the way beyond what is believed of it and of their slip.
    fn wheel_innovation(&self, motion: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| {
            self.state[ODOMETRY_SCALES + k / 2] * motion[k]
                - self.state[WHEEL_INCREMENT + k]
                - self.wheel_interval * self.state[SLIP + k]
        })
    }

    pub(super) fn clamp_scales(&mut self) {
        for scale in &mut self.state[ODOMETRY_SCALES..ODOMETRY_SCALES + 2] {
            *scale = scale.clamp(SCALE_RANGE.0, SCALE_RANGE.1);
        }
    }

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

    pub(in crate::filter) fn zero_velocity_update(&mut self, seconds: f32) {
        for k in 0..3 {
            let noise = STATIONARY_NOISE[k / 2];
            let terms = [(TWIST + k, 1.0)];
            let residual = -self.state[TWIST + k];
            self.update_scalar(&terms, residual, noise * noise / seconds.max(1e-4));
        }
    }
}
