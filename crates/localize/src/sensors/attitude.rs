//! How does the robot lean, and where does it head by its inertial unit? A direction cosine matrix.
//!
//! minho2016 V.A: the gyro is integrated into the matrix, which is made orthogonal again, and its drift is corrected by
//! gravity and compass through a proportional and an integral part, whose integral is the gyro's bias.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frames::wrap_angle;
use crate::stamp::Stamp;

/// Standard gravity, m/s².
pub const GRAVITY: f32 = 9.806_65;

/// How the attitude is held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeConfig {
    /// Time in which gravity corrects the gyro's drift, seconds: longer than accelerations last.
    pub gravity_time_constant: f32,
    /// Time in which the compass corrects it, seconds.
    pub compass_time_constant: f32,
    /// Deviation of the felt force (without the wheels' acceleration) from gravity at which it no longer corrects, m/s².
    pub gravity_deviation_max: f32,
    /// After so long beyond it the attitude is taken from gravity anew, seconds: the robot was laid down.
    pub gravity_reset_time: f32,
    /// Do roll and pitch bend the frames' ground map? Else every frame's lean is found from its points alone.
    pub tilt_compensation: bool,
    /// The robot rests when its wheels stood still for so long, seconds.
    pub stationary_after: f32,
    /// A robot turning faster than this does not rest, degrees/s: more than a gyro's bias and noise.
    pub stationary_rate_max_deg: f32,
    /// Time in which the gyro's bias is taken over at rest, seconds.
    pub bias_time_constant: f32,
    /// An inertial unit that was silent for so long tells nothing, seconds.
    pub timeout: f32,
    /// Deviation of the compass from the gyro's heading that tells of iron or current nearby, degrees.
    pub compass_disturbance_deg: f32,
    /// After so long the compass is believed again, seconds: then the heading was wrong.
    pub compass_disturbance_timeout: f32,
    /// How well lean is known from frame to frame, degrees.
    pub tilt_std_deg: f32,
    /// Constant part of its error before it was compared with sights, degrees (0.1 m/s² of the accelerometer).
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

/// What was felt for so long tells within this part of that time.
const TIME_CONSTANT_AGE_SHARE: f32 = 0.25;
/// But not sooner, seconds: one sample's acceleration is no gravity.
const TIME_CONSTANT_MIN: f32 = 2.0;
/// The felt force is smoothed like the wheels' acceleration, whose ticks are coarse, seconds.
const FORCE_SMOOTHING_TIME: f32 = 0.05;

/// Attitude and the gyro's bias.
#[derive(Debug, Clone, PartialEq)]
pub struct Attitude {
    /// earth_from_robot: columns are the robot's axes; z is up.
    earth_from_robot: Matrix3<f32>,
    /// rad/s, robot frame.
    gyro_bias: Vector3<f32>,
    /// Felt force without the robot's motion, smoothed, m/s².
    smoothed_force: Vector3<f32>,
    /// For how long it has been anything but gravity, seconds.
    gravity_rejected_for: f32,
    /// For how long gravity has been felt, seconds; none before.
    aligned_for: Option<f32>,
    /// Smoothed deviation of the compass from the heading; none before it was heard.
    compass_deviation: Option<CompassDeviation>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct CompassDeviation {
    stamp: Stamp,
    deviation: f32,
    /// For so long beyond what is believed, seconds.
    disturbed_for: f32,
}

impl Default for Attitude {
    fn default() -> Self {
        Attitude {
            earth_from_robot: Matrix3::identity(),
            gyro_bias: Vector3::zeros(),
            smoothed_force: Vector3::zeros(),
            gravity_rejected_for: 0.0,
            aligned_for: None,
            compass_deviation: None,
        }
    }
}

impl Attitude {
    /// Up in the robot's frame.
    pub fn up(&self) -> Vector3<f32> {
        self.earth_from_robot.row(2).transpose()
    }

    /// Lean (a, b), radians: what the accelerometer's x and y feel of gravity (MATH.md 2, "Tilt").
    pub fn tilt(&self) -> [f32; 2] {
        let up = self.up();
        [up.x, up.y]
    }

