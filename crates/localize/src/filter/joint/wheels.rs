//! What do wheels say of the way, and when are they not believed?

use super::{Joint, PART_MAX, SCALE_RANGE, SCALES, SLIP, TREMBLE, TWIST, WAY, WIDTH};
use crate::collision::Mismatch;
use crate::filter::{FilterConfig, Way};

/// What rolling wheels err by of all that wheels err by: the rest is slip, which has a state of its own where an inertial
/// unit tells it.
const ROLLING_PART: f32 = 0.5;

impl Joint {
    pub(in crate::filter) fn wheels(&mut self, way: &Way, config: &FilterConfig) {
        if !(self.since > 0.0) {
            self.wheels_interrupted();
            return;
        }
        // A belief born within the interval, or a sample that came late, knows another part of it.
        let part = if way.seconds > 0.0 {
            (self.since / way.seconds).min(PART_MAX)
        } else {
            1.0
        };
        let [dx, dy, turn] = way.motion.map(|value| part * value);
        let residual = self.wheel_residual([dx, dy, turn]);
        let per_second = 1.0 / self.since;
        let variance = |k: usize| {
            let p = &self.covariance;
            let (way, slip, since) = (WAY + k, SLIP + k, self.since);
            p[way][way] + since * (2.0 * p[way][slip] + since * p[slip][slip])
        };
        let std = |variance: f32| variance.max(0.0).sqrt() * per_second;
        let off = Mismatch {
            speed: [
                residual[0].hypot(residual[1]) * per_second,
                std(variance(0) + variance(1)),
            ],
            turn: [residual[2].abs() * per_second, std(variance(2))],
        };
        if !way.watched || self.collision.believes(&off, &config.collision) {
            let length = dx.hypot(dy);
            let slip = part * way.slip;
            let position = config.way_noise * config.way_noise * length
                + config.drift * config.drift * self.since
                + slip * slip;
            let heading = config.heading_per_way_noise_deg.to_radians().powi(2) * length
                + config.turn_noise * config.turn_noise * turn.abs()
                + config.drift_deg.to_radians().powi(2) * self.since;
            let motion = [dx, dy, turn];
            let known = if self.felt { ROLLING_PART } else { 1.0 };
            let noise = self.noise * known * known;
            for (k, variance) in [position, position, heading].into_iter().enumerate() {
                let scale = SCALES + k / 2;
                let residual = self.wheel_residual(motion)[k];
                let terms = [(WAY + k, 1.0), (SLIP + k, self.since), (scale, -motion[k])];
                self.update(&terms, residual, variance * noise);
            }
            self.hold_scales();
        }
        self.wheels_interrupted();
    }

    /// What the wheels say of the way beyond what is believed of it and of their slip.
    fn wheel_residual(&self, motion: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| {
            self.state[SCALES + k / 2] * motion[k]
                - self.state[WAY + k]
                - self.since * self.state[SLIP + k]
        })
    }

    pub(super) fn hold_scales(&mut self) {
        for scale in &mut self.state[SCALES..SCALES + 2] {
            *scale = scale.clamp(SCALE_RANGE.0, SCALE_RANGE.1);
        }
    }

    pub(in crate::filter) fn wheels_interrupted(&mut self) {
        self.since = 0.0;
        for k in WAY..WAY + 3 {
            self.state[k] = 0.0;
            self.covariance[k] = [0.0; WIDTH];
            for line in &mut self.covariance {
                line[k] = 0.0;
            }
        }
    }

    pub(in crate::filter) fn rest(&mut self, seconds: f32) {
        for k in 0..3 {
            let noise = TREMBLE[k / 2];
            let terms = [(TWIST + k, 1.0)];
            let residual = -self.state[TWIST + k];
            self.update(&terms, residual, noise * noise / seconds.max(1e-4));
        }
    }
}
