//! How is a cycle encoded? In our own protobuf messages, because no foxglove schema holds every bit.
//!
//! One struct determines both the bytes (prost) and the schema (foxglove) of a message. Both number the fields in order
//! of declaration. Single floats are marked `required`: proto3 would drop −0.0 as a default, but replay compares bits.
//! A change of a message raises `FORMAT_VERSION`.

use foxglove::Encode;
use prost::bytes::Bytes;

pub(crate) use super::wire_detections::{
    Ball, Detections, Exposure, Goal, RejectedObject, Robot, Robots, Sensors, Windows,
};
pub(crate) use super::wire_geometry::{LinePoints, Pose, PoseError};
pub(crate) use super::wire_world::{
    AirborneState, BallInAir, JudgedSighting, Object, OnField, SharedBall, TeamReport, TeamView,
    Teammate, TriangulatedBall, WorldView,
};

/// `localize::sample::Odometry`: motion since the previous one, robot frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Odometry {
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(float, required)]
    pub(crate) dx: f32,
    #[prost(float, required)]
    pub(crate) dy: f32,
    #[prost(float, required)]
    pub(crate) dtheta: f32,
    #[prost(float, required)]
    pub(crate) slip: f32,
}

/// `localize::sample::VelocityCommand`: velocity command to the motors, m/s and rad/s, robot frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Command {
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) theta: f32,
}

/// `localize::sample::Compass`: heading on the field, radians.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Compass {
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(float, required)]
    pub(crate) heading: f32,
    /// Magnetic field from which the heading was computed: x and y, or empty.
    #[prost(float, repeated)]
    pub(crate) field: Vec<f32>,
}

/// `localize::sample::Imu`: specific force in m/s², angular rate in rad/s, robot frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Imu {
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(float, required)]
    pub(crate) acceleration_x: f32,
    #[prost(float, required)]
    pub(crate) acceleration_y: f32,
    #[prost(float, required)]
    pub(crate) acceleration_z: f32,
    #[prost(float, required)]
    pub(crate) rate_x: f32,
    #[prost(float, required)]
    pub(crate) rate_y: f32,
    #[prost(float, required)]
    pub(crate) rate_z: f32,
}

/// `localize::global_search::branch_and_bound::Hypothesis`: an alternative pose; covariance row by row.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Hypothesis {
    #[prost(message, required)]
    pub(crate) pose: Pose,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(float, required)]
    pub(crate) probability: f32,
    #[prost(float, required)]
    pub(crate) score: f32,
    #[prost(float, required)]
    pub(crate) inlier_share: f32,
    #[prost(float, required)]
    pub(crate) residual: f32,
    #[prost(float, repeated)]
    pub(crate) lean: Vec<f32>,
}

/// `localize::estimate::Estimate`: covariance of (x, y, θ) row by row.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Estimate {
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(message, optional)]
    pub(crate) pose: Option<Pose>,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(string)]
    pub(crate) mode: String,
    #[prost(string)]
    pub(crate) reason: String,
    #[prost(float, required)]
    pub(crate) residual: f32,
    #[prost(float, required)]
    pub(crate) inlier_share: f32,
    #[prost(uint32)]
    pub(crate) line_points: u32,
    #[prost(float, repeated)]
    pub(crate) lean: Vec<f32>,
    #[prost(bool)]
    pub(crate) half_known: bool,
    #[prost(float, repeated)]
    pub(crate) odometry_scales: Vec<f32>,
    #[prost(message, repeated)]
    pub(crate) runners_up: Vec<Hypothesis>,
    /// Velocity in the robot frame (m/s, m/s, rad/s); empty while lost.
    #[prost(float, repeated)]
    pub(crate) twist: Vec<f32>,
    #[prost(bool)]
    pub(crate) collision: bool,
    #[prost(float, required)]
    pub(crate) gyro_bias: f32,
    #[prost(float, required)]
    pub(crate) latency: f32,
    /// Absent in logs of earlier versions.
    #[prost(message, optional)]
    pub(crate) fit: Option<Fit>,
    #[prost(message, optional)]
    pub(crate) map_correction: Option<MapCorrection>,
    /// From measured to true motion (x, y, θ), row by row. Empty in logs of earlier versions.
    #[prost(float, repeated)]
    pub(crate) odometry_correction: Vec<f32>,
    /// Absent unless the image was searched exactly on the whole field.
    #[prost(message, optional)]
    pub(crate) certificate: Option<Certificate>,
    /// Absent unless the pose is ambiguous.
    #[prost(message, optional)]
    pub(crate) advice: Option<Advice>,
    /// Share of the covariance by errors that no number of images averages away, row by row. Empty in logs of earlier
    /// versions.
    #[prost(float, repeated)]
    pub(crate) repeated_covariance: Vec<f32>,
}

/// `localize::global_search::branch_and_bound::Certificate`: what all other poses explain at most, shares of the points.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Certificate {
    #[prost(uint32)]
    pub(crate) points: u32,
    #[prost(float, required)]
    pub(crate) answer_share: f32,
    #[prost(float, required)]
    pub(crate) others_share_max: f32,
    #[prost(float, required)]
    pub(crate) unlisted_share_max: f32,
    #[prost(bool)]
    pub(crate) is_attained: bool,
}

