//! Attitude from the inertial unit: a direction cosine matrix corrected by gravity and compass (docs/methods.md 7.3).
//!
//! minho2016 V.A: the gyro is integrated into the matrix, which is then re-orthogonalised. A proportional and an integral
//! term correct its drift. The integral is the gyro bias.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frames::wrap_angle;
use crate::math;
use crate::stamp::Stamp;

/// Standard gravity, m/s².
pub const GRAVITY: f32 = 9.806_65;

/// Settings of the attitude estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeConfig {
    /// Time constant of the correction by gravity, seconds. It must exceed the duration of accelerations.
    pub gravity_time_constant: f32,
    /// Time constant of the correction by the compass, seconds.
    pub compass_time_constant: f32,
    /// Deviation of the measured force from gravity beyond which it is not used, m/s². The acceleration of the wheels
    /// is subtracted first.
    pub gravity_deviation_max: f32,
    /// Duration of such a deviation after which the attitude is reset from gravity, seconds (the robot was laid down).
    pub gravity_reset_time: f32,
    /// True compensates line points for the measured tilt. False estimates the tilt of each image from its points
    /// alone.
    pub tilt_compensation: bool,
    /// Time without wheel motion after which the robot counts as stationary, seconds.
    pub stationary_after: f32,
    /// Largest angular rate of a stationary robot, degrees/s. It must exceed the bias and noise of the gyro.
    pub stationary_rate_max_deg: f32,
    /// Time constant of the gyro bias estimate at rest, seconds.
    pub bias_time_constant: f32,
    /// Age of the last reading at which the inertial unit counts as inactive, seconds.
    pub timeout: f32,
    /// Deviation of the compass from the gyro's heading that indicates iron or a current nearby, degrees.
    pub compass_disturbance_deg: f32,
    /// Duration of such a disturbance after which the yaw is set from the compass, seconds.
    pub compass_disturbance_timeout: f32,
    /// Smallest standard deviation of the measured tilt from image to image, degrees.
    pub tilt_std_deg: f32,
    /// Initial standard deviation of the tilt's constant error, degrees (0.1 m/s² of the accelerometer).
    pub tilt_bias_std_deg: f32,
}

impl Default for AttitudeConfig {
    fn default() -> Self {
        AttitudeConfig {
            gravity_time_constant: 8.0,
            compass_time_constant: 5.0,
            gravity_deviation_max: 1.0,
            gravity_reset_time: 10.0,
            tilt_compensation: true,
            stationary_after: 0.3,
            stationary_rate_max_deg: 3.0,
            bias_time_constant: 1.0,
            timeout: 0.1,
            compass_disturbance_deg: 25.0,
            compass_disturbance_timeout: 20.0,
            tilt_std_deg: 0.3,
            tilt_bias_std_deg: 0.8,
        }
    }
}

/// The gravity correction's time constant as a share of the time since alignment.
const TIME_CONSTANT_AGE_SHARE: f32 = 0.25;
/// Smallest time constant of the gravity correction, seconds.
const TIME_CONSTANT_MIN: f32 = 2.0;
/// Smoothing of the measured force without the wheels' acceleration, twice, seconds. The second difference of coarse or noisy wheel
/// samples is tens of m/s².
const FORCE_SMOOTHING_TIME: f32 = 0.15;
/// Deviation of the first force from that of an upright robot up to which it is gravity, m/s² (2 degrees). Beyond it the robot may
/// accelerate, and is taken to be upright.
const UPRIGHT_DEVIATION_MAX: f32 = 0.35;
/// Smoothing of the compass deviation, seconds.
const COMPASS_SMOOTHING_TIME: f32 = 0.3;

/// Attitude and gyro bias.
#[derive(Debug, Clone, PartialEq)]
pub struct Attitude {
    /// Columns are the robot's axes in the earth frame; z is up.
    earth_from_robot: Matrix3<f32>,
    /// rad/s, robot frame.
    gyro_bias: Vector3<f32>,
    /// Measured force without the robot's own acceleration, smoothed once and twice, robot frame, m/s².
    smoothed_force: [Vector3<f32>; 2],
    /// Time for which the force has not been gravity, seconds.
    gravity_rejected_for: f32,
    /// Time since the alignment to gravity, seconds. None before it.
    aligned_for: Option<f32>,
    /// None before the first compass reading.
    compass_deviation: Option<CompassDeviation>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct CompassDeviation {
    stamp: Stamp,
    /// Smoothed deviation from the yaw, radians.
    deviation: f32,
    /// Time beyond the limit, seconds.
    disturbed_for: f32,
}

impl Default for Attitude {
    fn default() -> Self {
        Attitude {
            earth_from_robot: Matrix3::identity(),
            gyro_bias: Vector3::zeros(),
            smoothed_force: [Vector3::zeros(); 2],
            gravity_rejected_for: 0.0,
            aligned_for: None,
            compass_deviation: None,
        }
    }
}

impl Attitude {
    /// Up direction, robot frame.
    pub fn up(&self) -> Vector3<f32> {
        self.earth_from_robot.row(2).transpose()
    }

