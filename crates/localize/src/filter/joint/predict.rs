//! Prediction of the joint filter: motion model f and its Jacobian F (docs/methods.md 8.2 and 8.3).
//!
//! Each step predicts the state, then P ← F P Fᵀ + Q. Q stands in `process_noise`.

use super::JointFilter;
use super::state::{
    ACCELEROMETER_BIAS, GYRO_BIAS, GYRO_SCALE, POSE, SLIP, TILT, TWIST, WHEEL_INCREMENT, YAW_RATE,
};
use crate::filter::{FilterConfig, ImuInterval, PredictionInput};
use crate::frames::wrap_angle;
use crate::math;
use crate::sensors::attitude::GRAVITY;

/// Time constant with which slip ends once the wheels grip, seconds: a few encoder periods.
const SLIP_DECAY_TIME: f32 = 0.03;
/// Time constant of the smoothed acceleration, seconds: longer than the wheels' vibration.
const ACCELERATION_SMOOTHING_TIME: f32 = 0.05;

/// A translation applied to a frame: direction of the frame, and the translation in the parent frame, metres.
pub(super) struct PlanarStep {
    pub(super) cos: f32,
    pub(super) sin: f32,
    dx: f32,
    dy: f32,
}

/// Slip in one step.
#[derive(Clone, Copy)]
pub(super) struct SlipModel {
    /// g_s of docs/methods.md 8.2: 0 if the wheels grip, 1 if they slide freely.
    pub(super) sliding: f32,
    /// Factor by which the slip velocity decayed.
    decay: f32,
}

impl SlipModel {
    /// Rows of F − I.
    fn jacobian(self) -> [[(usize, f32); 1]; 3] {
        [0, 1, 2].map(|k| [(SLIP + k, self.decay - 1.0)])
    }
}

/// Quantities of one step by the inertial unit that F and Q need.
pub(super) struct ImuStep {
    pub(super) dt: f32,
    /// Cosine and sine of the rotation φ.
    rotation: [f32; 2],
    /// Cosine and sine of φ/2.
    half_rotation: [f32; 2],
    /// Measured rotation, without scale and bias, radians.
    gyro_angle: f32,
    /// Measured yaw rate at the end, rad/s.
    gyro_yaw_rate: f32,
    pub(super) field_step: PlanarStep,
    pub(super) increment_step: PlanarStep,
    pub(super) slip: SlipModel,
}

