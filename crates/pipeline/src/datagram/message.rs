//! Which messages do other programs receive? Those of `docs/network.proto`, in protobuf and JSON.

use localize::advice::Advice;
use localize::estimate::Estimate;
use localize::flight::BallMotionMode;
use localize::world::{AirborneState, TeamColour, TrackedObject};
use serde::{Deserialize, Serialize};

use super::proto_json;
use crate::cycle::Cycle;
use crate::log::schema::convert;

/// Version of all messages. Raised when the meaning of a field changes.
pub const VERSION: u32 = 1;

/// State of the robot at one image.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
pub struct State {
    /// [`VERSION`].
    #[prost(uint32)]
    pub version: u32,
    /// Number of the robot.
    #[prost(uint32)]
    pub robot: u32,
    /// Number of the cycle from 0; a gap is a cycle that was not sent.
    #[prost(uint64)]
    pub sequence: u64,
    /// Time of exposure of the image, robot clock.
    #[prost(sint64)]
    pub stamp_ns: i64,
    /// Pose of the robot. None while it is lost.
    #[prost(message, optional)]
    pub pose: Option<Pose>,
    /// The ball.
    #[prost(message, optional)]
    pub ball: Option<ObjectReport>,
    /// Robots.
    #[prost(message, repeated)]
    pub robots: Vec<ObjectReport>,
    /// Health of vision and localization.
    #[prost(message, optional)]
    pub health: Option<Health>,
    /// The team's fused ball.
    #[prost(message, optional)]
    pub team_ball: Option<ObjectState>,
    /// Random number of this start of the robot, below 2⁵³. Commands under a key echo it. 0 if there are no commands.
    #[prost(uint64)]
    #[serde(default)]
    pub boot: u64,
    /// Why the newest command datagram was rejected, else why accepted commands have no effect now. Empty if they have.
    #[prost(string)]
    #[serde(default)]
    pub command_fault: String,
    /// The ball in the air. None while it is on the ground.
    #[prost(message, optional)]
    #[serde(default)]
    pub ball_in_air: Option<AirborneBall>,
    /// The ball at the height at which the rays of several robots meet, field frame.
    #[prost(message, optional)]
    #[serde(default)]
    pub team_ball_in_space: Option<AirborneBall>,
}

/// A ball above the ground, field frame unless named otherwise.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
pub struct AirborneBall {
    /// Probability that it is in the air. Of the team's ball: 1 if it flies or is held, 0 if it is on the ground.
    #[prost(float)]
    pub probability: f32,
    /// Position of the centre relative to the robot: forward, left, up, metres.
    #[prost(float, repeated)]
    pub from_robot: Vec<f32>,
    /// Position of the centre: x, y, z, metres. Empty while the robot is lost.
    #[prost(float, repeated)]
    pub position: Vec<f32>,
    /// m/s.
    #[prost(float, repeated)]
    pub velocity: Vec<f32>,
    /// Covariance of the position: xx, xy, xz, yy, yz, zz, m².
    #[prost(float, repeated)]
    pub covariance: Vec<f32>,
    /// Seconds to the next contact with the ground. 0 if unknown.
    #[prost(float)]
    pub lands_after: f32,
    /// Point of that contact: x, y, metres. Empty if unknown.
    #[prost(float, repeated)]
    pub landing: Vec<f32>,
    /// Covariance of that point: xx, xy, yy, m².
    #[prost(float, repeated)]
    pub landing_covariance: Vec<f32>,
}

/// A pose on the field, metres and radians.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
pub struct Pose {
    /// Metres.
    #[prost(float)]
    pub x: f32,
    /// Metres.
    #[prost(float)]
    pub y: f32,
    /// Radians.
    #[prost(float)]
    pub theta: f32,
    /// Standard deviations of x, y and θ.
    #[prost(float, repeated)]
    pub std: Vec<f32>,
    /// True if it is known in which half of the field the robot is.
    #[prost(bool)]
    pub half_known: bool,
}

