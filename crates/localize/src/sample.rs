//! Samples: stamped measurements of vision, wheels, inertial unit and compass.

use serde::{Deserialize, Serialize};

use crate::field::GoalColour;
use crate::frames::{At, RobotFrame};
use crate::math;
use crate::stamp::Stamp;
use crate::twist::Twist;

pub use crate::twist::Odometry;

/// A ground point on the centre of a line, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// Position, metres.
    pub at: At<RobotFrame>,
    /// Standard deviation along the direction from the robot, metres (size of a pixel on the ground).
    pub std_radial: f32,
    /// Standard deviation across that direction, metres.
    pub std_tangential: f32,
}

/// A goal detected by its colour, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalObservation {
    /// Colour of the goal.
    pub colour: GoalColour,
    /// Ground point below the middle of its visible part, metres.
    pub at: At<RobotFrame>,
    /// Standard deviation of `at` in the worst direction, metres.
    pub std: f32,
    /// Visible width, metres.
    pub width: f32,
}

/// Commanded velocity, robot frame. Valid until the next command.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct VelocityCommand {
    /// Start of its validity.
    pub stamp: Stamp,
    /// Commanded velocity.
    pub twist: Twist,
}

/// Heading of the robot on the field by the compass.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Compass {
    /// Time of the reading.
    pub stamp: Stamp,
    /// Direction of the robot's x axis on the field, radians.
    pub heading: f32,
    /// Horizontal magnetic field, robot frame, unit of the magnetometer. None if the device gives the heading only.
    pub magnetic_field: Option<[f32; 2]>,
}

impl Compass {
    /// A reading of an undisturbed magnetometer, with north along the field's x axis.
    pub fn from_magnetic_field(stamp: Stamp, field: [f32; 2]) -> Self {
        Compass {
            stamp,
            heading: -math::atan2(field[1], field[0]),
            magnetic_field: Some(field),
        }
    }
}

/// One reading of the inertial unit (IMU), robot frame (x forward, y left, z up).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Time of the reading.
    pub stamp: Stamp,
    /// Specific force, m/s².
    #[serde(rename = "acceleration")]
    pub specific_force: [f32; 3],
    /// Angular velocity, rad/s.
    #[serde(rename = "rate")]
    pub angular_velocity: [f32; 3],
}