    /// Tilt (a, b), radians: x and y of the up direction (docs/methods.md 3.1).
    pub fn tilt(&self) -> [f32; 2] {
        let up = self.up();
        [up.x, up.y]
    }

    /// Roll (left side up), pitch (nose down) and yaw, radians: R = Rz(yaw) Ry(pitch) Rx(roll).
    ///
    /// minho2016 eq. 10 uses proper Euler angles (docs/methods.md 7.3).
    pub fn roll_pitch_yaw(&self) -> [f32; 3] {
        let m = &self.earth_from_robot;
        [
            math::atan2(m[(2, 1)], m[(2, 2)]),
            -math::asin(m[(2, 0)].clamp(-1.0, 1.0)),
            math::atan2(m[(1, 0)], m[(0, 0)]),
        ]
    }

    /// Gyro bias, rad/s, robot frame.
    pub fn gyro_bias(&self) -> [f32; 3] {
        self.gyro_bias.into()
    }

    /// Horizontal acceleration, robot frame: the measured force without gravity, m/s².
    pub fn remove_gravity(&self, force: [f32; 3]) -> [f32; 2] {
        let up = self.up();
        [force[0] - GRAVITY * up.x, force[1] - GRAVITY * up.y]
    }

    /// Integrates a reading of the inertial unit over `seconds`.
    ///
    /// `wheel_acceleration`: acceleration over the ground by the wheels, m/s², robot frame.
    pub fn update_imu(
        &mut self,
        rate: [f32; 3],
        force: [f32; 3],
        wheel_acceleration: [f32; 2],
        seconds: f32,
        config: &AttitudeConfig,
    ) {
        let force = Vector3::new(
            force[0] - wheel_acceleration[0],
            force[1] - wheel_acceleration[1],
            force[2],
        );
        let Some(age) = self.aligned_for else {
            self.start(force);
            return;
        };
        self.smooth_force(force, rate, seconds);
        let force = self.smoothed_force[1];
        let magnitude = force.norm();
        if !(magnitude > 0.1 * GRAVITY) {
            return;
        }
        let measured_up = force / magnitude;
        // The gyro follows fast tilts. The remaining deviation is an acceleration that the wheels do not measure.
        let deviation = (force - self.up() * GRAVITY).norm();
        let weight = (1.0 - deviation / config.gravity_deviation_max).max(0.0);
        self.gravity_rejected_for = if weight > 0.0 {
            0.0
        } else {
            self.gravity_rejected_for + seconds
        };
        if self.gravity_rejected_for > config.gravity_reset_time {
            self.gravity_rejected_for = 0.0;
            self.align_to_gravity(&measured_up);
            return;
        }
        self.aligned_for = Some(age + seconds);
        // Shorter at first: a gyro bias of 0.3°/s would otherwise tilt the attitude by more than a degree.
        let time_min = TIME_CONSTANT_MIN.min(config.gravity_time_constant);
        let time = (TIME_CONSTANT_AGE_SHARE * age).clamp(time_min, config.gravity_time_constant);
        let gain = weight / time;
        let error = measured_up.cross(&self.up());
        // Critically damped: the integral gain is a quarter of the proportional gain's square.
        self.gyro_bias -= error * (0.25 * gain / time * seconds);
        let rotation = (Vector3::from(rate) - self.gyro_bias + error * gain) * seconds;
        self.integrate_rotation(&rotation);
    }

    /// Starts from the first measured force.
    fn start(&mut self, force: Vector3<f32>) {
        self.smoothed_force = [force; 2];
        let upright = Vector3::new(0.0, 0.0, GRAVITY);
        if (force - upright).norm() < UPRIGHT_DEVIATION_MAX {
            self.align_to_gravity(&force.normalize());
        }
        self.aligned_for = Some(0.0);
    }

    fn smooth_force(&mut self, force: Vector3<f32>, rate: [f32; 3], seconds: f32) {
        let share = 1.0 - math::exp(-seconds / FORCE_SMOOTHING_TIME);
        let turn = (Vector3::from(rate) - self.gyro_bias) * seconds;
        let mut input = force;
        for smoothed in &mut self.smoothed_force {
            // What was measured before, in the axes of the robot that has turned since.
            *smoothed -= turn.cross(smoothed);
            *smoothed += (input - *smoothed) * share;
            input = *smoothed;
        }
    }