/// A position on the field, metres, with its velocity, m/s.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
pub struct ObjectState {
    /// Metres.
    #[prost(float)]
    pub x: f32,
    /// Metres.
    #[prost(float)]
    pub y: f32,
    /// m/s.
    #[prost(float)]
    pub velocity_x: f32,
    /// m/s.
    #[prost(float)]
    pub velocity_y: f32,
    /// Covariance of the position: xx, xy, yy, m².
    #[prost(float, repeated)]
    pub covariance: Vec<f32>,
}

/// An object in the robot frame and in the field frame.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
pub struct ObjectReport {
    /// Number of the track.
    #[prost(uint32)]
    pub id: u32,
    /// Robot frame.
    #[prost(message, optional)]
    pub from_robot: Option<ObjectState>,
    /// Field frame. None while the robot is lost.
    #[prost(message, optional)]
    pub on_field: Option<ObjectState>,
    /// Probability that the object exists, 0 to 1.
    #[prost(float)]
    pub probability: f32,
    /// Time since its last detection, seconds.
    #[prost(float)]
    pub unseen: f32,
    /// cyan, magenta or empty.
    #[prost(string)]
    pub team: String,
}

/// Health of vision and localization.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
pub struct Health {
    /// tracking, global or lost, with its reason.
    #[prost(string)]
    pub mode: String,
    /// Why the image could not be used; empty if it was used.
    #[prost(string)]
    pub fault: String,
    /// Line points.
    #[prost(uint32)]
    pub line_points: u32,
    /// Share of the line points on markings.
    #[prost(float)]
    pub inlier_share: f32,
    /// Time from image to features, milliseconds.
    #[prost(float)]
    pub see_ms: f32,
    /// Time from features to pose, milliseconds.
    #[prost(float)]
    pub localize_ms: f32,
    /// What would make an ambiguous pose certain, for people. Empty if nothing is needed.
    #[prost(string)]
    #[serde(default)]
    pub advice: String,
    /// The motion that would, robot frame: forward, left, metres; counter-clockwise, radians. Empty if there is none.
    #[prost(float, repeated)]
    #[serde(default)]
    pub advised_motion: Vec<f32>,
    /// Share of the line points that no other pose of the field exceeds. Absent unless the whole field was searched.
    #[prost(float, optional)]
    #[serde(default)]
    pub others_share_max: Option<f32>,
}

/// A command to drive, to kick, or both. JSON as proto3 maps it: absent and null are the default, unknown keys are ignored.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
#[serde(default)]
pub struct Command {
    /// [`VERSION`].
    #[prost(uint32)]
    #[serde(deserialize_with = "proto_json::integer")]
    pub version: u32,
    /// Increases with each start of the sender, for example its start time in nanoseconds since 1970.
    #[prost(uint64)]
    #[serde(deserialize_with = "proto_json::integer")]
    pub session: u64,
    /// Increases with each command of a session.
    #[prost(uint64)]
    #[serde(deserialize_with = "proto_json::integer")]
    pub sequence: u64,
    /// Validity after arrival, milliseconds. Then the wheels stop.
    #[prost(float)]
    #[serde(deserialize_with = "proto_json::float", alias = "validMs")]
    pub valid_ms: f32,
    /// Velocity while the command is valid.
    #[prost(message, optional)]
    pub drive: Option<Drive>,
    /// A single kick.
    #[prost(message, optional)]
    pub kick: Option<Kick>,
    /// Drive only while the robot is localized.
    #[prost(bool)]
    #[serde(deserialize_with = "proto_json::flag", alias = "needsPose")]
    pub needs_pose: bool,
    /// `boot` of the robot's newest state. With a key it is required.
    #[prost(uint64)]
    #[serde(deserialize_with = "proto_json::integer")]
    pub boot: u64,
    /// Number of the robot to which the command is sent, as in its state. With a key it is required.
    #[prost(uint32)]
    #[serde(deserialize_with = "proto_json::integer")]
    pub robot: u32,
    /// `stamp_ns` of the state on which the command is based. 0 if none; else the robot rejects a command that took too
    /// long.
    #[prost(sint64)]
    #[serde(deserialize_with = "proto_json::integer", alias = "stateNs")]
    pub state_ns: i64,
}