impl JointFilter {
    pub(in crate::filter) fn predict(&mut self, input: &PredictionInput, config: &FilterConfig) {
        if !(input.dt > 0.0) {
            return;
        }
        if input.shock {
            self.collision.trigger(&config.collision);
        }
        self.collision.advance_time(input.dt);
        self.wheel_interval += input.dt;
        self.age_mate_errors(input.dt);
        self.imu_active = input.imu.is_some();
        match &input.imu {
            Some(imu) => {
                let step = self.predict_imu(imu, input.dt, config);
                self.propagate_imu(&step);
                self.add_imu_noise(imu, input, &step, config);
            }
            None => self.predict_constant_velocity(input.dt, config),
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        self.add_sensor_noise(input.dt, config);
    }

    /// f with an inertial unit (docs/methods.md 8.2).
    ///
    /// The gyro drives the heading directly. A random walk of the yaw rate would let slipping wheels outweigh the gyro.
    fn predict_imu(&mut self, imu: &ImuInterval, dt: f32, config: &FilterConfig) -> ImuStep {
        let s = &mut self.state;
        let acceleration: [f32; 2] = std::array::from_fn(|k| {
            imu.specific_force[k] - GRAVITY * s[TILT + k] - s[ACCELEROMETER_BIAS + k]
        });
        let angle = (s[GYRO_SCALE] * imu.mean_angular_velocity[2] - s[GYRO_BIAS + 2]) * dt;
        s[YAW_RATE] = s[GYRO_SCALE] * imu.final_yaw_rate - s[GYRO_BIAS + 2];
        let (sin, cos) = math::sin_cos(angle);
        let (half_sin, half_cos) = math::sin_cos(0.5 * angle);
        let (vx, vy) = (s[TWIST], s[TWIST + 1]);
        let half_dt_squared = 0.5 * dt * dt;
        let translation = [
            vx * dt + half_dt_squared * acceleration[0],
            vy * dt + half_dt_squared * acceleration[1],
        ];
        // v ← R(−φ) v + R(−φ/2) a dt
        let (ax, ay) = (acceleration[0] * dt, acceleration[1] * dt);
        s[TWIST] = cos * vx + sin * vy + half_cos * ax + half_sin * ay;
        s[TWIST + 1] = cos * vy - sin * vx + half_cos * ay - half_sin * ax;
        // The up direction rotates against the robot: u̇ = u × ω.
        let (a, b) = (s[TILT], s[TILT + 1]);
        s[TILT] = cos * a + sin * b - (imu.mean_angular_velocity[1] - s[GYRO_BIAS + 1]) * dt;
        s[TILT + 1] = cos * b - sin * a + (imu.mean_angular_velocity[0] - s[GYRO_BIAS]) * dt;
        ImuStep {
            dt,
            rotation: [cos, sin],
            half_rotation: [half_cos, half_sin],
            gyro_angle: imu.mean_angular_velocity[2] * dt,
            gyro_yaw_rate: imu.final_yaw_rate,
            field_step: self.integrate_step(POSE, translation, 0.0, angle),
            increment_step: self.integrate_step(WHEEL_INCREMENT, translation, 0.0, angle),
            slip: self.predict_slip(acceleration, dt, config),
        }
    }

    /// F with an inertial unit: the derivative of `predict_imu`.
    fn propagate_imu(&mut self, step: &ImuStep) {
        let ImuStep { dt, gyro_angle, .. } = *step;
        let ([cos, sin], [half_cos, half_sin]) = (step.rotation, step.half_rotation);
        let half = 0.5 * dt * dt;
        let half_gravity = half * GRAVITY;
        let position_rows = |heading: usize, step: &PlanarStep| {
            let PlanarStep {
                cos: c,
                sin: s,
                dx,
                dy,
            } = *step;
            [
                [
                    (heading, -dy),
                    (TWIST, c * dt),
                    (TWIST + 1, -s * dt),
                    (ACCELEROMETER_BIAS, -half * c),
                    (ACCELEROMETER_BIAS + 1, half * s),
                    (TILT, -half_gravity * c),
                    (TILT + 1, half_gravity * s),
                ],
                [
                    (heading, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (ACCELEROMETER_BIAS, -half * s),
                    (ACCELEROMETER_BIAS + 1, -half * c),
                    (TILT, -half_gravity * s),
                    (TILT + 1, -half_gravity * c),
                ],
            ]
        };
        let pose_rows = position_rows(POSE + 2, &step.field_step);
        let increment_rows = position_rows(WHEEL_INCREMENT + 2, &step.increment_step);
        let heading_row = [(GYRO_BIAS + 2, -dt), (GYRO_SCALE, gyro_angle)];
        let yaw_rate_row = [
            (YAW_RATE, -1.0),
            (GYRO_BIAS + 2, -1.0),
            (GYRO_SCALE, step.gyro_yaw_rate),
        ];
        // Velocity and tilt rotate with the robot frame, so the rotation's error changes them too.
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        let (a, b) = (self.state[TILT], self.state[TILT + 1]);
        let velocity_x_row = [
            (TWIST, cos - 1.0),
            (TWIST + 1, sin),
            (GYRO_BIAS + 2, -dt * vy),
            (GYRO_SCALE, gyro_angle * vy),
            (ACCELEROMETER_BIAS, -dt * half_cos),
            (ACCELEROMETER_BIAS + 1, -dt * half_sin),
            (TILT, -GRAVITY * dt * half_cos),
            (TILT + 1, -GRAVITY * dt * half_sin),
        ];
        let velocity_y_row = [
            (TWIST, -sin),
            (TWIST + 1, cos - 1.0),
            (GYRO_BIAS + 2, dt * vx),
            (GYRO_SCALE, -gyro_angle * vx),
            (ACCELEROMETER_BIAS, dt * half_sin),
            (ACCELEROMETER_BIAS + 1, -dt * half_cos),
            (TILT, GRAVITY * dt * half_sin),
            (TILT + 1, -GRAVITY * dt * half_cos),
        ];
        let tilt_x_row = [
            (TILT, cos - 1.0),
            (TILT + 1, sin),
            (GYRO_BIAS + 1, dt),
            (GYRO_BIAS + 2, -dt * b),
            (GYRO_SCALE, gyro_angle * b),
        ];
        let tilt_y_row = [
            (TILT, -sin),
            (TILT + 1, cos - 1.0),
            (GYRO_BIAS, -dt),
            (GYRO_BIAS + 2, dt * a),
            (GYRO_SCALE, -gyro_angle * a),
        ];
        let slip_rows = step.slip.jacobian();
        self.propagate_covariance(&[
            (POSE, &pose_rows[0]),
            (POSE + 1, &pose_rows[1]),
            (POSE + 2, &heading_row),
            (WHEEL_INCREMENT, &increment_rows[0]),
            (WHEEL_INCREMENT + 1, &increment_rows[1]),
            (WHEEL_INCREMENT + 2, &heading_row),
            (TWIST, &velocity_x_row),
            (TWIST + 1, &velocity_y_row),
            (YAW_RATE, &yaw_rate_row),
            (TILT, &tilt_x_row),
            (TILT + 1, &tilt_y_row),
            (SLIP, &slip_rows[0]),
            (SLIP + 1, &slip_rows[1]),
            (SLIP + 2, &slip_rows[2]),
        ]);
    }

    /// f, F and Q without an inertial unit (docs/methods.md 8.3): the twist is constant.
    fn predict_constant_velocity(&mut self, dt: f32, config: &FilterConfig) {
        self.relax_tilt_prior(dt, config);
        let slip_rows = self.predict_slip([0.0; 2], dt, config).jacobian();
        let angle = self.state[YAW_RATE] * dt;
        let translation = [self.state[TWIST] * dt, self.state[TWIST + 1] * dt];
        let field_step = self.integrate_step(POSE, translation, 0.5 * angle, angle);
        let increment_step = self.integrate_step(WHEEL_INCREMENT, translation, 0.5 * angle, angle);
        let position_rows = |heading: usize, step: &PlanarStep| {
            let PlanarStep {
                cos: c,
                sin: s,
                dx,
                dy,
            } = *step;
            [
                [
                    (heading, -dy),
                    (TWIST, c * dt),
                    (TWIST + 1, -s * dt),
                    (YAW_RATE, -0.5 * dt * dy),
                ],
                [
                    (heading, dx),
                    (TWIST, s * dt),
                    (TWIST + 1, c * dt),
                    (YAW_RATE, 0.5 * dt * dx),
                ],
            ]
        };
        let pose_rows = position_rows(POSE + 2, &field_step);
        let increment_rows = position_rows(WHEEL_INCREMENT + 2, &increment_step);
        let heading_row = [(YAW_RATE, dt)];
        self.propagate_covariance(&[
            (POSE, &pose_rows[0]),
            (POSE + 1, &pose_rows[1]),
            (POSE + 2, &heading_row),
            (WHEEL_INCREMENT, &increment_rows[0]),
            (WHEEL_INCREMENT + 1, &increment_rows[1]),
            (WHEEL_INCREMENT + 2, &heading_row),
            (SLIP, &slip_rows[0]),
            (SLIP + 1, &slip_rows[1]),
            (SLIP + 2, &slip_rows[2]),
        ]);
        self.add_constant_velocity_noise(dt, &field_step, &increment_step, config);
    }

    /// f of the slip velocity: it decays while the wheels grip.
    ///
    /// A sliding robot is accelerated by all the force that the carpet transmits. The wheels of a robot that hardly
    /// accelerates therefore grip.
    fn predict_slip(
        &mut self,
        acceleration: [f32; 2],
        dt: f32,
        config: &FilterConfig,
    ) -> SlipModel {
        let share = 1.0 - math::exp(-dt / ACCELERATION_SMOOTHING_TIME);
        for (smoothed, value) in self.smoothed_acceleration.iter_mut().zip(acceleration) {
            *smoothed += share * (value - *smoothed);
        }
        let [x, y] = self.smoothed_acceleration;
        let sliding = (math::hypot(x, y) / config.slip_acceleration)
            .min(1.0)
            .powi(2);
        let decay = math::exp(-dt * (1.0 - sliding) / SLIP_DECAY_TIME);
        for slip in &mut self.state[SLIP..SLIP + 3] {
            *slip *= decay;
        }
        SlipModel { sliding, decay }
    }

    /// Moves a frame (`POSE` or `WHEEL_INCREMENT`) by a translation in its own coordinates, rotated by `lead` radians
    /// against its heading, and rotates it by `angle`.
    fn integrate_step(
        &mut self,
        frame: usize,
        translation: [f32; 2],
        lead: f32,
        angle: f32,
    ) -> PlanarStep {
        let (sin, cos) = math::sin_cos(self.state[frame + 2] + lead);
        let dx = cos * translation[0] - sin * translation[1];
        let dy = sin * translation[0] + cos * translation[1];
        self.state[frame] += dx;
        self.state[frame + 1] += dy;
        self.state[frame + 2] += angle;
        PlanarStep { cos, sin, dx, dy }
    }
}
