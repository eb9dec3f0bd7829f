//! What did one image and the sensors before it measure?

use crate::frames::{RobotFrame, Tf};
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// One image with the measurements that connect it to the previous keyframe.
#[derive(Debug, Clone, Default)]
pub struct Keyframe {
    /// Stamp of the image.
    pub stamp: Stamp,
    /// Line points, robot frame.
    pub points: Vec<LinePoint>,
    /// Wheel motion since the previous keyframe. None without odometry, or with a gap in it.
    pub motion: Option<WheelMotion>,
    /// Heading of a compass at the image, radians.
    pub compass: Option<f32>,
}

/// Motion measured by the wheels between two images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelMotion {
    /// Pose of the later image in the robot frame of the earlier one.
    pub step: Tf<RobotFrame, RobotFrame>,
    /// Length of the path, metres.
    pub path: f32,
    /// Sum of the turns' magnitudes, radians.
    pub turned: f32,
}

impl WheelMotion {
    /// Joins successive increments (robot frame at the start of each: metres, metres, radians).
    pub fn from_increments(increments: &[[f32; 3]]) -> Self {
        let mut motion = WheelMotion {
            step: Tf::new(0.0, 0.0, 0.0),
            path: 0.0,
            turned: 0.0,
        };
        for &[dx, dy, dtheta] in increments {
            motion.step = motion.step * Tf::new(dx, dy, dtheta);
            motion.path += math::hypot(dx, dy);
            motion.turned += dtheta.abs();
        }
        motion
    }
}
