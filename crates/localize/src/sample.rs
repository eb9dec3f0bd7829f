//! What arrives? Stamped samples of vision, wheels, IMU and compass, whatever their source.

use serde::{Deserialize, Serialize};

use crate::field::GoalColour;
use crate::frames::{At, RobotFrame};
use crate::omni::Twist;
use crate::stamp::Stamp;

/// A point of the ground that vision takes for the centre of a line, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// Where it lies, metres.
    pub at: At<RobotFrame>,
    /// Standard deviation along the direction from the robot, metres (a pixel's size on the ground there).
    pub std_radial: f32,
    /// Standard deviation across that direction, metres.
    pub std_tangential: f32,
}

/// A goal that vision saw by its colour, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalObservation {
    /// Its colour.
    pub colour: GoalColour,
    /// Where the middle of what is seen of it meets the ground, metres.
    pub at: At<RobotFrame>,
    /// Standard deviation of that in its worst direction, metres.
    pub std: f32,
    /// How wide it is seen, metres.
    pub width: f32,
}

/// Motion of the robot since the previous odometry sample, in the robot frame at that sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// When the motion ended.
    pub stamp: Stamp,
    /// Forward, metres.
    pub dx: f32,
    /// To the left, metres.
    pub dy: f32,
    /// Counter-clockwise, radians.
    pub dtheta: f32,
    /// What no motion explains of the wheels' ways, root mean square, metres; 0 where three wheels cannot tell.
    pub slip: f32,
}

/// What the motors are told: a velocity in the robot frame, valid until the next.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct VelocityCommand {
    /// From when on.
    pub stamp: Stamp,
    /// The wanted velocity.
    pub twist: Twist,
}

/// The compass's heading of the robot on the field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Compass {
    /// When it was read.
    pub stamp: Stamp,
    /// Direction of the robot's x axis on the field, radians.
    pub heading: f32,
    /// Horizontal magnetic field, robot frame, the magnetometer's own unit; none where the device tells a heading alone.
    pub magnetic_field: Option<[f32; 2]>,
}

impl Compass {
    /// The reading of a magnetometer whose field is a circle about zero, north along the field's x axis.
    pub fn from_magnetic_field(stamp: Stamp, field: [f32; 2]) -> Self {
        Compass {
            stamp,
            heading: -field[1].atan2(field[0]),
            magnetic_field: Some(field),
        }
    }
}

/// One reading of the inertial unit, robot frame (x forward, y left, z up).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// When it was read.
    pub stamp: Stamp,
    /// Specific force, m/s².
    pub acceleration: [f32; 3],
    /// Rate of turn, rad/s.
    pub rate: [f32; 3],
}
