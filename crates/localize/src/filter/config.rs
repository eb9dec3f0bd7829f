//! Which filter, and how far does it believe each witness?

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::decentralised::DecentralisedConfig;
use crate::sensors::collision::CollisionConfig;

/// Which filter fuses what the witnesses say?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FilterKind {
    /// One filter over pose, twist, biases, scales and latency.
    #[default]
    Joint,
    /// A filter for vision, one for odometry, each corrected with the commanded motion, and a node that fuses them
    /// (minho2016 eqs 6–9).
    Decentralised,
}

/// How far each witness of the motion is believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    /// Which filter.
    pub kind: FilterKind,
    /// Random part of the way driven, metres per square root of a metre (slip on carpet).
    pub odometry_noise_per_metre: f32,
    /// Random part of the heading per way driven, degrees per square root of a metre.
    pub heading_noise_per_metre_deg: f32,
    /// Random part of the turn, radians per square root of a radian.
    pub heading_noise_per_radian: f32,
    /// Unreported motion, metres per square root of a second.
    pub odometry_drift: f32,
    /// Unreported turning, degrees per square root of a second.
    pub odometry_drift_deg: f32,
    /// Acceleration at which wheels may slide freely, m/s²; at half of it they hardly do. Only an inertial unit tells it.
    pub slip_acceleration: f32,
    /// Standard deviation of odometry's scale before it was ever compared with sight; 0 trusts its scale.
    pub odometry_scale_std: f32,
    /// How fast the scales wander, per square root of a second (carpet direction, wear, load).
    pub odometry_scale_drift: f32,
    /// How fast the noise above is learnt from how far sights deviate from expectations, per frame; 0 keeps it as
    /// stated. 0.02 learns within some seconds.
    pub noise_adaptation_rate: f32,
    /// Part of a matched pose's error that the next frames repeat (map, field, uneven light), metres: added to every
    /// frame's result, so that a thousand frames do not promise a tenth of a millimetre.
    pub systematic_position_std: f32,
    /// The same of its heading, degrees.
    pub systematic_heading_std_deg: f32,
    /// How fast the twist changes unforeseen, m/s per square root of a second, while no inertial unit tells: so much that
    /// wheels alone say how it goes on.
    pub velocity_process_noise: f32,
    /// The same of the turn, rad/s per square root of a second.
    pub yaw_rate_process_noise: f32,
    /// Noise of the gyro, degrees per square root of a second; twice a cheap unit's, for vibration.
    pub gyro_noise_deg: f32,
    /// The gyro's bias before it was ever compared, degrees/s.
    pub gyro_bias_std_deg: f32,
    /// How fast it wanders (warmth), degrees/s per square root of a second.
    pub gyro_bias_drift_deg: f32,
    /// How far the gyro's scale about the vertical may be off before it was ever compared, 1.
    pub gyro_scale_std: f32,
    /// Noise of the accelerometer, m/s per square root of a second: three times a cheap unit's 0.015; how it
    /// rattles is watched and comes on top.
    pub accelerometer_noise: f32,
    /// Its bias before it was ever compared, m/s².
    pub accelerometer_bias_std: f32,
    /// How fast that wanders (warmth), m/s² per square root of a second.
    pub accelerometer_bias_drift: f32,
    /// How far robots lean (one sigma, each direction) before anything was seen of it, degrees.
    pub tilt_std_deg: f32,
    /// How far the inertial unit is mounted aslant of the camera, degrees: constant, and found while driving.
    pub imu_mount_std_deg: f32,
    /// Time from the exposure of a frame to its stamp, seconds; 0 where stamps are those of the exposure.
    pub camera_latency: f32,
    /// How far `camera_latency` may be off, seconds: it is then estimated while driving; 0 takes it as stated.
    pub camera_latency_std: f32,
    /// When wheels are not believed.
    pub collision: CollisionConfig,
    /// The members of the decentralised filter.
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
            odometry_scale_drift: 0.0005,
            noise_adaptation_rate: 0.02,
            systematic_position_std: 0.0015,
            systematic_heading_std_deg: 0.04,
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
