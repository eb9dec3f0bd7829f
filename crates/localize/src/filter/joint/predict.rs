//! How does the robot move on between samples, and how uncertain does that make it? Inertial unit, or the twist kept.

use super::{
    ACCELEROMETER_BIAS, GYRO_BIAS, GYRO_SCALE, Joint, LEAN, POSE, SCALES, SHOCK_PART, SLIP, SPIN,
    TWIST, Terms, WAY,
};
use crate::attitude::GRAVITY;
use crate::filter::{Felt, FilterConfig, Span};
use crate::frame::wrap_angle;

/// How fast sliding wheels' speed over the ground changes: m/s (each axis) and rad/s per square root of a second. Motors
/// that pull 2 m/s² harder than the carpet holds, on wheels 0.2 m from the centre.
const SLIP_NOISE: [f32; 3] = [2.0, 2.0, 10.0];
/// Wheels that slide no more roll after so long, seconds: a few turns of an encoder's clock.
const GRIP_TIME: f32 = 0.03;
/// What pushes the robot is smoothed by so long, seconds: longer than wheels rattle.
const PUSH_TIME: f32 = 0.05;
/// A lean that nobody follows is another one after so long, seconds.
const LEAN_TIME: f32 = 0.1;

/// A step by the inertial unit as it was made.
struct Step {
    dt: f32,
    /// Cosine and sine of the turn, and of half of it.
    turned: [f32; 2],
    half_turned: [f32; 2],
    /// The turn that the gyro told, its scale and bias not applied, and its rate at the end.
    told: f32,
    spin: f32,
    /// As [`Joint::step_along`] told of pose and way.
    on_field: [f32; 4],
    on_way: [f32; 4],
}

