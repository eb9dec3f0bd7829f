//! Where are robots and ball, and how do they move? Field frame.

use localize::frames::{At, FieldFrame, Pose};
use localize::world::TeamColour;

/// Pose and velocity of a robot, field frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotState {
    /// Pose.
    pub pose: Pose,
    /// m/s along the field's x and y.
    pub velocity: [f32; 2],
    /// Yaw rate, rad/s counter-clockwise.
    pub yaw_rate: f32,
    /// The colour of its marker.
    pub team: TeamColour,
}

/// Position and velocity of the ball, field frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallState {
    /// Point of the carpet below its centre.
    pub at: At<FieldFrame>,
    /// m/s along the field's x and y.
    pub velocity: [f32; 2],
    /// Height of its lowest point above the carpet, metres.
    pub height: f32,
    /// m/s, upwards.
    pub vertical_velocity: f32,
}

impl BallState {
    /// A ball on the ground.
    pub fn on_ground(at: At<FieldFrame>, velocity: [f32; 2]) -> Self {
        BallState {
            at,
            velocity,
            height: 0.0,
            vertical_velocity: 0.0,
        }
    }
}