/// `localize::advice::Advice`: what would tell the hypotheses apart.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Advice {
    /// For people.
    #[prost(string)]
    pub(crate) text: String,
    /// Motion in the robot frame (m, m, rad). Empty: no motion tells, but a compass, coloured goals or a team-mate.
    #[prost(float, repeated)]
    pub(crate) motion: Vec<f32>,
    #[prost(float, required)]
    pub(crate) expected_log_odds: f32,
}

/// `localize::estimate::Fit`: how well the set-up fits the last seconds.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Fit {
    #[prost(float, required)]
    pub(crate) on_markings: f32,
    #[prost(float, required)]
    pub(crate) residual: f32,
    #[prost(float, required)]
    pub(crate) markings_seen: f32,
    #[prost(float, optional)]
    pub(crate) wheels: Option<f32>,
    #[prost(float, optional)]
    pub(crate) compass: Option<f32>,
}

/// `localize::map_correction::MapCorrectionEstimate`: what is known about the ground map's errors.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct MapCorrection {
    /// Unknowns: mirror tilt x …
    #[prost(string, repeated)]
    pub(crate) names: Vec<String>,
    /// Radians, metres, or relative.
    #[prost(float, repeated)]
    pub(crate) values: Vec<f32>,
    /// Standard deviations.
    #[prost(float, repeated)]
    pub(crate) stds: Vec<f32>,
    /// Independent images used.
    #[prost(uint32)]
    pub(crate) images: u32,
    #[prost(uint32)]
    pub(crate) knocks: u32,
    /// Root mean square displacement of points 3 m away, metres.
    #[prost(float, required)]
    pub(crate) displacement_at_3_m: f32,
    #[prost(float, required)]
    pub(crate) displacement_std_at_3_m: f32,
}

/// True poses and positions, field frame, metres.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct GroundTruth {
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    #[prost(message, required)]
    pub(crate) pose: Pose,
    #[prost(float, repeated)]
    pub(crate) ball: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) robots_x: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) robots_y: Vec<f32>,
    /// Of the ball's lowest point; 0 in older logs.
    #[prost(float, required)]
    pub(crate) ball_height: f32,
    /// Radians; empty in older logs.
    #[prost(float, repeated)]
    pub(crate) robot_headings: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) people_x: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) people_y: Vec<f32>,
}

/// One cycle of the pipeline, with every bit that replay needs or compares.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Cycle {
    /// Counts from 0. A gap is a dropped cycle.
    #[prost(uint64)]
    pub(crate) index: u64,
    #[prost(sint64)]
    pub(crate) stamp_ns: i64,
    /// Format of the message on /camera/image with this stamp: png, jpeg or none.
    #[prost(string)]
    pub(crate) image: String,
    #[prost(message, repeated)]
    pub(crate) odometry: Vec<Odometry>,
    #[prost(message, repeated)]
    pub(crate) compass: Vec<Compass>,
    #[prost(message, repeated)]
    pub(crate) imu: Vec<Imu>,
    #[prost(message, optional)]
    pub(crate) truth: Option<GroundTruth>,
    #[prost(message, required)]
    pub(crate) points: LinePoints,
    #[prost(message, optional)]
    pub(crate) seen: Option<Detections>,
    #[prost(message, required)]
    pub(crate) estimate: Estimate,
    #[prost(string, optional)]
    pub(crate) fault: Option<String>,
    #[prost(float, required)]
    pub(crate) see_ms: f32,
    #[prost(float, required)]
    pub(crate) localize_ms: f32,
    #[prost(message, optional)]
    pub(crate) exposure: Option<Exposure>,
    #[prost(message, repeated)]
    pub(crate) commands: Vec<Command>,
    #[prost(message, repeated)]
    pub(crate) reports: Vec<TeamReport>,
    #[prost(message, required)]
    pub(crate) world: WorldView,
    #[prost(message, required)]
    pub(crate) team: TeamView,
    /// Exposure and gain that the camera reported with the image.
    #[prost(float, optional)]
    pub(crate) reported_exposure: Option<f32>,
    #[prost(float, optional)]
    pub(crate) reported_gain: Option<f32>,
    /// All settings, if they were changed and hold from this cycle on.
    #[prost(string, optional)]
    pub(crate) settings: Option<String>,
    /// The state from which a new pipeline went on at this cycle (TOML).
    #[prost(string, optional)]
    pub(crate) warm_start: Option<String>,
    /// Covariance of (x, y, θ), column by column, that is added to each pose from this cycle on: the set-up is doubtful.
    /// Zeros end the doubt. Empty: no change.
    #[prost(float, repeated)]
    pub(crate) setup_doubt: Vec<f32>,
    /// Errors of the ground map that images told, which are in use from this cycle on (TOML).
    #[prost(string, optional)]
    pub(crate) map_fit: Option<String>,
}

/// An input file of a run, under its name in a recording folder.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Attachment {
    #[prost(string)]
    pub(crate) name: String,
    #[prost(bytes = "bytes")]
    pub(crate) content: Bytes,
}

/// An entry of the metadata record.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct MetadataEntry {
    #[prost(string)]
    pub(crate) key: String,
    #[prost(string)]
    pub(crate) value: String,
}

/// Metadata and attachments of a log, as a message for viewers of a live stream.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub struct About {
    #[prost(message, repeated)]
    pub(crate) metadata: Vec<MetadataEntry>,
    #[prost(message, repeated)]
    pub(crate) files: Vec<Attachment>,
}
