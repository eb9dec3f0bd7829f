//! A range of directions around the robot.

use localize::frames::wrap_angle;

/// Directions up to half a width on either side of a centre, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sector {
    /// Direction of the centre, radians counter-clockwise from the robot's x axis.
    pub centre: f32,
    /// Full width, radians.
    pub width: f32,
}

impl Sector {
    /// A sector with centre and full width in degrees.
    pub fn from_degrees(centre_deg: f32, width_deg: f32) -> Self {
        Sector {
            centre: centre_deg.to_radians(),
            width: width_deg.to_radians(),
        }
    }

    /// True if a direction (radians, robot frame) lies inside.
    pub fn contains(&self, direction: f32) -> bool {
        wrap_angle(direction - self.centre).abs() <= self.width / 2.0
    }
}