    /// Roll (left side up), pitch (nose down) and yaw, radians: R = Rz(yaw) Ry(pitch) Rx(roll) (minho2016 eq. 10).
    pub fn roll_pitch_yaw(&self) -> [f32; 3] {
        let m = &self.earth_from_robot;
        [
            m[(2, 1)].atan2(m[(2, 2)]),
            -m[(2, 0)].clamp(-1.0, 1.0).asin(),
            m[(1, 0)].atan2(m[(0, 0)]),
        ]
    }

    /// The gyro's bias, rad/s, robot frame.
    pub fn gyro_bias(&self) -> [f32; 3] {
        self.gyro_bias.into()
    }

    /// Rate about the vertical, rad/s, bias not removed.
    pub fn yaw_rate(&self, rate: [f32; 3]) -> f32 {
        self.up().dot(&Vector3::from(rate))
    }

    /// Horizontal acceleration in the robot's frame: the felt force without gravity.
    pub fn remove_gravity(&self, force: [f32; 3]) -> [f32; 2] {
        let up = self.up();
        [force[0] - GRAVITY * up.x, force[1] - GRAVITY * up.y]
    }

    /// Turns on by a reading of the unit over `seconds`.
    ///
    /// `moving`: acceleration of the robot over the ground as the wheels tell it, m/s², robot frame.
    pub fn update_imu(
        &mut self,
        rate: [f32; 3],
        force: [f32; 3],
        moving: [f32; 2],
        seconds: f32,
        config: &AttitudeConfig,
    ) {
        let force = Vector3::new(force[0] - moving[0], force[1] - moving[1], force[2]);
        let share = 1.0 - (-seconds / FORCE_SMOOTHING_TIME).exp();
        self.smoothed_force = match self.aligned_for {
            Some(_) => self.smoothed_force + (force - self.smoothed_force) * share,
            None => force,
        };
        let size = self.smoothed_force.norm();
        if !(size > 0.1 * GRAVITY) {
            return;
        }
        let felt = self.smoothed_force / size;
        let Some(age) = self.aligned_for else {
            if (size - GRAVITY).abs() < config.gravity_deviation_max {
                self.align_to_gravity(&felt);
            }
            return;
        };
        // The gyro holds what leans quickly: what is left beyond is an acceleration that the wheels do not tell of.
        let off = (self.smoothed_force - self.up() * GRAVITY).norm();
        let weight = (1.0 - off / config.gravity_deviation_max).max(0.0);
        self.gravity_rejected_for = if weight > 0.0 {
            0.0
        } else {
            self.gravity_rejected_for + seconds
        };
        if self.gravity_rejected_for > config.gravity_reset_time {
            self.gravity_rejected_for = 0.0;
            self.align_to_gravity(&felt);
            return;
        }
        self.aligned_for = Some(age + seconds);
        // A gyro's bias of 0.3°/s would lean the robot by more than a degree before gravity told: sooner at first.
        let least = TIME_CONSTANT_MIN.min(config.gravity_time_constant);
        let time = (TIME_CONSTANT_AGE_SHARE * age).clamp(least, config.gravity_time_constant);
        let gain = weight / time;
        let error = felt.cross(&self.up());
        // Critically damped: the integral's gain is a quarter of the proportional one's square.
        self.gyro_bias -= error * (0.25 * gain / time * seconds);
        let turn = (Vector3::from(rate) - self.gyro_bias + error * gain) * seconds;
        self.integrate_rotation(&turn);
    }

    /// Takes the felt direction for up; the heading stays.
    fn align_to_gravity(&mut self, felt: &Vector3<f32>) {
        let yaw = self.roll_pitch_yaw()[2];
        let forward = Vector3::new(1.0, 0.0, 0.0);
        let ahead = (forward - felt * felt.x).normalize();
        let left = felt.cross(&ahead);
        // Rows: the earth's axes (turned back by the yaw) in the robot's frame.
        let level = Matrix3::from_rows(&[ahead.transpose(), left.transpose(), felt.transpose()]);
        let (sin, cos) = yaw.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        self.earth_from_robot = turn * level;
        self.aligned_for = Some(0.0);
    }

