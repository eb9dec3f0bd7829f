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
    /// None while the ball is on the ground.
    #[prost(message, optional)]
    pub(crate) ball_in_air: Option<BallInAir>,
    /// azimuth, elevation and their standard deviations, radians; height of the viewpoint and, if
    /// measured, distance by the apparent size and its standard deviation, metres. Empty if not seen.
    #[prost(float, repeated)]
    pub(crate) ball_sighting: Vec<f32>,
}

/// `localize::world::BallInAir`: robot frame and field frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct BallInAir {
    #[prost(float, required)]
    pub(crate) probability: f32,
    #[prost(message, required)]
    pub(crate) from_robot: AirborneState,
    #[prost(message, optional)]
    pub(crate) on_field: Option<AirborneState>,
}

/// `localize::world::AirborneState`: metres, m/s.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct AirborneState {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    /// Of the ball's centre.
    #[prost(float, required)]
    pub(crate) z: f32,
    #[prost(float, required)]
    pub(crate) velocity_x: f32,
    #[prost(float, required)]
    pub(crate) velocity_y: f32,
    #[prost(float, required)]
    pub(crate) velocity_z: f32,
    /// xx, xy, xz, yy, yz, zz, m².
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    /// Next contact with the ground: seconds from now, x, y, metres, covariance xx, xy, yy, m². Empty if unknown.
    #[prost(float, repeated)]
    pub(crate) landing: Vec<f32>,
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
    /// As `WorldView::ball_sighting`, in the field frame.
    #[prost(float, repeated)]
    pub(crate) ball_sighting: Vec<f32>,
    /// False in logs of earlier versions, whose robots correct nobody.
    #[prost(bool)]
    pub(crate) pose_by_markings: bool,
    /// Of each obstacle: xx, xy, yy, m². Empty in logs of earlier versions.
    #[prost(float, repeated)]
    pub(crate) obstacles_covariance: Vec<f32>,
    /// False in logs of earlier versions, in which no number came before others.
    #[prost(bool)]
    pub(crate) is_member: bool,
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
    #[prost(message, optional)]
    pub(crate) triangulated: Option<TriangulatedBall>,
    #[prost(bool)]
    pub(crate) pose_by_markings: bool,
    #[prost(message, repeated)]
    pub(crate) sightings: Vec<JudgedSighting>,
}

/// `localize::team::JudgedSighting`: a sighting between this robot and a teammate, and what became of it.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct JudgedSighting {
    #[prost(uint32)]
    pub(crate) robot: u32,
    /// by_mate or of_mate.
    #[prost(string)]
    pub(crate) direction: String,
    /// used, or why not.
    #[prost(string)]
    pub(crate) outcome: String,
}

/// `localize::team::TeamBallInSpace`: the ball at the height at which several robots' rays meet, field frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct TriangulatedBall {
    /// ground, flight or held.
    #[prost(string)]
    pub(crate) mode: String,
    #[prost(message, required)]
    pub(crate) state: AirborneState,
    #[prost(uint32, repeated)]
    pub(crate) witnesses: Vec<u32>,
    #[prost(uint32, repeated)]
    pub(crate) dissenters: Vec<u32>,
}
