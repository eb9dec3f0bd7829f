//! Detected objects of an image, as given and in the odometry frame.

use nalgebra::Matrix2;

use crate::frames::{At, RobotFrame};

/// The frame in which odometry is integrated: fixed to the ground except for a slow drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OdometryFrame {}

/// The colour of a robot's team marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TeamColour {
    /// Cyan.
    Cyan,
    /// Magenta.
    Magenta,
}

/// One detected object of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectObservation {
    /// Ground point, metres, as the upright map gives it.
    pub at: At<RobotFrame>,
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Detection confidence, 0 to 1.
    pub score: f32,
    /// True if it is above the ground: it is then nearer than its ground point.
    pub airborne: bool,
    /// Its team's colour, if detected.
    pub team: Option<TeamColour>,
    /// Distance from the viewpoint by the apparent size, and its standard deviation, metres.
    pub distance: Option<[f32; 2]>,
}

/// The detected objects of an image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldObservation {
    /// The ball, if detected.
    pub ball: Option<ObjectObservation>,
    /// Robots.
    pub robots: Vec<ObjectObservation>,
}

/// A detected object in the odometry frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measurement {
    pub(super) at: At<OdometryFrame>,
    pub(super) in_robot_frame: At<RobotFrame>,
    pub(super) covariance: Matrix2<f32>,
    pub(super) score: f32,
    pub(super) team: Option<TeamColour>,
}
