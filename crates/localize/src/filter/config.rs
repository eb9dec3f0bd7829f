//! Settings of the pose filters.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math;
use crate::sensors::collision::CollisionConfig;

/// Kind of pose filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FilterKind {
    /// One filter over pose, twist, biases, scales and latency (docs/methods.md 8.1).
    #[default]
    Joint,
    /// One filter for vision and one for odometry, both predicted with the commanded motion, and a node that fuses them
    /// (minho2016 eqs 6 to 9).
    Decentralised,
    /// Odometry, corrected by each match as far as the curvature of its error function allows (nubot2013 4).
    Curvature,
}

/// Noise of each motion sensor and of the prediction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    /// Kind of pose filter.
    pub kind: FilterKind,
    /// Random walk of the position per distance driven, metres per square root of a metre (slip on carpet). A larger
    /// value trusts vision more.
    pub odometry_noise_per_metre: f32,
    /// Random walk of the heading per distance driven, degrees per square root of a metre.
    pub heading_noise_per_metre_deg: f32,
    /// Random walk of the heading per rotation, radians per square root of a radian.
    pub heading_noise_per_radian: f32,
    /// Random walk of the position that the wheels do not measure, metres per square root of a second.
    pub odometry_drift: f32,
    /// Random walk of the heading that the wheels do not measure, degrees per square root of a second.
    pub odometry_drift_deg: f32,
    /// Acceleration at which the wheels slide freely, m/s². At half of it they slide by a quarter. Requires an inertial
    /// unit.
    pub slip_acceleration: f32,
    /// Initial standard deviation of the odometry scales. 0 fixes the odometry's correction at 1 (docs/methods.md 8.5).
    pub odometry_scale_std: f32,
    /// Initial standard deviation of the couplings between the wheels' x, y and θ (wheels of unequal radius, a forward
    /// direction that is off), as a share at 0.25 m from the centre. 0 estimates scales alone.
    pub odometry_coupling_std: f32,
    /// Random walk of the scales, per square root of a second (carpet direction, wear, load); couplings in proportion.
    pub odometry_scale_drift: f32,
    /// Initial standard deviation of the logarithm of each wheel noise variance (docs/methods.md 8.8): 0.8 stands for a
    /// factor of 1.5 in the noise. 0 keeps the configured noise.
    pub noise_learning_std: f32,
    /// Random walk of the velocity without an inertial unit, m/s per square root of a second. Large, so that the wheels
    /// determine the velocity.
    pub velocity_process_noise: f32,
    /// Random walk of the yaw rate without an inertial unit, rad/s per square root of a second.
    pub yaw_rate_process_noise: f32,
    /// Gyro noise, degrees per square root of a second. Twice that of a low-cost unit, for vibration.
    pub gyro_noise_deg: f32,
    /// Initial standard deviation of the gyro bias, degrees/s.
    pub gyro_bias_std_deg: f32,
    /// Random walk of the gyro bias (temperature), degrees/s per square root of a second.
    pub gyro_bias_drift_deg: f32,
    /// Initial standard deviation of the gyro scale about z.
    pub gyro_scale_std: f32,
    /// Accelerometer noise, m/s per square root of a second. Three times the 0.015 of a low-cost unit; the measured
    /// vibration is added.
    pub accelerometer_noise: f32,
    /// Initial standard deviation of the accelerometer bias, m/s².
    pub accelerometer_bias_std: f32,
    /// Random walk of the accelerometer bias (temperature), m/s² per square root of a second.
    pub accelerometer_bias_drift: f32,
    /// Standard deviation of the tilt of a stationary robot, per axis, degrees.
    pub tilt_std_deg: f32,
    /// Standard deviation of the constant tilt of the inertial unit relative to the camera, degrees. It is estimated
    /// while driving.
    pub imu_mount_std_deg: f32,
    /// Time from the exposure of an image to its stamp, seconds. 0 if the stamp is the time of exposure.
    pub camera_latency: f32,
    /// Standard deviation of `camera_latency`, seconds. 0 fixes the latency; above 0 it is estimated while driving.
    pub camera_latency_std: f32,
    /// Limits of the collision detector.
    pub collision: CollisionConfig,
    /// Settings of the decentralised filter.
    pub decentralised: DecentralisedConfig,
}