/// A velocity in the robot frame.
#[derive(Clone, Copy, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
#[serde(default)]
pub struct Drive {
    /// Forward, m/s.
    #[prost(float)]
    #[serde(deserialize_with = "proto_json::float")]
    pub x: f32,
    /// To the left, m/s.
    #[prost(float)]
    #[serde(deserialize_with = "proto_json::float")]
    pub y: f32,
    /// Counter-clockwise, rad/s.
    #[prost(float)]
    #[serde(deserialize_with = "proto_json::float")]
    pub theta: f32,
}

/// A kick.
#[derive(Clone, Copy, PartialEq, prost::Message, Serialize, Deserialize, foxglove::Encode)]
#[serde(default)]
pub struct Kick {
    /// Speed of the ball, m/s.
    #[prost(float)]
    #[serde(deserialize_with = "proto_json::float")]
    pub speed: f32,
    /// True for a lofted kick, false for one along the ground.
    #[prost(bool)]
    #[serde(deserialize_with = "proto_json::flag")]
    pub lofted: bool,
}

/// A message to the team.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct TeamMessage {
    /// [`VERSION`].
    #[prost(uint32)]
    pub version: u32,
    /// The team's number: two teams may share a network.
    #[prost(uint32)]
    pub team: u32,
    /// Number of the sender.
    #[prost(uint32)]
    pub robot: u32,
    /// Increases with each start of the sender.
    #[prost(uint64)]
    pub session: u64,
    /// Increases with each message.
    #[prost(uint64)]
    pub sequence: u64,
    /// Time of sending, sender clock.
    #[prost(sint64)]
    pub sent_ns: i64,
    /// Time of the estimates, sender clock.
    #[prost(sint64)]
    pub stamp_ns: i64,
    /// Latest message received from each teammate, for clock offsets.
    #[prost(message, repeated)]
    pub echoes: Vec<Echo>,
    /// Pose of the sender. None while it is lost.
    #[prost(message, optional)]
    pub pose: Option<Pose>,
    /// The ball from the sender's own detections.
    #[prost(message, optional)]
    pub ball: Option<ObjectState>,
    /// Time of the last detection of the ball, sender clock.
    #[prost(sint64)]
    pub ball_seen_ns: i64,
    /// Robots tracked by the sender.
    #[prost(message, repeated)]
    pub obstacles: Vec<ObjectState>,
    /// Direction in which the sender saw the ball at `stamp_ns`. None if it did not.
    #[prost(message, optional)]
    pub ball_ray: Option<BallRay>,
    /// True if the pose rests on the sender's own sight of the field's markings, and on no team-mate's: it may correct
    /// others. Earlier versions do not send it and correct nobody.
    #[prost(bool)]
    pub pose_by_markings: bool,
}

/// The direction of the ball's centre from the sender's mirror, field frame.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct BallRay {
    /// Radians counter-clockwise from the field's x axis.
    #[prost(float)]
    pub azimuth: f32,
    /// Angle above the horizontal, radians.
    #[prost(float)]
    pub elevation: f32,
    /// Standard deviation of the azimuth without that of the pose, radians.
    #[prost(float)]
    pub azimuth_std: f32,
    /// Standard deviation of the elevation, radians.
    #[prost(float)]
    pub elevation_std: f32,
    /// Height of the mirror above the ground, metres.
    #[prost(float)]
    pub height: f32,
}

/// Reception of another robot's message.
#[derive(Clone, Copy, PartialEq, prost::Message, foxglove::Encode)]
pub struct Echo {
    /// Number of the robot that sent it.
    #[prost(uint32)]
    pub robot: u32,
    /// `sent_ns` of the received message.
    #[prost(sint64)]
    pub sent_ns: i64,
    /// Time between its reception and the sending of this message, nanoseconds.
    #[prost(sint64)]
    pub held_ns: i64,
}

