//! Where on the field is what a robot sees? The ground map holds for an upright robot, and the robot tilts.

use localize::Pose;
use localize::frames::{At, FieldFrame, RobotFrame};
use localize::tilt::ground_from_map;
use pipeline::Cycle;

/// How a robot stands in a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GroundPlacement {
    pose: Pose,
    /// Estimated tilt (a, b), radians.
    tilt: [f32; 2],
    /// Height of the viewpoint, metres; None if there is no camera.
    viewpoint_height: Option<f32>,
}

impl GroundPlacement {
    /// As a cycle estimates it; None while lost.
    pub(crate) fn of(cycle: &Cycle, viewpoint_height: Option<f32>) -> Option<Self> {
        Some(GroundPlacement {
            pose: cycle.estimate.pose?,
            tilt: cycle.estimate.tilt,
            viewpoint_height,
        })
    }

    /// Place on the field of what was seen at a point of the upright map.
    pub(crate) fn place(&self, seen: At<RobotFrame>) -> At<FieldFrame> {
        let Some(height) = self.viewpoint_height else {
            return self.pose * seen;
        };
        let [x, y] = ground_from_map([seen.x, seen.y], self.tilt, height);
        self.pose * At::new(x, y)
    }
}
