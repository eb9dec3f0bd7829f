//! What did one image and the sensors before it measure?

use nalgebra::Vector3;

use crate::frames::{RobotFrame, Tf};
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;
use crate::wheel_steps::MatrixDerivatives;

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
    /// Change of the step by the matrix of the wheels: uneven wheels turn the robot all along its path.
    pub by_matrix: MatrixDerivatives,
}

impl WheelMotion {
    /// Joins successive increments (robot frame at the start of each: metres, metres, radians).
    pub fn from_increments(increments: &[[f32; 3]]) -> Self {
        let mut motion = WheelMotion {
            step: Tf::new(0.0, 0.0, 0.0),
            path: 0.0,
            turned: 0.0,
            by_matrix: MatrixDerivatives::zeros(),
        };
        for &[dx, dy, dtheta] in increments {
            add_derivatives(
                &mut motion.by_matrix,
                motion.step.theta,
                [dx, dy, dtheta].into(),
            );
            motion.step = motion.step * Tf::new(dx, dy, dtheta);
            motion.path += math::hypot(dx, dy);
            motion.turned += dtheta.abs();
        }
        motion
    }
}

/// Adds the change of an increment at a heading to that of the path before it.
fn add_derivatives(path: &mut MatrixDerivatives, heading: f32, increment: Vector3<f32>) {
    let (sin, cos) = math::sin_cos(heading);
    let aside = [
        -sin * increment.x - cos * increment.y,
        cos * increment.x - sin * increment.y,
    ];
    for entry in 0..9 {
        let value = increment[entry % 3];
        let turned = path[(2, entry)];
        let [forward, left, turn] = [0, 1, 2].map(|row| if entry / 3 == row { value } else { 0.0 });
        path[(0, entry)] += cos * forward - sin * left + aside[0] * turned;
        path[(1, entry)] += sin * forward + cos * left + aside[1] * turned;
        path[(2, entry)] += turn;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    #[test]
    fn derivatives_by_the_matrix_are_those_of_the_joined_path() {
        let rows = |matrix: &Matrix3<f32>| -> Vec<[f32; 3]> {
            let row = |k: u8| {
                let at = 0.1 * f32::from(k);
                Vector3::new(0.03, 0.02 * math::sin(at), 0.04 * math::cos(0.7 * at))
            };
            (0..80).map(|k| (matrix * row(k)).into()).collect()
        };
        let right = WheelMotion::from_increments(&rows(&Matrix3::identity()));
        for entry in 0..9 {
            let mut matrix = Matrix3::identity();
            matrix[(entry / 3, entry % 3)] += 1e-2;
            let other = WheelMotion::from_increments(&rows(&matrix));
            let change = [
                other.step.x - right.step.x,
                other.step.y - right.step.y,
                other.step.theta - right.step.theta,
            ];
            for (row, change) in change.iter().enumerate() {
                let expected = 1e-2 * right.by_matrix[(row, entry)];
                assert!(
                    (change - expected).abs() < 2e-3,
                    "{entry} {row}: {change} {expected}"
                );
            }
        }
    }
}
