//! What do pose, twist, biases, scales and latency tell of each other? One Kalman filter over all of them.
//!
//! Between samples the robot keeps its twist, or follows the accelerometer where there is one. Wheels measure the way
//! since their last sample exactly as far as it was driven under this belief, so that frames may fall anywhere between.
//! Wheels wear and slip, and a bias of some per cent is the rule: the scales are states (nubot2013 4 and minho2016 IV.C
//! fuse without).

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::sight;
use super::{FilterConfig, Span, Way};
use crate::collision::{Collision, Mismatch};
use crate::frame::{Pose, wrap_angle};
use crate::omni::Twist;

/// Pose on the field.
const POSE: usize = 0;
/// Way since the wheels' last sample, in the robot's frame at that time.
const WAY: usize = 3;
/// Velocity, robot frame.
const TWIST: usize = 6;
const SPIN: usize = 8;
const GYRO_BIAS: usize = 9;
/// Of way and turn.
const SCALES: usize = 10;
/// Of both horizontal axes.
const ACCELEROMETER_BIAS: usize = 12;
const LATENCY: usize = 14;
const STATES: usize = 15;
/// Rows are padded to whole vector registers.
const WIDTH: usize = 16;

type State = [f32; STATES];
type Covariance = [[f32; WIDTH]; STATES];
/// A row of a matrix: the entries that are not zero.
type Terms<'a> = &'a [(usize, f32)];

/// Scales outside these are broken encoders, not wear.
const SCALE_RANGE: (f32, f32) = (0.7, 1.4);
/// Noise is learnt within these factors (variance) of what the configuration says.
const NOISE_RANGE: (f32, f32) = (0.05, 20.0);
/// Most intervals for which the wheels' last word is taken, when some were lost.
const PART_MAX: f32 = 20.0;
/// How fast a robot may drive and turn when it is first seen: m/s, rad/s (one sigma).
const TWIST_STD: [f32; 3] = [3.0, 3.0, 6.0];
/// How much a standing robot trembles, metres and radians per square root of a second.
const TREMBLE: [f32; 2] = [0.002, 0.0005];
/// Part of a shock that the accelerometer misses: its scale and axes are no better. Were it more, nobody could say
/// afterwards that the wheels err.
const SHOCK_PART: f32 = 0.03;
/// No variance falls below this: what single precision resolves beside a metre, squared.
const VARIANCE_MIN: f32 = 1e-13;

/// Mean and covariance of everything.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    state: State,
    covariance: Covariance,
    /// How long the way has been driven, seconds.
    since: f32,
    /// Variance of the wheels' noise over what the configuration says, learnt.
    noise: f32,
    collision: Collision,
    /// Speed of the rims over the ground when the wheels were last heard, m/s.
    slip: f32,
}