impl State {
    /// Converts a cycle. `sequence`: number of the cycle.
    pub fn from_cycle(robot: u32, sequence: u64, cycle: &Cycle) -> Self {
        let estimate = &cycle.estimate;
        let report = |object: &TrackedObject| ObjectReport::from_object(object, cycle);
        State {
            version: VERSION,
            robot,
            sequence,
            stamp_ns: cycle.stamp.0,
            pose: Pose::from_estimate(estimate),
            ball: cycle.world.ball.as_ref().map(report),
            robots: cycle.world.robots.iter().map(report).collect(),
            health: Some(Health {
                mode: convert::mode_and_reason(estimate),
                fault: cycle.image_fault.clone().unwrap_or_default(),
                line_points: estimate.line_points as u32,
                inlier_share: estimate.inlier_share,
                see_ms: cycle.timings.see_ms,
                localize_ms: cycle.timings.localize_ms,
                advice: estimate
                    .advice
                    .map_or_else(String::new, |advice| advice.text()),
                advised_motion: match estimate.advice {
                    Some(Advice::Move(advice)) => advice.motion.to_vec(),
                    _ => Vec::new(),
                },
                others_share_max: estimate
                    .certificate
                    .map(|certificate| certificate.others_share_max),
            }),
            team_ball: cycle.team.ball.as_ref().map(|ball| ObjectState {
                x: ball.at.x,
                y: ball.at.y,
                velocity_x: ball.velocity[0],
                velocity_y: ball.velocity[1],
                covariance: ball.covariance.to_vec(),
            }),
            boot: 0,
            command_fault: String::new(),
            ball_in_air: cycle.world.ball_in_air.as_ref().map(|ball| AirborneBall {
                probability: ball.probability,
                from_robot: ball.from_robot.at.to_vec(),
                ..AirborneBall::on_field(ball.on_field.as_ref())
            }),
            team_ball_in_space: cycle.team.triangulated.as_ref().map(|ball| AirborneBall {
                probability: f32::from(ball.mode != BallMotionMode::Ground),
                ..AirborneBall::on_field(Some(&ball.state))
            }),
        }
    }
}

impl AirborneBall {
    fn on_field(state: Option<&AirborneState>) -> Self {
        let Some(state) = state else {
            return AirborneBall::default();
        };
        let landing = state.landing;
        AirborneBall {
            position: state.at.to_vec(),
            velocity: state.velocity.to_vec(),
            covariance: state.covariance.to_vec(),
            lands_after: landing.map_or(0.0, |landing| landing.after),
            landing: landing.map_or_else(Vec::new, |landing| landing.at.to_vec()),
            landing_covariance: landing
                .map_or_else(Vec::new, |landing| landing.covariance.to_vec()),
            ..AirborneBall::default()
        }
    }
}

impl Pose {
    /// The pose of an estimate, if it has one.
    pub fn from_estimate(estimate: &Estimate) -> Option<Self> {
        let pose = estimate.pose?;
        let std = |i: usize| estimate.covariance[(i, i)].max(0.0).sqrt();
        Some(Pose {
            x: pose.x,
            y: pose.y,
            theta: pose.theta,
            std: (0..3).map(std).collect(),
            half_known: estimate.half_known,
        })
    }
}

impl ObjectReport {
    fn from_object(object: &TrackedObject, cycle: &Cycle) -> Self {
        let state =
            |x, y, [velocity_x, velocity_y]: [f32; 2], p: &nalgebra::Matrix4<f32>| ObjectState {
                x,
                y,
                velocity_x,
                velocity_y,
                covariance: vec![p[(0, 0)], p[(0, 1)], p[(1, 1)]],
            };
        let team = object.team.map(|team| match team {
            TeamColour::Cyan => "cyan",
            TeamColour::Magenta => "magenta",
        });
        let (at, velocity) = (object.at, object.velocity);
        ObjectReport {
            id: object.id,
            from_robot: Some(state(at.x, at.y, velocity, &object.covariance)),
            on_field: object
                .on_field
                .map(|on| state(on.at.x, on.at.y, on.velocity, &on.covariance)),
            probability: object.probability,
            unseen: object.last_seen.seconds_until(cycle.stamp) as f32,
            team: team.unwrap_or_default().to_owned(),
        }
    }
}
