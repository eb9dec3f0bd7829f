//! What changes from image to image?

use localize::frames::{At, FieldFrame, Pose};

use super::row_transform::CameraMotion;
use crate::people::Person;
use crate::sector::Sector;
use crate::world::RobotState;

/// Everything that changes from image to image. The default is an empty field under white light of level 1.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Pose of our robot.
    pub pose: Pose,
    /// Its motion and tilt.
    pub motion: CameraMotion,
    /// The other robots.
    pub robots: &'a [RobotState],
    /// People on or beside the field.
    pub people: &'a [Person],
    /// The ball.
    pub ball: Option<SceneBall>,
    /// Red, green and blue light, relative to white light of level 1.
    pub light_colour: [f32; 3],
    /// Black sectors.
    pub occluded_sectors: &'a [Sector],
}

/// The ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneBall {
    /// Point of the carpet below its centre.
    pub at: At<FieldFrame>,
    /// Height of its lowest point above the carpet, metres.
    pub height: f32,
    /// Diameter, metres.
    pub diameter: f32,
    /// sRGB.
    pub colour: [u8; 3],
}

impl Default for Scene<'_> {
    fn default() -> Self {
        Scene {
            pose: Pose::new(0.0, 0.0, 0.0),
            motion: CameraMotion::default(),
            robots: &[],
            people: &[],
            ball: None,
            light_colour: [1.0; 3],
            occluded_sectors: &[],
        }
    }
}
