//! How does the robot move on between samples, and how uncertain does that make it? Inertial unit, or the twist kept.

use super::{
    ACCELEROMETER_BIAS, GYRO_BIAS, GYRO_SCALE, JointFilter, ODOMETRY_SCALES, POSE,
    SHOCK_ERROR_SHARE, SLIP, SparseRow, TILT, TWIST, WHEEL_INCREMENT, YAW_RATE,
};
use crate::filter::{FilterConfig, ImuInterval, PredictionInput};
use crate::frames::wrap_angle;
use crate::sensors::attitude::GRAVITY;

/// How fast sliding wheels' speed over the ground changes: m/s (each axis) and rad/s per square root of a second. Motors
/// that pull 2 m/s² harder than the carpet holds, on wheels 0.2 m from the centre.
const SLIP_NOISE: [f32; 3] = [2.0, 2.0, 10.0];
/// Wheels that slide no more roll after so long, seconds: a few turns of an encoder's clock.
const SLIP_DECAY_TIME: f32 = 0.03;
/// What pushes the robot is smoothed by so long, seconds: longer than wheels rattle.
const ACCELERATION_SMOOTHING_TIME: f32 = 0.05;
/// A lean that nobody follows is another one after so long, seconds.
const TILT_RELAXATION_TIME: f32 = 0.1;

/// A step by the inertial unit as it was made.
struct ImuStep {
    dt: f32,
    /// Cosine and sine of the turn, and of half of it.
    rotation: [f32; 2],
    half_rotation: [f32; 2],
    /// The turn that the gyro told, its scale and bias not applied, and its rate at the end.
    gyro_angle: f32,
    gyro_yaw_rate: f32,
    /// As [`Joint::step_along`] told of pose and way.
    field_step: [f32; 4],
    increment_step: [f32; 4],
}