impl Joint {
    pub(super) fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        known: Option<&Joint>,
        config: &FilterConfig,
    ) -> Self {
        let mut state = [0.0; STATES];
        let mut variances = [0.0; STATES];
        (state[POSE], state[POSE + 1], state[POSE + 2]) = (pose.x, pose.y, pose.theta);
        (state[SCALES], state[SCALES + 1]) = (1.0, 1.0);
        state[LATENCY] = config.camera_latency;
        for (k, std) in TWIST_STD.into_iter().enumerate() {
            variances[TWIST + k] = std * std;
        }
        variances[GYRO_BIAS] = config.gyro_bias_std_deg.to_radians().powi(2);
        for k in 0..2 {
            variances[SCALES + k] = config.scale_std * config.scale_std;
            variances[ACCELEROMETER_BIAS + k] =
                config.accelerometer_bias_std * config.accelerometer_bias_std;
        }
        variances[LATENCY] = config.camera_latency_std * config.camera_latency_std;
        let mut full = [[0.0; WIDTH]; STATES];
        for (k, variance) in variances.into_iter().enumerate() {
            full[k][k] = variance;
        }
        let mut noise = 1.0;
        if let Some(known) = known {
            noise = known.noise;
            // Wheels and units stay the same wherever the robot is put.
            for i in GYRO_BIAS..STATES {
                state[i] = known.state[i];
                full[i][GYRO_BIAS..].copy_from_slice(&known.covariance[i][GYRO_BIAS..]);
            }
        }
        let seen = covariance + sight::repeated(config);
        for i in 0..3 {
            for j in 0..3 {
                full[POSE + i][POSE + j] = seen[(i, j)];
            }
        }
        Joint {
            state,
            covariance: full,
            since: 0.0,
            noise,
            collision: Collision::default(),
            slip: 0.0,
        }
    }

    pub(super) fn pose(&self) -> Pose {
        Pose::new(self.state[0], self.state[1], self.state[2])
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        Matrix3::from_fn(|i, j| self.covariance[POSE + i][POSE + j])
    }

    pub(super) fn twist(&self) -> Twist {
        Twist {
            x: self.state[TWIST],
            y: self.state[TWIST + 1],
            theta: self.state[SPIN],
        }
    }

    pub(super) fn scales(&self) -> [f32; 2] {
        [self.state[SCALES], self.state[SCALES + 1]]
    }

    pub(super) fn gyro_bias(&self) -> f32 {
        self.state[GYRO_BIAS]
    }

    pub(super) fn latency(&self) -> f32 {
        self.state[LATENCY]
    }

    pub(super) fn colliding(&self) -> bool {
        self.collision.lasts()
    }

    /// Speed of the rims over the ground when the wheels were last heard, m/s: slip against the inertial unit.
    pub fn slip(&self) -> f32 {
        self.slip
    }

    pub(super) fn advance(&mut self, span: &Span, config: &FilterConfig) {
        if !(span.seconds > 0.0) {
            return;
        }
        if span.shock {
            self.collision.hit(&config.collision);
        }
        self.collision.pass(span.seconds);
        self.since += span.seconds;
        match span.acceleration {
            Some(felt) => self.follow(felt, span, config),
            None => self.coast(span.seconds, config),
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        let drift = |rate: f32| rate * rate * span.seconds;
        if config.scale_std > 0.0 {
            self.widen_by(SCALES, drift(config.scale_drift));
            self.widen_by(SCALES + 1, drift(config.scale_drift));
        }
        self.widen_by(GYRO_BIAS, drift(config.gyro_bias_drift_deg.to_radians()));
        for k in 0..2 {
            self.widen_by(
                ACCELEROMETER_BIAS + k,
                drift(config.accelerometer_bias_drift),
            );
        }
    }

    fn widen_by(&mut self, k: usize, variance: f32) {
        self.covariance[k][k] += variance;
    }

    /// The twist follows the accelerometer: v′ = R(−φ) v + R(−φ/2) a dt, φ the turn, since the frame turns under it.
    fn follow(&mut self, felt: [f32; 2], span: &Span, config: &FilterConfig) {
        let dt = span.seconds;
        let s = &mut self.state;
        let acceleration = [
            felt[0] - s[ACCELEROMETER_BIAS],
            felt[1] - s[ACCELEROMETER_BIAS + 1],
        ];
        let turn = s[SPIN] * dt;
        let (sin, cos) = turn.sin_cos();
        let (half_sin, half_cos) = (0.5 * turn).sin_cos();
        let (vx, vy) = (s[TWIST], s[TWIST + 1]);
        let half = 0.5 * dt * dt;
        let way = [
            vx * dt + half * acceleration[0],
            vy * dt + half * acceleration[1],
        ];
        let (ax, ay) = (acceleration[0] * dt, acceleration[1] * dt);
        s[TWIST] = cos * vx + sin * vy + half_cos * ax + half_sin * ay;
        s[TWIST + 1] = cos * vy - sin * vx + half_cos * ay - half_sin * ax;
        let (new_vx, new_vy) = (s[TWIST], s[TWIST + 1]);
        let on_field = self.step_along(POSE, way, 0.0, turn);
        let on_way = self.step_along(WAY, way, 0.0, turn);
        let moved = |theta: usize, [c, s, dx, dy]: [f32; 4]| {
            [
                [
                    (theta, -dy),
                    (TWIST, c * dt),
                    (TWIST + 1, -s * dt),
                    (ACCELEROMETER_BIAS, -half * c),
                    (ACCELEROMETER_BIAS + 1, half * s),
                ],
                [
                    (theta, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (ACCELEROMETER_BIAS, -half * s),
                    (ACCELEROMETER_BIAS + 1, -half * c),
                ],
            ]
        };
        let (field_rows, way_rows) = (moved(POSE + 2, on_field), moved(WAY + 2, on_way));
        let turned = [(SPIN, dt)];
        let faster = [
            (TWIST, cos - 1.0),
            (TWIST + 1, sin),
            (SPIN, dt * new_vy),
            (ACCELEROMETER_BIAS, -dt * half_cos),
            (ACCELEROMETER_BIAS + 1, -dt * half_sin),
        ];
        let sideways = [
            (TWIST, -sin),
            (TWIST + 1, cos - 1.0),
            (SPIN, -dt * new_vx),
            (ACCELEROMETER_BIAS, dt * half_sin),
            (ACCELEROMETER_BIAS + 1, -dt * half_cos),
        ];
        self.transform(&[
            (POSE, &field_rows[0]),
            (POSE + 1, &field_rows[1]),
            (POSE + 2, &turned),
            (WAY, &way_rows[0]),
            (WAY + 1, &way_rows[1]),
            (WAY + 2, &turned),
            (TWIST, &faster),
            (TWIST + 1, &sideways),
        ]);
        let size = felt[0].hypot(felt[1]);
        let shaken = if span.shock {
            (SHOCK_PART * size).powi(2)
        } else {
            0.0
        };
        let variance = config.accelerometer_noise * config.accelerometer_noise / dt + shaken;
        self.shake(dt, variance, on_field, on_way, config);
    }

    /// Nothing tells of accelerations: the twist stays, as motors hold it.
    fn coast(&mut self, dt: f32, config: &FilterConfig) {
        let turn = self.state[SPIN] * dt;
        let way = [self.state[TWIST] * dt, self.state[TWIST + 1] * dt];
        let on_field = self.step_along(POSE, way, 0.5 * turn, turn);
        let on_way = self.step_along(WAY, way, 0.5 * turn, turn);
        let moved = |theta: usize, [c, s, dx, dy]: [f32; 4]| {
            [
                [
                    (theta, -dy),
                    (TWIST, c * dt),
                    (TWIST + 1, -s * dt),
                    (SPIN, -0.5 * dt * dy),
                ],
                [
                    (theta, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (SPIN, 0.5 * dt * dx),
                ],
            ]
        };
        let (field_rows, way_rows) = (moved(POSE + 2, on_field), moved(WAY + 2, on_way));
        let turned = [(SPIN, dt)];
        self.transform(&[
            (POSE, &field_rows[0]),
            (POSE + 1, &field_rows[1]),
            (POSE + 2, &turned),
            (WAY, &way_rows[0]),
            (WAY + 1, &way_rows[1]),
            (WAY + 2, &turned),
        ]);
        let variance = config.twist_noise * config.twist_noise / dt;
        self.shake(dt, variance, on_field, on_way, config);
    }

    /// Moves a frame (pose, or way) by a step in its own coordinates, turned by `ahead` besides its heading.
    ///
    /// Cosine and sine of that direction, and the step as made.
    fn step_along(&mut self, frame: usize, way: [f32; 2], ahead: f32, turn: f32) -> [f32; 4] {
        let (sin, cos) = (self.state[frame + 2] + ahead).sin_cos();
        let step = [cos * way[0] - sin * way[1], sin * way[0] + cos * way[1]];
        self.state[frame] += step[0];
        self.state[frame + 1] += step[1];
        self.state[frame + 2] += turn;
        [cos, sin, step[0], step[1]]
    }

    /// P ← (I + A) P (I + A)ᵀ with the rows of A that are not zero.
    fn transform(&mut self, rows: &[(usize, Terms)]) {
        let p = &mut self.covariance;
        let old = *p;
        for &(row, terms) in rows {
            for &(column, factor) in terms {
                for (value, other) in p[row].iter_mut().zip(&old[column]) {
                    *value += factor * other;
                }
            }
        }
        for line in p.iter_mut() {
            let old = *line;
            for &(row, terms) in rows {
                for &(column, factor) in terms {
                    line[row] += factor * old[column];
                }
            }
        }
    }

    /// What moved the robot unforeseen: an acceleration of this variance (each axis), and the turn's, all along `dt`.
    fn shake(
        &mut self,
        dt: f32,
        variance: f32,
        [c, s, ..]: [f32; 4],
        [wc, ws, ..]: [f32; 4],
        config: &FilterConfig,
    ) {
        let spin = config.spin_noise * config.spin_noise / dt;
        // White noise of density q moves by q (dt³/3, dt²/2; dt²/2, dt): a constant acceleration explains three quarters
        // of the way's variance, the rest is the way's own. Without it the twist would swing from sample to sample.
        for (half, end) in [(0.5 * dt * dt, dt), (dt * dt / 12.0_f32.sqrt(), 0.0)] {
            let along = [
                (half * c, half * s, half * wc, half * ws),
                (-half * s, half * c, -half * ws, half * wc),
            ];
            for (k, (x, y, way_x, way_y)) in along.into_iter().enumerate() {
                let vector = [
                    (POSE, x),
                    (POSE + 1, y),
                    (WAY, way_x),
                    (WAY + 1, way_y),
                    (TWIST + k, end),
                ];
                self.widen_along(&vector, variance);
            }
            self.widen_along(&[(POSE + 2, half), (WAY + 2, half), (SPIN, end)], spin);
        }
    }

    fn widen_along(&mut self, vector: Terms, variance: f32) {
        for &(i, a) in vector {
            for &(j, b) in vector {
                self.covariance[i][j] += variance * a * b;
            }
        }
    }

    /// A measurement: Σ terms·state deviates from what was measured by `residual`, whose own variance is given.
    fn update(&mut self, terms: Terms, residual: f32, variance: f32) {
        let mut gain = [0.0; WIDTH];
        for &(column, factor) in terms {
            for (value, other) in gain.iter_mut().zip(&self.covariance[column]) {
                *value += factor * other;
            }
        }
        let total: f32 = terms
            .iter()
            .map(|&(column, factor)| factor * gain[column])
            .sum::<f32>()
            + variance;
        if !(total > 0.0) {
            return;
        }
        let part = residual / total;
        for (value, gain) in self.state.iter_mut().zip(&gain) {
            *value += gain * part;
        }
        for (i, line) in self.covariance.iter_mut().enumerate() {
            let factor = gain[i] / total;
            for (value, gain) in line.iter_mut().zip(&gain) {
                *value -= factor * gain;
            }
            line[i] = line[i].max(VARIANCE_MIN);
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
    }

    pub(super) fn wheels(&mut self, way: &Way, config: &FilterConfig) {
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
        let std = |first: usize, last: usize| {
            let variance: f32 = (first..=last).map(|k| self.covariance[k][k]).sum();
            variance.max(0.0).sqrt() * per_second
        };
        let off = Mismatch {
            speed: [
                residual[0].hypot(residual[1]) * per_second,
                std(WAY, WAY + 1),
            ],
            turn: [residual[2].abs() * per_second, std(WAY + 2, WAY + 2)],
        };
        self.slip = off.speed[0];
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
            for (k, variance) in [position, position, heading].into_iter().enumerate() {
                let scale = SCALES + k / 2;
                let residual = self.wheel_residual(motion)[k];
                let terms = [(WAY + k, 1.0), (scale, -motion[k])];
                self.update(&terms, residual, variance * self.noise);
            }
            self.hold_scales();
        }
        self.wheels_interrupted();
    }

    /// What the wheels say of the way beyond what is believed of it.
    fn wheel_residual(&self, motion: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| self.state[SCALES + k / 2] * motion[k] - self.state[WAY + k])
    }

    fn hold_scales(&mut self) {
        for scale in &mut self.state[SCALES..SCALES + 2] {
            *scale = scale.clamp(SCALE_RANGE.0, SCALE_RANGE.1);
        }
    }

    pub(super) fn wheels_interrupted(&mut self) {
        self.since = 0.0;
        for k in WAY..WAY + 3 {
            self.state[k] = 0.0;
            self.covariance[k] = [0.0; WIDTH];
            for line in &mut self.covariance {
                line[k] = 0.0;
            }
        }
    }

    pub(super) fn gyro(&mut self, rate: f32, seconds: f32, config: &FilterConfig) {
        let noise = config.gyro_noise_deg.to_radians();
        let residual = rate - self.state[SPIN] - self.state[GYRO_BIAS];
        let terms = [(SPIN, 1.0), (GYRO_BIAS, 1.0)];
        self.update(&terms, residual, noise * noise / seconds.max(1e-4));
    }

    pub(super) fn rest(&mut self, seconds: f32) {
        for k in 0..3 {
            let noise = TREMBLE[k / 2];
            let terms = [(TWIST + k, 1.0)];
            let residual = -self.state[TWIST + k];
            self.update(&terms, residual, noise * noise / seconds.max(1e-4));
        }
    }

    /// Covariance with the pose at the exposure: the columns of P Hᵀ, H = (1, −velocity) of (pose, latency).
    fn with_sight(&self) -> SMatrix<f32, STATES, 3> {
        let p = &self.covariance;
        let (sin, cos) = self.state[POSE + 2].sin_cos();
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        let velocity = [cos * vx - sin * vy, sin * vx + cos * vy, self.state[SPIN]];
        SMatrix::from_fn(|i, j| p[i][POSE + j] - velocity[j] * p[i][LATENCY])
    }

    pub(super) fn sight_covariance(&self) -> Matrix3<f32> {
        self.sight_part(&self.with_sight())
    }

    fn sight_part(&self, with: &SMatrix<f32, STATES, 3>) -> Matrix3<f32> {
        let (sin, cos) = self.state[POSE + 2].sin_cos();
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        let velocity = Vector3::new(cos * vx - sin * vy, sin * vx + cos * vy, self.state[SPIN]);
        let full = with.fixed_rows::<3>(POSE) - velocity * with.fixed_rows::<1>(LATENCY);
        (full + full.transpose()) * 0.5
    }

    pub(super) fn absorb(&mut self, pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) {
        let with = self.with_sight();
        let expected = self.sight_part(&with);
        let Some(inverse) = expected.try_inverse() else {
            return;
        };
        let gain = with * inverse;
        let innovation = sight::innovation(self.pose(), pose);
        // An honest expectation is left by 3 − tr(P⁻¹P⁺) on average; more means noisier odometry than assumed.
        let strain = innovation.dot(&(inverse * innovation));
        let usual = 3.0 - (inverse * covariance).trace();
        self.noise = (self.noise
            * (config.noise_learning * (strain - usual).clamp(-3.0, 9.0)).exp())
        .clamp(NOISE_RANGE.0, NOISE_RANGE.1);
        let step = gain * innovation;
        for (value, step) in self.state.iter_mut().zip(step.iter()) {
            *value += step;
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        self.hold_scales();
        let learnt = gain * (expected - covariance);
        let down = learnt * gain.transpose();
        let repeated = sight::repeated(config);
        for i in 0..STATES {
            for j in 0..=i {
                let extra = if i < 3 { repeated[(i, j)] } else { 0.0 };
                let mean = 0.5 * (self.covariance[i][j] + self.covariance[j][i]);
                let value = mean - 0.5 * (down[(i, j)] + down[(j, i)]) + extra;
                let value = if i == j {
                    value.max(VARIANCE_MIN)
                } else {
                    value
                };
                self.covariance[i][j] = value;
                self.covariance[j][i] = value;
            }
        }
        if config.camera_latency_std == 0.0 {
            // The same, without what rounding left.
            for i in 0..3 {
                for j in 0..3 {
                    self.covariance[i][j] = covariance[(i, j)] + repeated[(i, j)];
                }
            }
        }
    }

    pub(super) fn widen(&mut self, factor: f32) {
        for i in 0..STATES {
            for j in 0..STATES {
                self.covariance[i][j] *= match (i < 3, j < 3) {
                    (true, true) => factor,
                    (false, false) => 1.0,
                    _ => 0.0,
                };
            }
        }
        // What moved it may move it still.
        for (k, std) in TWIST_STD.into_iter().enumerate() {
            self.covariance[TWIST + k][TWIST + k] += (0.3 * std).powi(2);
        }
    }

    pub(super) fn half_turned(&self) -> Self {
        let mut other = self.clone();
        other.state[0] = -self.state[0];
        other.state[1] = -self.state[1];
        other.state[2] = wrap_angle(self.state[2] + std::f32::consts::PI);
        for i in 0..2 {
            for j in 2..STATES {
                other.covariance[i][j] = -self.covariance[i][j];
                other.covariance[j][i] = -self.covariance[j][i];
            }
        }
        other
    }
}
