//! What disturbs a drive, and which estimators are scored on it?

use serde::{Deserialize, Serialize};

/// Disturbances of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Disturbance {
    /// Waypoints at up to 2 m/s, wheels 3 % smaller than configured.
    Plain,
    /// Plain, with motors stronger than the wheels' traction.
    Slip,
    /// Plain, with a push every five seconds that the wheels do not measure.
    Hits,
    /// Plain, with a varying tilt of 0.45° (standard deviation) about each axis.
    Lean,
    /// Plain, without line points for two of every eight seconds.
    Blind,
    /// Blind, with wheels of unequal radius, which turn a straight drive into an arc.
    UnequalWheels,
    /// Slip, pushes, tilt, vision loss and unequal wheels together.
    All,
    /// 3 m/s, images stamped 80 ms after their exposure, with this latency configured.
    Late,
    /// Late, with a configured latency of zero.
    UnknownLatency,
}

impl Disturbance {
    /// All, in the order of the table.
    pub const ALL: [Disturbance; 9] = [
        Disturbance::Plain,
        Disturbance::Slip,
        Disturbance::Hits,
        Disturbance::Lean,
        Disturbance::Blind,
        Disturbance::UnequalWheels,
        Disturbance::All,
        Disturbance::Late,
        Disturbance::UnknownLatency,
    ];
}

/// How the pose is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// The joint filter with all sensors.
    Joint,
    /// The decentralised filters of minho2016 with all sensors.
    Decentralised,
    /// The joint filter without inertial unit.
    NoImu,
    /// The joint filter without wheels.
    NoOdometry,
    /// Each image alone, with the compass.
    Vision,
    /// Dead reckoning by the wheels, from the true start.
    Odometry,
}

impl Estimator {
    /// All, in the order of the table.
    pub const ALL: [Estimator; 6] = [
        Estimator::Joint,
        Estimator::Decentralised,
        Estimator::NoImu,
        Estimator::NoOdometry,
        Estimator::Vision,
        Estimator::Odometry,
    ];
}