    /// Sets the up direction and keeps the heading.
    fn align_to_gravity(&mut self, up: &Vector3<f32>) {
        let yaw = self.roll_pitch_yaw()[2];
        let forward = Vector3::new(1.0, 0.0, 0.0);
        let ahead = (forward - up * up.x).normalize();
        let left = up.cross(&ahead);
        // Rows: the earth's axes (rotated back by the yaw) in the robot frame.
        let level = Matrix3::from_rows(&[ahead.transpose(), left.transpose(), up.transpose()]);
        let (sin, cos) = math::sin_cos(yaw);
        let rotation = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        self.earth_from_robot = rotation * level;
        self.aligned_for = Some(0.0);
    }

    /// R ← R (1 + [φ]× + ½ [φ]×²), then re-orthogonalised.
    fn integrate_rotation(&mut self, rotation: &Vector3<f32>) {
        // Without the second order, 6 rad/s at 100 Hz would lose 0.2 % of the rotation.
        let cross = rotation.cross_matrix();
        self.earth_from_robot += self.earth_from_robot * (cross + cross * cross * 0.5);
        let (x, y) = (
            self.earth_from_robot.row(0).into_owned(),
            self.earth_from_robot.row(1).into_owned(),
        );
        let half_error = 0.5 * x.dot(&y);
        let (x, y) = (
            (x - y * half_error).normalize(),
            (y - x * half_error).normalize(),
        );
        self.earth_from_robot = Matrix3::from_rows(&[x, y, x.cross(&y)]);
    }

    /// Updates the gyro bias by a reading of a stationary robot over `seconds`.
    pub fn zero_rate_update(&mut self, rate: [f32; 3], seconds: f32, config: &AttitudeConfig) {
        let share = (seconds / config.bias_time_constant).min(1.0);
        self.gyro_bias += (Vector3::from(rate) - self.gyro_bias) * share;
    }

    /// Corrects the yaw by a compass reading. Returns false if the compass is disturbed.
    pub fn update_compass(&mut self, stamp: Stamp, heading: f32, config: &AttitudeConfig) -> bool {
        let yaw = self.roll_pitch_yaw()[2];
        let deviation = wrap_angle(heading - yaw);
        let Some(mut compass) = self.compass_deviation else {
            self.rotate_yaw(deviation);
            self.compass_deviation = Some(CompassDeviation {
                stamp,
                deviation: 0.0,
                disturbed_for: 0.0,
            });
            return true;
        };
        let seconds = (stamp - compass.stamp).clamp(0.0, 1.0) as f32;
        compass.stamp = stamp;
        let share = 1.0 - math::exp(-seconds / COMPASS_SMOOTHING_TIME);
        compass.deviation += share * wrap_angle(deviation - compass.deviation);
        let disturbed = compass.deviation.abs() > config.compass_disturbance_deg.to_radians();
        if disturbed {
            compass.disturbed_for += seconds;
        } else {
            compass.disturbed_for = 0.0;
            let share = (seconds / config.compass_time_constant).min(1.0);
            self.gyro_bias -= self.up() * (0.25 * share * deviation / config.compass_time_constant);
            self.rotate_yaw(share * deviation);
        }
        if compass.disturbed_for > config.compass_disturbance_timeout {
            self.rotate_yaw(deviation);
            compass.deviation = 0.0;
            compass.disturbed_for = 0.0;
        }
        self.compass_deviation = Some(compass);
        !disturbed
    }

