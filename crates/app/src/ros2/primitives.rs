//! Times, poses in the plane and their covariances as ROS 2 writes them.

use localize::math;
use nalgebra::Matrix3;

use super::messages::{
    Header, Point, Pose, PoseWithCovariance, Quaternion, Time, Transform, TransformStamped, Vector3,
};
use super::odometry_frame::PlanarPose;

/// Variance of a height that the floor fixes, m²: a millimetre. 0 would be singular.
const HEIGHT_VARIANCE: f64 = 1e-6;
/// Variance of roll and pitch, which no pose contains, rad²: robots tilt by ± 0.45° from image to image.
const TILT_VARIANCE: f64 = 6.2e-5;

/// Nanoseconds since 1970, or of simulated time. Times after 2038 do not fit.
pub(crate) fn time(nanoseconds: i64) -> Time {
    let sec = nanoseconds.div_euclid(1_000_000_000);
    Time {
        sec: i32::try_from(sec).unwrap_or(if sec < 0 { i32::MIN } else { i32::MAX }),
        // Below 10⁹.
        nanosec: nanoseconds.rem_euclid(1_000_000_000) as u32,
    }
}

/// Stamp and frame.
pub(crate) fn header(stamp_ns: i64, frame: &str) -> Header {
    Header {
        stamp: time(stamp_ns),
        frame_id: frame.to_owned(),
    }
}

/// A rotation about the vertical.
pub(crate) fn yaw(theta: f64) -> Quaternion {
    let (z, w) = math::sin_cos(theta / 2.0);
    Quaternion {
        x: 0.0,
        y: 0.0,
        z,
        w,
    }
}

/// A pose on the floor.
pub(crate) fn planar_pose_message(pose: PlanarPose) -> Pose {
    Pose {
        position: Point {
            x: pose.x,
            y: pose.y,
            z: 0.0,
        },
        orientation: yaw(pose.theta),
    }
}

/// A pose on the floor with its covariance of (x, y, θ).
pub(crate) fn uncertain_pose(pose: PlanarPose, covariance: &Matrix3<f64>) -> PoseWithCovariance {
    PoseWithCovariance {
        pose: planar_pose_message(pose),
        covariance: covariance6(covariance),
    }
}

/// The covariance of (x, y, z, roll, pitch, yaw) of motion in the plane.
pub(crate) fn covariance6(planar: &Matrix3<f64>) -> [[f64; 6]; 6] {
    let mut whole = [[0.0; 6]; 6];
    whole[2][2] = HEIGHT_VARIANCE;
    whole[3][3] = TILT_VARIANCE;
    whole[4][4] = TILT_VARIANCE;
    let places = [0, 1, 5];
    for (row, &to_row) in places.iter().enumerate() {
        for (column, &to_column) in places.iter().enumerate() {
            whole[to_row][to_column] = planar[(row, column)];
        }
    }
    whole
}

/// Where a frame on the floor lies in another one.
pub(crate) fn planar_transform(
    stamp_ns: i64,
    [parent, child]: [&str; 2],
    pose: PlanarPose,
    height: f64,
) -> TransformStamped {
    TransformStamped {
        header: header(stamp_ns, parent),
        child_frame_id: child.to_owned(),
        transform: Transform {
            translation: Vector3 {
                x: pose.x,
                y: pose.y,
                z: height,
            },
            rotation: yaw(pose.theta),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covariance_of_the_plane_is_at_x_y_and_yaw() {
        let planar = Matrix3::new(1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0);
        let whole = covariance6(&planar);
        assert_eq!(whole[0], [1.0, 2.0, 0.0, 0.0, 0.0, 3.0]);
        assert_eq!(whole[1], [2.0, 4.0, 0.0, 0.0, 0.0, 5.0]);
        assert_eq!(whole[5], [3.0, 5.0, 0.0, 0.0, 0.0, 6.0]);
        assert!((2..5).all(|index| whole[index][index] > 0.0));
    }

    #[test]
    fn times_before_1970_have_positive_nanoseconds() {
        assert_eq!(
            time(-1),
            Time {
                sec: -1,
                nanosec: 999_999_999
            }
        );
    }
}
