//! How are world and team encoded? The messages of `wire` that world model and team model fill.

use foxglove::Encode;

use super::wire_geometry::Pose;

/// `localize::world::FieldState`: field frame; position in metres, velocity in m/s, covariance row by row.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct OnField {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) velocity_x: f32,
    #[prost(float, required)]
    pub(crate) velocity_y: f32,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
}

/// `localize::world::TrackedObject`: robot frame; position in metres, velocity in m/s, covariance row by row.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Object {
    #[prost(uint32)]
    pub(crate) id: u32,
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) velocity_x: f32,
    #[prost(float, required)]
    pub(crate) velocity_y: f32,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(message, optional)]
    pub(crate) on_field: Option<OnField>,
    #[prost(float, required)]
    pub(crate) probability: f32,
    #[prost(sint64)]
    pub(crate) seen_ns: i64,
    #[prost(string)]
    pub(crate) team: String,
}

/// `localize::world::WorldView`: ball and robots around the robot.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct WorldView {
    #[prost(message, optional)]
    pub(crate) ball: Option<Object>,
    #[prost(message, repeated)]
    pub(crate) robots: Vec<Object>,
}

/// `localize::team::TeamReport`: a teammate's message; times by our clock.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct TeamReport {
    #[prost(uint32)]
    pub(crate) robot: u32,
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(message, optional)]
    pub(crate) pose: Option<Pose>,
    /// Standard deviations of x, y and θ.
    #[prost(float, repeated)]
    pub(crate) pose_std: Vec<f32>,
    #[prost(bool)]
    pub(crate) half_known: bool,
    /// x, y, velocity x, y, covariance xx, xy, yy; empty without a ball.
    #[prost(float, repeated)]
    pub(crate) ball: Vec<f32>,
    #[prost(sint64)]
    pub(crate) ball_seen_ns: i64,
    #[prost(float, repeated)]
    pub(crate) obstacles_x: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) obstacles_y: Vec<f32>,
}

/// `localize::team::TeamBall`: the fused ball of the majority, field frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct SharedBall {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) velocity_x: f32,
    #[prost(float, required)]
    pub(crate) velocity_y: f32,
    /// xx, xy, yy, m².
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(uint32, repeated)]
    pub(crate) witnesses: Vec<u32>,
    #[prost(uint32, repeated)]
    pub(crate) dissenters: Vec<u32>,
}

/// `localize::team::Teammate`: a teammate and the age of its message, seconds.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Teammate {
    #[prost(uint32)]
    pub(crate) robot: u32,
    #[prost(float, required)]
    pub(crate) age: f32,
    #[prost(message, optional)]
    pub(crate) pose: Option<Pose>,
    /// yes, no, or empty if unknown.
    #[prost(string)]
    pub(crate) agrees: String,
}

/// `localize::team::TeamView`: the fused knowledge of the team.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct TeamView {
    #[prost(message, optional)]
    pub(crate) ball: Option<SharedBall>,
    #[prost(message, repeated)]
    pub(crate) mates: Vec<Teammate>,
    #[prost(float, required)]
    pub(crate) half_evidence: f32,
}