impl JointFilter {
    pub(in crate::filter) fn predict(&mut self, span: &PredictionInput, config: &FilterConfig) {
        if !(span.dt > 0.0) {
            return;
        }
        if span.shock {
            self.collision.trigger(&config.collision);
        }
        self.collision.advance_time(span.dt);
        self.wheel_interval += span.dt;
        self.imu_active = span.imu.is_some();
        match &span.imu {
            Some(felt) => self.predict_imu(felt, span, config),
            None => self.predict_constant_velocity(span.dt, config),
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        let drift = |rate: f32| rate * rate * span.dt;
        if config.odometry_scale_std > 0.0 {
            self.inflate_variance(ODOMETRY_SCALES, drift(config.odometry_scale_drift));
            self.inflate_variance(ODOMETRY_SCALES + 1, drift(config.odometry_scale_drift));
        }
        for k in 0..3 {
            self.inflate_variance(
                GYRO_BIAS + k,
                drift(config.gyro_bias_drift_deg.to_radians()),
            );
        }
        for k in 0..2 {
            self.inflate_variance(
                ACCELEROMETER_BIAS + k,
                drift(config.accelerometer_bias_drift),
            );
        }
    }

    pub(super) fn inflate_variance(&mut self, k: usize, variance: f32) {
        self.covariance[k][k] += variance;
    }

    /// The twist follows the inertial unit: v′ = R(−φ) v + R(−φ/2) a dt, φ the turn, since the frame turns under it.
    ///
    /// The gyro's word is the turn itself, but for scale, bias and noise: a robot that may turn as it likes between
    /// readings would have wheels outvote it, which slip when it matters.
    fn predict_imu(&mut self, felt: &ImuInterval, span: &PredictionInput, config: &FilterConfig) {
        let dt = span.dt;
        let s = &mut self.state;
        let acceleration: [f32; 2] = std::array::from_fn(|k| {
            felt.specific_force[k] - GRAVITY * s[TILT + k] - s[ACCELEROMETER_BIAS + k]
        });
        let turn = (s[GYRO_SCALE] * felt.rate[2] - s[GYRO_BIAS + 2]) * dt;
        s[YAW_RATE] = s[GYRO_SCALE] * felt.yaw_rate - s[GYRO_BIAS + 2];
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
        let (a, b) = (s[TILT], s[TILT + 1]);
        s[TILT] = cos * a + sin * b - (felt.rate[1] - s[GYRO_BIAS + 1]) * dt;
        s[TILT + 1] = cos * b - sin * a + (felt.rate[0] - s[GYRO_BIAS]) * dt;
        let step = ImuStep {
            dt,
            rotation: [cos, sin],
            half_rotation: [half_cos, half_sin],
            gyro_angle: felt.rate[2] * dt,
            gyro_yaw_rate: felt.yaw_rate,
            field_step: self.integrate_step(POSE, way, 0.0, turn),
            increment_step: self.integrate_step(WHEEL_INCREMENT, way, 0.0, turn),
        };
        let (slides, gripped) = self.update_slip(acceleration, dt, config);
        self.propagate_covariance(&step, &gripped);
        self.add_process_noise(felt, span, &step, config);
        for (k, noise) in SLIP_NOISE.into_iter().enumerate() {
            self.inflate_variance(SLIP + k, (noise * slides).powi(2) * dt);
        }
    }

    /// The covariance follows a step by the inertial unit.
    fn propagate_covariance(&mut self, step: &ImuStep, gripped: &[[(usize, f32); 1]; 3]) {
        let ImuStep {
            dt,
            gyro_angle: told,
            ..
        } = *step;
        let ([cos, sin], [half_cos, half_sin]) = (step.rotation, step.half_rotation);
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
                    (TILT, -fallen * c),
                    (TILT + 1, fallen * s),
                ],
                [
                    (theta, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (ACCELEROMETER_BIAS, -half * s),
                    (ACCELEROMETER_BIAS + 1, -half * c),
                    (TILT, -fallen * s),
                    (TILT + 1, -fallen * c),
                ],
            ]
        };
        let (field_rows, way_rows) = (
            moved(POSE + 2, step.field_step),
            moved(WHEEL_INCREMENT + 2, step.increment_step),
        );
        let turned = [(GYRO_BIAS + 2, -dt), (GYRO_SCALE, told)];
        let spun = [
            (YAW_RATE, -1.0),
            (GYRO_BIAS + 2, -1.0),
            (GYRO_SCALE, step.gyro_yaw_rate),
        ];
        // What turns with the robot's frame changes by the turn's error too.
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        let (a, b) = (self.state[TILT], self.state[TILT + 1]);
        let faster = [
            (TWIST, cos - 1.0),
            (TWIST + 1, sin),
            (GYRO_BIAS + 2, -dt * vy),
            (GYRO_SCALE, told * vy),
            (ACCELEROMETER_BIAS, -dt * half_cos),
            (ACCELEROMETER_BIAS + 1, -dt * half_sin),
            (TILT, -GRAVITY * dt * half_cos),
            (TILT + 1, -GRAVITY * dt * half_sin),
        ];
        let sideways = [
            (TWIST, -sin),
            (TWIST + 1, cos - 1.0),
            (GYRO_BIAS + 2, dt * vx),
            (GYRO_SCALE, -told * vx),
            (ACCELEROMETER_BIAS, dt * half_sin),
            (ACCELEROMETER_BIAS + 1, -dt * half_cos),
            (TILT, GRAVITY * dt * half_sin),
            (TILT + 1, -GRAVITY * dt * half_cos),
        ];
        let nodding = [
            (TILT, cos - 1.0),
            (TILT + 1, sin),
            (GYRO_BIAS + 1, dt),
            (GYRO_BIAS + 2, -dt * b),
            (GYRO_SCALE, told * b),
        ];
        let rolling = [
            (TILT, -sin),
            (TILT + 1, cos - 1.0),
            (GYRO_BIAS, -dt),
            (GYRO_BIAS + 2, dt * a),
            (GYRO_SCALE, -told * a),
        ];
        self.apply_transition(&[
            (POSE, &field_rows[0]),
            (POSE + 1, &field_rows[1]),
            (POSE + 2, &turned),
            (WHEEL_INCREMENT, &way_rows[0]),
            (WHEEL_INCREMENT + 1, &way_rows[1]),
            (WHEEL_INCREMENT + 2, &turned),
            (TWIST, &faster),
            (TWIST + 1, &sideways),
            (YAW_RATE, &spun),
            (TILT, &nodding),
            (TILT + 1, &rolling),
            (SLIP, &gripped[0]),
            (SLIP + 1, &gripped[1]),
            (SLIP + 2, &gripped[2]),
        ]);
    }

    /// What the inertial unit's noise adds in a step by it.
    fn add_process_noise(
        &mut self,
        felt: &ImuInterval,
        span: &PredictionInput,
        step: &ImuStep,
        config: &FilterConfig,
    ) {
        let dt = step.dt;
        let [x, y] = felt.specific_force;
        // When within the stretch a shock turned it, nobody knows: evenly distributed.
        let (shaken, jumped) = if span.shock {
            let turned = 2.0 * (felt.yaw_rate - felt.rate[2]) * dt;
            (
                (SHOCK_ERROR_SHARE * x.hypot(y)).powi(2),
                turned * turned / 12.0,
            )
        } else {
            (0.0, 0.0)
        };
        let noise =
            config.accelerometer_noise.powi(2) + felt.vibration_std.powi(2) * felt.sample_period;
        self.add_acceleration_noise(
            dt,
            noise / dt + shaken,
            step.field_step,
            step.increment_step,
        );
        let noise = config.gyro_noise_deg.to_radians().powi(2);
        self.add_rank_one_noise(
            &[(POSE + 2, 1.0), (WHEEL_INCREMENT + 2, 1.0)],
            noise * dt + jumped,
        );
        self.inflate_variance(YAW_RATE, noise / felt.sample_period.max(1e-4));
        for k in 0..2 {
            self.inflate_variance(TILT + k, noise * dt);
        }
    }

    /// How freely wheels slide now (0 to 1), and how their slip ends.
    ///
    /// Who slides is pushed by all that the carpet gives, so that wheels of a robot that hardly accelerates roll.
    fn update_slip(
        &mut self,
        acceleration: [f32; 2],
        dt: f32,
        config: &FilterConfig,
    ) -> (f32, [[(usize, f32); 1]; 3]) {
        let share = 1.0 - (-dt / ACCELERATION_SMOOTHING_TIME).exp();
        for (pushed, value) in self.smoothed_acceleration.iter_mut().zip(acceleration) {
            *pushed += share * (value - *pushed);
        }
        let [x, y] = self.smoothed_acceleration;
        let slides = (x.hypot(y) / config.slip_acceleration).min(1.0).powi(2);
        let keep = (-dt * (1.0 - slides) / SLIP_DECAY_TIME).exp();
        for slip in &mut self.state[SLIP..SLIP + 3] {
            *slip *= keep;
        }
        (slides, [0, 1, 2].map(|k| [(SLIP + k, keep - 1.0)]))
    }

    /// Nothing tells of accelerations: the twist stays, as motors hold it.
    fn predict_constant_velocity(&mut self, dt: f32, config: &FilterConfig) {
        self.relax_tilt_prior(dt, config);
        let (_, gripped) = self.update_slip([0.0; 2], dt, config);
        let turn = self.state[YAW_RATE] * dt;
        let way = [self.state[TWIST] * dt, self.state[TWIST + 1] * dt];
        let on_field = self.integrate_step(POSE, way, 0.5 * turn, turn);
        let on_way = self.integrate_step(WHEEL_INCREMENT, way, 0.5 * turn, turn);
        let moved = |theta: usize, [c, s, dx, dy]: [f32; 4]| {
            [
                [
                    (theta, -dy),
                    (TWIST, c * dt),
                    (TWIST + 1, -s * dt),
                    (YAW_RATE, -0.5 * dt * dy),
                ],
                [
                    (theta, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (YAW_RATE, 0.5 * dt * dx),
                ],
            ]
        };
        let (field_rows, way_rows) = (
            moved(POSE + 2, on_field),
            moved(WHEEL_INCREMENT + 2, on_way),
        );
        let turned = [(YAW_RATE, dt)];
        self.apply_transition(&[
            (POSE, &field_rows[0]),
            (POSE + 1, &field_rows[1]),
            (POSE + 2, &turned),
            (WHEEL_INCREMENT, &way_rows[0]),
            (WHEEL_INCREMENT + 1, &way_rows[1]),
            (WHEEL_INCREMENT + 2, &turned),
            (SLIP, &gripped[0]),
            (SLIP + 1, &gripped[1]),
            (SLIP + 2, &gripped[2]),
        ]);
        let variance = config.velocity_process_noise * config.velocity_process_noise / dt;
        self.add_acceleration_noise(dt, variance, on_field, on_way);
        let spin = config.yaw_rate_process_noise * config.yaw_rate_process_noise / dt;
        for (half, end) in discretize_white_noise(dt) {
            self.add_rank_one_noise(
                &[
                    (POSE + 2, half),
                    (WHEEL_INCREMENT + 2, half),
                    (YAW_RATE, end),
                ],
                spin,
            );
        }
    }

    /// Nothing tells how it leans: soon as robots usually stand, whatever it was before.
    fn relax_tilt_prior(&mut self, dt: f32, config: &FilterConfig) {
        let usual = config.tilt_std_deg.to_radians().powi(2);
        let most = usual + config.imu_mount_std_deg.to_radians().powi(2);
        for k in TILT..TILT + 2 {
            if self.covariance[k][k] < most {
                self.inflate_variance(k, usual * dt / TILT_RELAXATION_TIME);
            }
        }
    }

    /// Moves a frame (pose, or way) by a step in its own coordinates, turned by `ahead` besides its heading.
    ///
    /// Cosine and sine of that direction, and the step as made.
    fn integrate_step(&mut self, frame: usize, way: [f32; 2], ahead: f32, turn: f32) -> [f32; 4] {
        let (sin, cos) = (self.state[frame + 2] + ahead).sin_cos();
        let step = [cos * way[0] - sin * way[1], sin * way[0] + cos * way[1]];
        self.state[frame] += step[0];
        self.state[frame + 1] += step[1];
        self.state[frame + 2] += turn;
        [cos, sin, step[0], step[1]]
    }

    /// P ← (I + A) P (I + A)ᵀ with the rows of A that are not zero.
    fn apply_transition(&mut self, rows: &[(usize, SparseRow)]) {
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
    fn add_acceleration_noise(
        &mut self,
        dt: f32,
        variance: f32,
        [c, s, ..]: [f32; 4],
        [wc, ws, ..]: [f32; 4],
    ) {
        for (half, end) in discretize_white_noise(dt) {
            let along = [
                (half * c, half * s, half * wc, half * ws),
                (-half * s, half * c, -half * ws, half * wc),
            ];
            for (k, (x, y, way_x, way_y)) in along.into_iter().enumerate() {
                let vector = [
                    (POSE, x),
                    (POSE + 1, y),
                    (WHEEL_INCREMENT, way_x),
                    (WHEEL_INCREMENT + 1, way_y),
                    (TWIST + k, end),
                ];
                self.add_rank_one_noise(&vector, variance);
            }
        }
    }

    fn add_rank_one_noise(&mut self, vector: SparseRow, variance: f32) {
        for &(i, a) in vector {
            for &(j, b) in vector {
                self.covariance[i][j] += variance * a * b;
            }
        }
    }
}

/// White noise of density q moves by q (dt³/3, dt²/2; dt²/2, dt): a constant acceleration explains three quarters of the
/// way's variance, the rest is the way's own. Without it the twist would swing from sample to sample.
fn discretize_white_noise(dt: f32) -> [(f32, f32); 2] {
    [(0.5 * dt * dt, dt), (dt * dt / 12.0_f32.sqrt(), 0.0)]
}
