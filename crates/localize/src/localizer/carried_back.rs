//! What is known of the pose at an earlier time than that of the filter, for an image that comes too late to be used?

use nalgebra::{Matrix3, Vector3};

use crate::estimate::Estimate;
use crate::frames::{Pose, wrap_angle};
use crate::math;
use crate::stamp::Stamp;

/// Poses are carried back by at most this time, seconds.
const CARRIED_BACK_MAX: f32 = 1.0;
/// Errors of the twist, as wheels alone tell it, and accelerations that the robot may have had meanwhile, one standard deviation: m/s and
/// rad/s, m/s² and rad/s².
const TWIST_STD: [f32; 2] = [0.3, 0.3];
const ACCELERATION_STD: [f32; 2] = [3.0, 10.0];

/// Carries the pose of a later time back to the estimate's stamp, as if the robot had moved evenly; by how much it did not is a part of
/// the covariance.
pub(super) fn carry_back(estimate: Estimate, later: Stamp) -> Estimate {
    let seconds = later.seconds_until(estimate.stamp) as f32;
    let (Some(pose), Some(twist)) = (estimate.pose, estimate.twist) else {
        return estimate;
    };
    if !(-CARRIED_BACK_MAX..0.0).contains(&seconds) {
        return estimate;
    }
    let turn = twist.theta * seconds;
    let (sin, cos) = math::sin_cos(pose.theta + 0.5 * turn);
    let (x, y) = (twist.x * seconds, twist.y * seconds);
    let carried = Pose::new(
        pose.x + cos * x - sin * y,
        pose.y + sin * x + cos * y,
        wrap_angle(pose.theta + turn),
    );
    let [position, heading] = [0, 1].map(|k| {
        let uneven = 0.5 * ACCELERATION_STD[k] * seconds * seconds;
        (TWIST_STD[k] * seconds).powi(2) + uneven.powi(2)
    });
    let uneven = Matrix3::from_diagonal(&Vector3::new(position, position, heading));
    Estimate {
        pose: Some(carried),
        covariance: estimate.covariance + uneven,
        ..estimate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::omni::Twist;

    #[test]
    fn pose_is_carried_back_along_its_arc_with_what_an_acceleration_may_have_done() {
        let later = Stamp::from_seconds(10.0);
        let twist = Twist {
            x: 2.0,
            y: 0.0,
            theta: 1.0,
        };
        let at = |seconds: f64| Estimate {
            twist: Some(twist),
            ..Estimate::tracked(
                later + -seconds,
                Pose::new(1.0, 2.0, 0.1),
                Matrix3::from_diagonal_element(1e-4),
            )
        };
        let carried = carry_back(at(0.2), later);
        let pose = carried.pose.expect("a pose");
        assert!(
            (pose.x - 0.6).abs() < 1e-4 && (pose.y - 2.0).abs() < 1e-4,
            "{pose:?}"
        );
        assert!((pose.theta + 0.1).abs() < 1e-5, "{pose:?}");
        assert!((carried.covariance[(0, 0)] - 1e-4 - 2.0 * 0.06f32.powi(2)).abs() < 1e-6);
        // Now, and from a clock of another time.
        for seconds in [0.0, 5.0] {
            assert_eq!(carry_back(at(seconds), later), at(seconds));
        }
    }
}
