//! What changes from image to image?

use localize::frames::{At, FieldFrame, Pose};

use crate::world::RobotState;

/// Everything that changes from image to image.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Pose of our robot.
    pub pose: Pose,
    /// The other robots.
    pub robots: &'a [RobotState],
    /// The ball: ground contact, diameter (metres) and colour (sRGB).
    pub ball: Option<(At<FieldFrame>, f32, [u8; 3])>,
    /// Red, green and blue light, relative to white light of level 1.
    pub light_colour: [f32; 3],
    /// Black sectors: centre and full width, radians, robot frame.
    pub occlusions: &'a [(f32, f32)],
}
