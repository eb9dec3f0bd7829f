//! What does a frame say about the place? The pose, how it came about, how sure it is, and what else it could be.

use nalgebra::Matrix3;

use crate::frames::Pose;
use crate::global_search::branch_and_bound::Hypothesis;
use crate::omni::Twist;
use crate::stamp::Stamp;

/// How a frame's pose came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Carried on from the frame before, by odometry and matching.
    Tracking,
    /// Found on the whole field in this frame, or followed while the half of the field is not yet known.
    Global,
    /// Not known.
    Lost,
}

/// Why a frame's pose is not a plainly tracked one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// Too few line points: odometry alone carries the pose.
    FewPoints,
    /// The points do not lie on the markings as they use to, but no other pose explains them better.
    PoorMatch,
    /// Another pose explains the points better: suspected.
    BetterAlternative,
    /// The compass contradicts the pose: suspected, or turned to the other half.
    CompassConflict,
    /// Odometry alone for too long.
    DeadReckoningTimeout,
    /// The relocaliser has not gathered a pose yet.
    Searching,
    /// No pose on the whole field explains the points.
    NoMatch,
    /// Several poses explain the points: the runners-up.
    Ambiguous,
    /// The frame is older than what is known already; it was not used.
    OutOfOrder,
}

/// What one frame says about the place.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The frame's.
    pub stamp: Stamp,
    /// The pose, none when lost.
    pub pose: Option<Pose>,
    /// Of (x, y, θ), metres and radians, with hypotheses that are not ruled out (but for the half turn, which is among
    /// the runners-up); the field's own size when lost.
    pub covariance: Matrix3<f32>,
    /// How the pose came about.
    pub mode: Mode,
    /// Why it is not a plainly tracked one.
    pub reason: Option<Reason>,
    /// Root mean square distance of the inliers from the markings, metres.
    pub residual: f32,
    /// Share of the points on markings.
    pub inlier_share: f32,
    /// Line points used.
    pub line_points: usize,
    /// Lean (a, b) of the robot in this frame, radians.
    pub tilt: [f32; 2],
    /// Is it known in which half the robot is (compass, prior pose, or a field that tells)?
    pub half_known: bool,
    /// Estimated metres per metre and radians per radian of the odometry.
    pub odometry_scales: [f32; 2],
    /// Estimated velocity in the robot's frame; none while lost.
    pub twist: Option<Twist>,
    /// Is a collision going on, so that the wheels are not believed?
    pub collision: bool,
    /// Estimated bias of the gyro about the vertical, rad/s.
    pub gyro_bias: f32,
    /// Estimated time from the frame's exposure to its stamp, seconds.
    pub latency: f32,
    /// Poses that explain the points too, with their probabilities; without the pose itself.
    pub runners_up: Vec<Hypothesis>,
}
