//! Detections of one image.

use crate::lines::detection::{LinePointDetection, RejectedCandidate};
use crate::objects::ball::BallDetection;
use crate::objects::goals::GoalDetection;
use crate::objects::rejection::RejectedObject;
use crate::objects::robots::RobotDetection;
use crate::objects::virtual_sensors::VirtualSensorReadings;

/// Detections of one image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Detections {
    /// Points of the field's markings.
    pub line_points: Vec<LinePointDetection>,
    /// Peaks that failed line validation.
    pub rejected_candidates: Vec<RejectedCandidate>,
    /// The most certain ball.
    pub ball: Option<BallDetection>,
    /// Further balls, most certain first.
    pub other_balls: Vec<BallDetection>,
    /// Robots and people.
    pub robots: Vec<RobotDetection>,
    /// Objects that were refused, with reasons.
    pub rejected_objects: Vec<RejectedObject>,
    /// Goals and posts.
    pub goals: Vec<GoalDetection>,
    /// Readings of the virtual sensors.
    pub virtual_sensors: VirtualSensorReadings,
    /// Distance of the carpet's boundary in each direction about the mirror's axis, metres; infinite if none is
    /// visible. The first direction is image right, then counter-clockwise towards image up.
    pub carpet_end: Vec<f32>,
    /// Fraction of the scanned pixels that are carpet.
    pub carpet_share: f32,
    /// True if the colours were learned from this image.
    pub colours_learned: bool,
}
