//! Where is the robot on the field? A pose whose sine and cosine are computed once for an image.

use localize::frames::Pose;

/// The transform from the level robot frame to the field frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldFromRobot {
    /// Origin, metres.
    pub(super) x: f32,
    pub(super) y: f32,
    /// Of the heading.
    pub(super) sin: f32,
    pub(super) cos: f32,
}

impl FieldFromRobot {
    pub(super) fn new(pose: Pose) -> Self {
        let (sin, cos) = pose.theta.sin_cos();
        FieldFromRobot {
            x: pose.x,
            y: pose.y,
            sin,
            cos,
        }
    }

    /// A direction in the field frame.
    pub(super) fn rotate(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x - self.sin * y, self.sin * x + self.cos * y]
    }
}
