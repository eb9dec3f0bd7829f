//! Objects that were considered and refused, with their reason.

/// Why something is not reported as an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObjectRejection {
    /// A region of the ball's colour or shape whose pixels do not look like a ball.
    NotABall,
    /// An obstacle whose pixels look like neither robot nor person: a cable, a shadow, glare, a wall.
    NotAnObstacle,
    /// A part of the robot itself: body, rods, rim.
    OwnBody,
}

/// A refused object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RejectedObject {
    /// Image position: column, row, pixels.
    pub position_px: [f32; 2],
    /// Why it is none.
    pub reason: ObjectRejection,
    /// Probability by the network, 0 to 1.
    pub probability: f32,
}
