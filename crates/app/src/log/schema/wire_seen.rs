//! What bytes does a sight become? The part of [`super::wire`] that vision fills.

use foxglove::Encode;

use super::wire::LinePoints;

/// `vision::ball::Ball`: robot frame, metres; covariance xx, xy, yy, m².
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
}

/// `vision::robots::Robot`: its middle and its nearest edge, robot frame, metres.
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
}

/// All robots of a frame.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Robots {
    #[prost(message, repeated)]
    pub(crate) robots: Vec<Robot>,
}

/// `vision::goals::Goal`: its middle on the ground, robot frame, metres.
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

/// `vision::eyes::Seen`: all that a frame shows.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Seen {
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
}

/// What vision measured of a whole image, for plotting.
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
}
