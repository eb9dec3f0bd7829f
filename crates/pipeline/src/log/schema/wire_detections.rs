//! How are detections encoded? The messages of `wire` that vision fills.

use foxglove::Encode;

use super::wire_geometry::LinePoints;

/// `vision::objects::ball::BallDetection`: robot frame, metres; covariance xx, xy, yy, m².
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Ball {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(bool)]
    pub(crate) on_ground: bool,
    #[prost(float, required)]
    pub(crate) score: f32,
    #[prost(float, required)]
    pub(crate) u_px: f32,
    #[prost(float, required)]
    pub(crate) v_px: f32,
    #[prost(uint32)]
    pub(crate) pixels: u32,
    /// By the apparent size, and its standard deviation. Empty if not measured.
    #[prost(float, repeated)]
    pub(crate) distance: Vec<f32>,
}

/// `vision::objects::robots::RobotDetection`: centre and nearest edge, robot frame, metres.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Robot {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) edge_x: f32,
    #[prost(float, required)]
    pub(crate) edge_y: f32,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(float, required)]
    pub(crate) width: f32,
    #[prost(string)]
    pub(crate) marker: String,
    #[prost(float, required)]
    pub(crate) score: f32,
    #[prost(float, required)]
    pub(crate) u_px: f32,
    #[prost(float, required)]
    pub(crate) v_px: f32,
    /// Empty for a robot, `person`.
    #[prost(string)]
    pub(crate) kind: String,
}

/// All robots of an image.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Robots {
    #[prost(message, repeated)]
    pub(crate) robots: Vec<Robot>,
}

/// `vision::objects::goals::GoalDetection`: centre on the ground, robot frame, metres.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Goal {
    #[prost(string)]
    pub(crate) kind: String,
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, repeated)]
    pub(crate) covariance: Vec<f32>,
    #[prost(float, required)]
    pub(crate) width: f32,
    #[prost(float, required)]
    pub(crate) score: f32,
    #[prost(float, required)]
    pub(crate) u_px: f32,
    #[prost(float, required)]
    pub(crate) v_px: f32,
}

/// `vision::objects::virtual_sensors::VirtualSensorReadings`. A position is a column and a row, or empty.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Windows {
    #[prost(float, repeated)]
    pub(crate) bumper_share: Vec<f32>,
    #[prost(bool, repeated)]
    pub(crate) bumper_hit: Vec<bool>,
    #[prost(float, repeated)]
    pub(crate) blue_goal_px: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) yellow_goal_px: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) ball_px: Vec<f32>,
    #[prost(bool)]
    pub(crate) kick: bool,
    #[prost(float, repeated)]
    pub(crate) lens_px: Vec<f32>,
    #[prost(bool, optional)]
    pub(crate) lens_centred: Option<bool>,
}

/// `vision::exposure::ExposureStatus`. Settings are in the camera's own units, absent without a control.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Exposure {
    #[prost(float, required)]
    pub(crate) entropy: f32,
    #[prost(float, required)]
    pub(crate) level: f32,
    #[prost(float, optional)]
    pub(crate) exposure: Option<f32>,
    #[prost(float, optional)]
    pub(crate) gain: Option<f32>,
    #[prost(bool)]
    pub(crate) searching: bool,
    #[prost(float, optional)]
    pub(crate) command_exposure: Option<f32>,
    #[prost(float, optional)]
    pub(crate) command_gain: Option<f32>,
    #[prost(uint64)]
    pub(crate) command_from_frame: u64,
    #[prost(bool)]
    pub(crate) light_jumped: bool,
    #[prost(bool)]
    pub(crate) warning: bool,
}

/// `vision::process::Detections`: all results of vision for an image.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Detections {
    #[prost(message, required)]
    pub(crate) points: LinePoints,
    #[prost(float, repeated)]
    pub(crate) point_u_px: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) point_v_px: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) point_contrast: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) point_width: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) refused_u_px: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) refused_v_px: Vec<f32>,
    #[prost(string, repeated)]
    pub(crate) refused_reason: Vec<String>,
    #[prost(message, optional)]
    pub(crate) ball: Option<Ball>,
    #[prost(message, repeated)]
    pub(crate) robots: Vec<Robot>,
    #[prost(message, repeated)]
    pub(crate) goals: Vec<Goal>,
    #[prost(float, repeated)]
    pub(crate) carpet_end: Vec<f32>,
    #[prost(float, required)]
    pub(crate) carpet_share: f32,
    #[prost(bool)]
    pub(crate) learned: bool,
    #[prost(message, required)]
    pub(crate) windows: Windows,
    #[prost(message, repeated)]
    pub(crate) other_balls: Vec<Ball>,
    #[prost(message, repeated)]
    pub(crate) rejected_objects: Vec<RejectedObject>,
}

/// `vision::objects::rejection::RejectedObject`.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct RejectedObject {
    #[prost(string)]
    pub(crate) reason: String,
    #[prost(float, required)]
    pub(crate) u_px: f32,
    #[prost(float, required)]
    pub(crate) v_px: f32,
    #[prost(float, required)]
    pub(crate) probability: f32,
}

/// Measurements on a whole image, for plotting.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Sensors {
    #[prost(uint32)]
    pub(crate) line_points: u32,
    #[prost(uint32)]
    pub(crate) refused: u32,
    #[prost(float, required)]
    pub(crate) carpet_share: f32,
    #[prost(bool)]
    pub(crate) colours_learned: bool,
    /// Distance of the carpet's end in each direction around the mirror axis, metres; infinite if no end is visible.
    #[prost(float, repeated)]
    pub(crate) carpet_end: Vec<f32>,
    #[prost(message, required)]
    pub(crate) windows: Windows,
    #[prost(message, optional)]
    pub(crate) exposure: Option<Exposure>,
}