impl Joint {
    pub(in crate::filter) fn advance(&mut self, span: &Span, config: &FilterConfig) {
        if !(span.seconds > 0.0) {
            return;
        }
        if span.shock {
            self.collision.hit(&config.collision);
        }
        self.collision.pass(span.seconds);
        self.since += span.seconds;
        self.felt = span.felt.is_some();
        match &span.felt {
            Some(felt) => self.follow(felt, span, config),
            None => self.coast(span.seconds, config),
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        let drift = |rate: f32| rate * rate * span.seconds;
        if config.scale_std > 0.0 {
            self.widen_by(SCALES, drift(config.scale_drift));
            self.widen_by(SCALES + 1, drift(config.scale_drift));
        }
        for k in 0..3 {
            self.widen_by(
                GYRO_BIAS + k,
                drift(config.gyro_bias_drift_deg.to_radians()),
            );
        }
        for k in 0..2 {
            self.widen_by(
                ACCELEROMETER_BIAS + k,
                drift(config.accelerometer_bias_drift),
            );
        }
    }

    pub(super) fn widen_by(&mut self, k: usize, variance: f32) {
        self.covariance[k][k] += variance;
    }

    /// The twist follows the inertial unit: v′ = R(−φ) v + R(−φ/2) a dt, φ the turn, since the frame turns under it.
    ///
    /// The gyro's word is the turn itself, but for scale, bias and noise: a robot that may turn as it likes between
    /// readings would have wheels outvote it, which slip when it matters.
    fn follow(&mut self, felt: &Felt, span: &Span, config: &FilterConfig) {
        let dt = span.seconds;
        let s = &mut self.state;
        let acceleration: [f32; 2] = std::array::from_fn(|k| {
            felt.force[k] - GRAVITY * s[LEAN + k] - s[ACCELEROMETER_BIAS + k]
        });
        let turn = (s[GYRO_SCALE] * felt.rate[2] - s[GYRO_BIAS + 2]) * dt;
        s[SPIN] = s[GYRO_SCALE] * felt.spin - s[GYRO_BIAS + 2];
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
        // Up turns against the robot: u̇ = u × ω.
        let (a, b) = (s[LEAN], s[LEAN + 1]);
        s[LEAN] = cos * a + sin * b - (felt.rate[1] - s[GYRO_BIAS + 1]) * dt;
        s[LEAN + 1] = cos * b - sin * a + (felt.rate[0] - s[GYRO_BIAS]) * dt;
        let step = Step {
            dt,
            turned: [cos, sin],
            half_turned: [half_cos, half_sin],
            told: felt.rate[2] * dt,
            spin: felt.spin,
            on_field: self.step_along(POSE, way, 0.0, turn),
            on_way: self.step_along(WAY, way, 0.0, turn),
        };
        let (slides, gripped) = self.grip(acceleration, dt, config);
        self.spread(&step, &gripped);
        self.blur(felt, span, &step, config);
        for (k, noise) in SLIP_NOISE.into_iter().enumerate() {
            self.widen_by(SLIP + k, (noise * slides).powi(2) * dt);
        }
    }

    /// The covariance follows a step by the inertial unit.
    fn spread(&mut self, step: &Step, gripped: &[[(usize, f32); 1]; 3]) {
        let Step { dt, told, .. } = *step;
        let ([cos, sin], [half_cos, half_sin]) = (step.turned, step.half_turned);
        let half = 0.5 * dt * dt;
        let fallen = half * GRAVITY;
        let moved = |theta: usize, [c, s, dx, dy]: [f32; 4]| {
            [
                [
                    (theta, -dy),
                    (TWIST, c * dt),
                    (TWIST + 1, -s * dt),
                    (ACCELEROMETER_BIAS, -half * c),
                    (ACCELEROMETER_BIAS + 1, half * s),
                    (LEAN, -fallen * c),
                    (LEAN + 1, fallen * s),
                ],
                [
                    (theta, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (ACCELEROMETER_BIAS, -half * s),
                    (ACCELEROMETER_BIAS + 1, -half * c),
                    (LEAN, -fallen * s),
                    (LEAN + 1, -fallen * c),
                ],
            ]
        };
        let (field_rows, way_rows) = (moved(POSE + 2, step.on_field), moved(WAY + 2, step.on_way));
        let turned = [(GYRO_BIAS + 2, -dt), (GYRO_SCALE, told)];
        let spun = [(SPIN, -1.0), (GYRO_BIAS + 2, -1.0), (GYRO_SCALE, step.spin)];
        // What turns with the robot's frame changes by the turn's error too.
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        let (a, b) = (self.state[LEAN], self.state[LEAN + 1]);
        let faster = [
            (TWIST, cos - 1.0),
            (TWIST + 1, sin),
            (GYRO_BIAS + 2, -dt * vy),
            (GYRO_SCALE, told * vy),
            (ACCELEROMETER_BIAS, -dt * half_cos),
            (ACCELEROMETER_BIAS + 1, -dt * half_sin),
            (LEAN, -GRAVITY * dt * half_cos),
            (LEAN + 1, -GRAVITY * dt * half_sin),
        ];
        let sideways = [
            (TWIST, -sin),
            (TWIST + 1, cos - 1.0),
            (GYRO_BIAS + 2, dt * vx),
            (GYRO_SCALE, -told * vx),
            (ACCELEROMETER_BIAS, dt * half_sin),
            (ACCELEROMETER_BIAS + 1, -dt * half_cos),
            (LEAN, GRAVITY * dt * half_sin),
            (LEAN + 1, -GRAVITY * dt * half_cos),
        ];
        let nodding = [
            (LEAN, cos - 1.0),
            (LEAN + 1, sin),
            (GYRO_BIAS + 1, dt),
            (GYRO_BIAS + 2, -dt * b),
            (GYRO_SCALE, told * b),
        ];
        let rolling = [
            (LEAN, -sin),
            (LEAN + 1, cos - 1.0),
            (GYRO_BIAS, -dt),
            (GYRO_BIAS + 2, dt * a),
            (GYRO_SCALE, -told * a),
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
            (SPIN, &spun),
            (LEAN, &nodding),
            (LEAN + 1, &rolling),
            (SLIP, &gripped[0]),
            (SLIP + 1, &gripped[1]),
            (SLIP + 2, &gripped[2]),
        ]);
    }

    /// What the inertial unit's noise adds in a step by it.
    fn blur(&mut self, felt: &Felt, span: &Span, step: &Step, config: &FilterConfig) {
        let dt = step.dt;
        let [x, y] = felt.force;
        // When within the stretch a shock turned it, nobody knows: evenly distributed.
        let (shaken, jumped) = if span.shock {
            let turned = 2.0 * (felt.spin - felt.rate[2]) * dt;
            ((SHOCK_PART * x.hypot(y)).powi(2), turned * turned / 12.0)
        } else {
            (0.0, 0.0)
        };
        let noise = config.accelerometer_noise.powi(2) + felt.rattle.powi(2) * felt.interval;
        self.shake(dt, noise / dt + shaken, step.on_field, step.on_way);
        let noise = config.gyro_noise_deg.to_radians().powi(2);
        self.widen_along(&[(POSE + 2, 1.0), (WAY + 2, 1.0)], noise * dt + jumped);
        self.widen_by(SPIN, noise / felt.interval.max(1e-4));
        for k in 0..2 {
            self.widen_by(LEAN + k, noise * dt);
        }
    }

    /// How freely wheels slide now (0 to 1), and how their slip ends.
    ///
    /// Who slides is pushed by all that the carpet gives, so that wheels of a robot that hardly accelerates roll.
    fn grip(
        &mut self,
        acceleration: [f32; 2],
        dt: f32,
        config: &FilterConfig,
    ) -> (f32, [[(usize, f32); 1]; 3]) {
        let share = 1.0 - (-dt / PUSH_TIME).exp();
        for (pushed, value) in self.pushed.iter_mut().zip(acceleration) {
            *pushed += share * (value - *pushed);
        }
        let [x, y] = self.pushed;
        let slides = (x.hypot(y) / config.slide_acceleration).min(1.0).powi(2);
        let keep = (-dt * (1.0 - slides) / GRIP_TIME).exp();
        for slip in &mut self.state[SLIP..SLIP + 3] {
            *slip *= keep;
        }
        (slides, [0, 1, 2].map(|k| [(SLIP + k, keep - 1.0)]))
    }

    /// Nothing tells of accelerations: the twist stays, as motors hold it.
    fn coast(&mut self, dt: f32, config: &FilterConfig) {
        self.stand(dt, config);
        let (_, gripped) = self.grip([0.0; 2], dt, config);
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
            (SLIP, &gripped[0]),
            (SLIP + 1, &gripped[1]),
            (SLIP + 2, &gripped[2]),
        ]);
        let variance = config.twist_noise * config.twist_noise / dt;
        self.shake(dt, variance, on_field, on_way);
        let spin = config.spin_noise * config.spin_noise / dt;
        for (half, end) in noise_shapes(dt) {
            self.widen_along(&[(POSE + 2, half), (WAY + 2, half), (SPIN, end)], spin);
        }
    }

    /// Nothing tells how it leans: soon as robots usually stand, whatever it was before.
    fn stand(&mut self, dt: f32, config: &FilterConfig) {
        let usual = config.lean_std_deg.to_radians().powi(2);
        let most = usual + config.mount_std_deg.to_radians().powi(2);
        for k in LEAN..LEAN + 2 {
            if self.covariance[k][k] < most {
                self.widen_by(k, usual * dt / LEAN_TIME);
            }
        }
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

    /// What moved the robot unforeseen: an acceleration of this variance (each axis) all along `dt`.
    fn shake(&mut self, dt: f32, variance: f32, [c, s, ..]: [f32; 4], [wc, ws, ..]: [f32; 4]) {
        for (half, end) in noise_shapes(dt) {
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
        }
    }

    fn widen_along(&mut self, vector: Terms, variance: f32) {
        for &(i, a) in vector {
            for &(j, b) in vector {
                self.covariance[i][j] += variance * a * b;
            }
        }
    }
}

/// White noise of density q moves by q (dt³/3, dt²/2; dt²/2, dt): a constant acceleration explains three quarters of the
/// way's variance, the rest is the way's own. Without it the twist would swing from sample to sample.
fn noise_shapes(dt: f32) -> [(f32, f32); 2] {
    [(0.5 * dt * dt, dt), (dt * dt / 12.0_f32.sqrt(), 0.0)]
}