    fn rotate_yaw(&mut self, angle: f32) {
        let (sin, cos) = math::sin_cos(angle);
        let rotation = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        self.earth_from_robot = rotation * self.earth_from_robot;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 0.01;

    fn feed_imu(attitude: &mut Attitude, seconds: f32, rate: [f32; 3], force: [f32; 3]) {
        let config = AttitudeConfig::default();
        for _ in 0..(seconds / DT) as usize {
            attitude.update_imu(rate, force, [0.0; 2], DT, &config);
        }
    }

    #[test]
    fn gravity_aligns_attitude_and_reveals_gyro_bias() {
        let mut attitude = Attitude::default();
        let tilt = 2f32.to_radians();
        let force = [tilt.sin() * GRAVITY, 0.0, tilt.cos() * GRAVITY];
        let bias = [0.01, -0.02, 0.0];
        feed_imu(&mut attitude, 240.0, bias, force);
        let [a, b] = attitude.tilt();
        assert!((a - tilt.sin()).abs() < 1e-3 && b.abs() < 1e-3, "{a} {b}");
        for (estimated, bias) in attitude.gyro_bias().iter().zip(bias) {
            assert!((estimated - bias).abs() < 2e-3, "{estimated} {bias}");
        }
    }

    #[test]
    fn acceleration_at_the_start_is_no_tilt() {
        let mut attitude = Attitude::default();
        // The magnitude deviates from gravity by 0.3 m/s² only; as a tilt it would be 14 degrees.
        feed_imu(&mut attitude, 0.5, [0.0; 3], [2.5, 0.0, GRAVITY]);
        feed_imu(&mut attitude, 0.5, [0.0; 3], [0.0, 0.0, GRAVITY]);
        let [a, b] = attitude.tilt().map(f32::to_degrees);
        assert!(a.abs() < 1.0 && b.abs() < 1.0, "{a} {b}");
    }

    #[test]
    fn coarse_encoders_do_not_tilt_the_robot() {
        let config = AttitudeConfig::default();
        let mut attitude = Attitude::default();
        // Steps of 1 cm in one of two intervals of 20 ms: second differences of 25 m/s², three times as long as rejected forces
        // are tolerated.
        for step in 0..3000 {
            let acceleration = if step / 2 % 2 == 0 { 25.0 } else { -25.0 };
            attitude.update_imu(
                [0.0; 3],
                [0.0, 0.0, GRAVITY],
                [acceleration, 0.0],
                DT,
                &config,
            );
            let [a, b] = attitude.tilt().map(f32::to_degrees);
            assert!(a.abs() < 1.0 && b.abs() < 1.0, "{step}: {a} {b}");
        }
    }

    #[test]
    fn gyro_tracks_fast_pitch_before_gravity_corrects() {
        let mut attitude = Attitude::default();
        feed_imu(&mut attitude, 0.1, [0.0; 3], [0.0, 0.0, GRAVITY]);
        // Nose down by 3° within 0.1 s: positive about y.
        let rate = 3f32.to_radians() / 0.1;
        let config = AttitudeConfig::default();
        for _ in 0..10 {
            attitude.update_imu([0.0, rate, 0.0], [0.0, 0.0, GRAVITY], [0.0; 2], DT, &config);
        }
        let [_, pitch, _] = attitude.roll_pitch_yaw();
        assert!((pitch.to_degrees() - 3.0).abs() < 0.1, "{pitch}");
        assert!((attitude.tilt()[0] + 3f32.to_radians().sin()).abs() < 2e-3);
    }

    #[test]
    fn rotation_matrix_stays_orthonormal_over_ten_turns() {
        let mut attitude = Attitude::default();
        feed_imu(&mut attitude, 0.1, [0.0; 3], [0.0, 0.0, GRAVITY]);
        feed_imu(
            &mut attitude,
            std::f32::consts::TAU * 10.0 / 6.0,
            [0.0, 0.0, 6.0],
            [0.0, 0.0, GRAVITY],
        );
        let m = attitude.earth_from_robot;
        assert!((m * m.transpose() - Matrix3::identity()).norm() < 1e-4);
        let yaw = attitude.roll_pitch_yaw()[2];
        assert!(yaw.abs() < 0.1, "{yaw}");
    }

    #[test]
    fn disturbed_compass_is_detected_and_does_not_change_yaw() {
        let config = AttitudeConfig::default();
        let mut attitude = Attitude::default();
        let mut detected = None;
        let mut accepted = false;
        for k in 0..400 {
            attitude.update_imu([0.0; 3], [0.0, 0.0, GRAVITY], [0.0; 2], DT, &config);
            let heading = if (100..300).contains(&k) { 1.0 } else { 0.1 };
            let stamp = Stamp(i64::from(k) * 10_000_000);
            accepted = attitude.update_compass(stamp, heading, &config);
            if !accepted {
                detected = detected.or(Some(k));
            }
        }
        assert!(
            (100..140).contains(&detected.expect("disturbance detected")),
            "{detected:?}"
        );
        let yaw = attitude.roll_pitch_yaw()[2];
        assert!((yaw - 0.1).abs() < 0.06 && accepted, "{yaw}");
    }

    #[test]
    fn zero_rate_updates_estimate_gyro_bias_within_seconds() {
        let config = AttitudeConfig::default();
        let mut attitude = Attitude::default();
        for _ in 0..500 {
            attitude.zero_rate_update([0.003, -0.002, 0.005], DT, &config);
        }
        assert!((attitude.gyro_bias()[2] - 0.005).abs() < 1e-4);
    }
}