    /// R ← R (1 + [turn]×), made orthogonal again by half of what its rows lost to each other.
    fn integrate_rotation(&mut self, turn: &Vector3<f32>) {
        // The second order keeps a fast turn's length: 6 rad/s at 100 Hz would lose 0.2 % of it.
        let cross = turn.cross_matrix();
        self.earth_from_robot += self.earth_from_robot * (cross + cross * cross * 0.5);
        let (x, y) = (
            self.earth_from_robot.row(0).into_owned(),
            self.earth_from_robot.row(1).into_owned(),
        );
        let half = 0.5 * x.dot(&y);
        let (x, y) = ((x - y * half).normalize(), (y - x * half).normalize());
        self.earth_from_robot = Matrix3::from_rows(&[x, y, x.cross(&y)]);
    }

    /// The robot stands: what the gyro says for `seconds` is its bias.
    pub fn zero_rate_update(&mut self, rate: [f32; 3], seconds: f32, config: &AttitudeConfig) {
        let share = (seconds / config.bias_time_constant).min(1.0);
        self.gyro_bias += (Vector3::from(rate) - self.gyro_bias) * share;
    }

    /// Hears the compass; false if something nearby disturbs it.
    pub fn update_compass(&mut self, stamp: Stamp, heading: f32, config: &AttitudeConfig) -> bool {
        let yaw = self.roll_pitch_yaw()[2];
        let deviation = wrap_angle(heading - yaw);
        let Some(mut heard) = self.compass_deviation else {
            self.rotate_yaw(deviation);
            self.compass_deviation = Some(CompassDeviation {
                stamp,
                deviation: 0.0,
                disturbed_for: 0.0,
            });
            return true;
        };
        let seconds = (stamp - heard.stamp).clamp(0.0, 1.0) as f32;
        heard.stamp = stamp;
        // Noise averages out over a few tenths of a second.
        let share = 1.0 - (-seconds / 0.3).exp();
        heard.deviation += share * wrap_angle(deviation - heard.deviation);
        let disturbed = heard.deviation.abs() > config.compass_disturbance_deg.to_radians();
        if disturbed {
            heard.disturbed_for += seconds;
        } else {
            heard.disturbed_for = 0.0;
            let share = (seconds / config.compass_time_constant).min(1.0);
            self.gyro_bias -= self.up() * (0.25 * share * deviation / config.compass_time_constant);
            self.rotate_yaw(share * deviation);
        }
        if heard.disturbed_for > config.compass_disturbance_timeout {
            self.rotate_yaw(deviation);
            heard.deviation = 0.0;
            heard.disturbed_for = 0.0;
        }
        self.compass_deviation = Some(heard);
        !disturbed
    }

    /// Is the compass off the gyro's heading, as beside iron or a motor's current?
    pub fn compass_disturbed(&self) -> bool {
        self.compass_deviation
            .is_some_and(|heard| heard.disturbed_for > 0.0)
    }

    fn rotate_yaw(&mut self, angle: f32) {
        let (sin, cos) = angle.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        self.earth_from_robot = turn * self.earth_from_robot;
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
        let lean = 2f32.to_radians();
        let force = [lean.sin() * GRAVITY, 0.0, lean.cos() * GRAVITY];
        let bias = [0.01, -0.02, 0.0];
        feed_imu(&mut attitude, 240.0, bias, force);
        let [a, b] = attitude.tilt();
        assert!((a - lean.sin()).abs() < 1e-3 && b.abs() < 1e-3, "{a} {b}");
        for (found, bias) in attitude.gyro_bias().iter().zip(bias) {
            assert!((found - bias).abs() < 2e-3, "{found} {bias}");
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
        let mut noticed = None;
        for k in 0..400 {
            attitude.update_imu([0.0; 3], [0.0, 0.0, GRAVITY], [0.0; 2], DT, &config);
            let heading = if (100..300).contains(&k) { 1.0 } else { 0.1 };
            let stamp = Stamp(i64::from(k) * 10_000_000);
            if !attitude.update_compass(stamp, heading, &config) {
                noticed = noticed.or(Some(k));
            }
        }
        assert!(
            (100..140).contains(&noticed.expect("noticed")),
            "{noticed:?}"
        );
        let yaw = attitude.roll_pitch_yaw()[2];
        assert!(
            (yaw - 0.1).abs() < 0.06 && !attitude.compass_disturbed(),
            "{yaw}"
        );
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
