//! On which ray does a mirror see the ball's centre?

use crate::math;
use crate::stamp::Stamp;

/// A sighting of the ball: the ray from a mirror's viewpoint to the ball's centre, in a frame that is fixed to the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallRay {
    /// Time of the image.
    pub stamp: Stamp,
    /// Viewpoint: x, y and height above the ground, metres.
    pub origin: [f32; 3],
    /// Direction in the ground plane, radians counter-clockwise from the frame's x axis.
    pub azimuth: f32,
    /// Angle above the horizontal, radians.
    pub elevation: f32,
    /// Standard deviation of the azimuth, radians.
    pub azimuth_std: f32,
    /// Standard deviation of the elevation, radians.
    pub elevation_std: f32,
    /// Distance of the centre by the ball's apparent size, and its standard deviation, metres.
    pub distance: Option<[f32; 2]>,
}

impl BallRay {
    /// True if all numbers are finite and the standard deviations positive.
    pub(super) fn is_valid(&self) -> bool {
        let [x, y, z] = self.origin;
        let numbers = [x, y, z, self.azimuth, self.elevation];
        let stds = [self.azimuth_std, self.elevation_std];
        let distance = self
            .distance
            .is_none_or(|[distance, std]| distance.is_finite() && std > 0.0 && std.is_finite());
        numbers.iter().all(|value| value.is_finite())
            && stds.iter().all(|std| *std > 0.0 && std.is_finite())
            && distance
    }
}

/// A ray of one of several robots, field frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotRay {
    /// Number of the robot.
    pub robot: u32,
    /// The ray.
    pub ray: BallRay,
    /// Standard deviations of the robot's position, metres, and heading, radians.
    pub pose_std: [f32; 2],
}

/// Azimuth and elevation of the ray to a ball whose contact point on the ground appears at (x, y) from a viewpoint above
/// the origin at a height, and their standard deviations. None if it is too near for a direction.
///
/// `covariance`: xx, xy, yy of that point, m².
pub fn ray_from_ground_point(
    [x, y]: [f32; 2],
    [xx, xy, yy]: [f32; 3],
    viewpoint_height: f32,
    ball_radius: f32,
) -> Option<([f32; 2], [f32; 2])> {
    let range = math::hypot(x, y);
    let drop = viewpoint_height - ball_radius;
    if !(range > 1e-3 && drop > 0.0) {
        return None;
    }
    let (cos, sin) = (x / range, y / range);
    let along = cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy;
    let across = sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy;
    let elevation_std = along.max(0.0).sqrt() * drop / (drop * drop + range * range);
    let azimuth_std = across.max(0.0).sqrt() / range;
    Some((
        [math::atan2(y, x), -math::atan2(drop, range)],
        [azimuth_std, elevation_std],
    ))
}
