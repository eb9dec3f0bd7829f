//! Which filter, and how far does it believe each witness?

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::decentralised::DecentralisedConfig;
use crate::collision::CollisionConfig;

/// Which filter fuses what the witnesses say?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fusion {
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
    pub fusion: Fusion,
    /// Random part of the way driven, metres per square root of a metre (slip on carpet).
    pub way_noise: f32,
    /// Random part of the heading per way driven, degrees per square root of a metre.
    pub heading_per_way_noise_deg: f32,
    /// Random part of the turn, radians per square root of a radian.
    pub turn_noise: f32,
    /// Unreported motion, metres per square root of a second.
    pub drift: f32,
    /// Unreported turning, degrees per square root of a second.
    pub drift_deg: f32,
    /// Acceleration at which wheels may slide freely, m/s²; at half of it they hardly do. Only an inertial unit tells it.
    pub slide_acceleration: f32,
    /// Standard deviation of odometry's scale before it was ever compared with sight; 0 trusts its scale.
    pub scale_std: f32,
    /// How fast the scales wander, per square root of a second (carpet direction, wear, load).
    pub scale_drift: f32,
    /// How fast the noise above is learnt from how far sights deviate from expectations, per frame; 0 keeps it as
    /// stated. 0.02 learns within some seconds.
    pub noise_learning: f32,
    /// Part of a matched pose's error that the next frames repeat (map, field, uneven light), metres: added to every
    /// frame's result, so that a thousand frames do not promise a tenth of a millimetre.
    pub sight_std: f32,
    /// The same of its heading, degrees.
    pub sight_std_deg: f32,
    /// How fast the twist changes unforeseen, m/s per square root of a second, while no inertial unit tells: so much that
    /// wheels alone say how it goes on.
    pub twist_noise: f32,
    /// The same of the turn, rad/s per square root of a second.
    pub spin_noise: f32,
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
    pub lean_std_deg: f32,
    /// How far the inertial unit is mounted aslant of the camera, degrees: constant, and found while driving.
    pub mount_std_deg: f32,
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
            fusion: Fusion::default(),
            way_noise: 0.02,
            heading_per_way_noise_deg: 0.7,
            turn_noise: 0.03,
            drift: 0.01,
            drift_deg: 0.6,
            slide_acceleration: 3.0,
            scale_std: 0.05,
            scale_drift: 0.0005,
            noise_learning: 0.02,
            sight_std: 0.0015,
            sight_std_deg: 0.04,
            twist_noise: 10.0,
            spin_noise: 20.0,
            gyro_noise_deg: 0.06,
            gyro_bias_std_deg: 1.0,
            gyro_scale_std: 0.02,
            gyro_bias_drift_deg: 0.005,
            accelerometer_noise: 0.05,
            accelerometer_bias_std: 0.2,
            accelerometer_bias_drift: 0.002,
            lean_std_deg: 0.45,
            mount_std_deg: 0.8,
            camera_latency: 0.0,
            camera_latency_std: 0.0,
            collision: CollisionConfig::default(),
            decentralised: DecentralisedConfig::default(),
        }
    }
}