impl Default for FilterConfig {
    fn default() -> Self {
        FilterConfig {
            kind: FilterKind::default(),
            odometry_noise_per_metre: 0.02,
            heading_noise_per_metre_deg: 0.7,
            heading_noise_per_radian: 0.03,
            odometry_drift: 0.01,
            odometry_drift_deg: 0.6,
            slip_acceleration: 3.0,
            odometry_scale_std: 0.05,
            odometry_coupling_std: 0.02,
            odometry_scale_drift: 0.0005,
            noise_learning_std: 2.2,
            velocity_process_noise: 10.0,
            yaw_rate_process_noise: 20.0,
            gyro_noise_deg: 0.06,
            gyro_bias_std_deg: 1.0,
            gyro_scale_std: 0.02,
            gyro_bias_drift_deg: 0.005,
            accelerometer_noise: 0.05,
            accelerometer_bias_std: 0.2,
            accelerometer_bias_drift: 0.002,
            tilt_std_deg: 0.45,
            imu_mount_std_deg: 0.8,
            camera_latency: 0.0,
            camera_latency_std: 0.0,
            collision: CollisionConfig::default(),
            decentralised: DecentralisedConfig::default(),
        }
    }
}

/// Settings of the papers' filters: noise of the commanded motion, timeout and scale of the wheels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DecentralisedConfig {
    /// Standard deviation of the commanded motion, as a share of it (motors lag, wheels slip).
    pub command_noise: f32,
    /// Random walk of the position at rest, metres per square root of a second.
    pub command_drift: f32,
    /// Random walk of the heading at rest, degrees per square root of a second.
    pub command_drift_deg: f32,
    /// Age of the last wheel sample at which odometry is no longer a member, seconds.
    pub wheel_timeout: f32,
    /// Standard deviation of the odometry scales, which this filter and the curvature filter do not estimate. It enters
    /// the covariance.
    pub scale_std: f32,
}

impl Default for DecentralisedConfig {
    fn default() -> Self {
        DecentralisedConfig {
            command_noise: 0.3,
            command_drift: 0.05,
            command_drift_deg: 3.0,
            wheel_timeout: 0.2,
            scale_std: 0.03,
        }
    }
}

/// Variances of a motion measured by the wheels: terms of time, of length and of length squared.
pub(super) struct WheelNoise {
    /// Along the motion and across it, m².
    pub(super) position: [f32; 3],
    /// rad².
    pub(super) heading: [f32; 3],
}

/// Error of each increment as a share of it, for wheels whose errors do not average out within an increment.
const INCREMENT_ERROR_SHARE: f32 = 0.04;
/// Rotation that comes with such an error of the length, radians per metre.
const INCREMENT_ROTATION: f32 = 0.02;

impl FilterConfig {
    /// Noise of the wheels over a motion (metres, metres, radians) of `seconds`, without slip (docs/methods.md 8.5).
    pub(super) fn wheel_noise(&self, [dx, dy, dtheta]: [f32; 3], seconds: f32) -> WheelNoise {
        let length = math::hypot(dx, dy);
        let squared = |value: f32| value * value;
        WheelNoise {
            position: [
                squared(self.odometry_drift) * seconds,
                squared(self.odometry_noise_per_metre) * length,
                squared(INCREMENT_ERROR_SHARE * length),
            ],
            heading: [
                squared(self.odometry_drift_deg.to_radians()) * seconds,
                squared(self.heading_noise_per_metre_deg.to_radians()) * length
                    + squared(self.heading_noise_per_radian) * dtheta.abs(),
                squared(INCREMENT_ERROR_SHARE * dtheta) + squared(INCREMENT_ROTATION * length),
            ],
        }
    }
}
