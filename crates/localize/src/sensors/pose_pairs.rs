//! Pairs of poses a given time apart, between which calibration compares sensors.

use nalgebra::Matrix3;

use crate::frames::Pose;
use crate::stamp::Stamp;

/// A pose by the line points of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisionPose {
    /// Stamp of the image.
    pub stamp: Stamp,
    /// Pose on the field.
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians.
    pub covariance: Matrix3<f32>,
}

/// Longest time between the poses of a pair, as a multiple of the wanted one.
const GAP_MAX: f64 = 1.5;

/// Successive pairs at least `seconds` apart; each begins where the last one ended. Pairs with missing images between them are
/// left out.
pub(super) fn pose_pairs(
    poses: &[VisionPose],
    seconds: f64,
) -> impl Iterator<Item = (&VisionPose, &VisionPose)> {
    let mut rest = poses;
    std::iter::from_fn(move || {
        let from = rest.first()?;
        let next = rest
            .iter()
            .position(|pose| pose.stamp - from.stamp >= seconds)?;
        rest = &rest[next..];
        Some((from, rest.first()?))
    })
    .filter(move |(from, to)| to.stamp - from.stamp < GAP_MAX * seconds)
}
