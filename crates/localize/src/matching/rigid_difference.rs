//! How does a pose differ from a predicted one? As a turn of the robot about some point of the field (docs/methods.md 5.3).
//!
//! An uncertain heading makes poses on an arc about what the robot knows its place from, such as a circle's centre. By differences of
//! the coordinates the arc leaves the prediction's straight ellipse, whose narrow side would then pass for knowledge of the heading.
//! By turns about a point it does not, whatever the point (the logarithm of the motion from one pose to the other, in the field frame).

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::parameters::{Matrix5, Vector5};
use crate::frames::{Pose, wrap_angle};
use crate::math;

/// The difference of a pose from a predicted one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidDifference {
    /// In (x, y, θ), metres and radians: to first order the difference of the coordinates.
    pub deviation: Vector3<f32>,
    /// Its derivatives by the pose's coordinates.
    pub jacobian: Matrix3<f32>,
}

/// Below this turn series replace quotients of small numbers, radians.
const SERIES_BELOW: f32 = 0.02;

impl RigidDifference {
    /// Of `pose` from `predicted`.
    pub fn between(predicted: Pose, pose: Pose) -> Self {
        let turn = wrap_angle(pose.theta - predicted.theta);
        let half = 0.5 * turn;
        let (sin_half, cos_half) = math::sin_cos(half);
        let (sin, cos) = (2.0 * sin_half * cos_half, 1.0 - 2.0 * sin_half * sin_half);
        let (x, y) = (predicted.x, predicted.y);
        let turned = [cos * x - sin * y, sin * x + cos * y];
        let (dx, dy) = (pose.x - turned[0], pose.y - turned[1]);
        // With the turn t about a point, the pose moves by V(t) times its velocity, V⁻¹ = a I − t/2 J, a = t/2 cot(t/2).
        let (a, slope) = if turn.abs() < SERIES_BELOW {
            (1.0 - turn * turn / 12.0, -turn / 6.0)
        } else {
            let cot = cos_half / sin_half;
            (half * cot, 0.5 * (cot - half / (sin_half * sin_half)))
        };
        let deviation = Vector3::new(
            a * dx + half * dy - turn * y,
            a * dy - half * dx + turn * x,
            turn,
        );
        // −J R p, the derivative of (dx, dy) by the turn.
        let (ex, ey) = (turned[1], -turned[0]);
        let jacobian = Matrix3::new(
            a,
            half,
            slope * dx + 0.5 * dy + a * ex + half * ey - y,
            -half,
            a,
            slope * dy - 0.5 * dx + a * ey - half * ex + x,
            0.0,
            0.0,
            1.0,
        );
        RigidDifference {
            deviation,
            jacobian,
        }
    }

    /// With a tilt (a, b), which is zero in the prediction.
    pub(crate) fn with_tilt(&self, [a, b]: [f32; 2]) -> Vector5 {
        let [x, y, theta] = self.deviation.into();
        Vector5::from([x, y, theta, a, b])
    }

    /// Derivatives of (x, y, θ, a, b).
    pub(crate) fn jacobian_with_tilt(&self) -> Matrix5 {
        let mut jacobian = Matrix5::identity();
        jacobian
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.jacobian);
        jacobian
    }

    /// Covariance of the difference, of that of pose and tilt.
    pub(crate) fn covariance(&self, of_pose: &Matrix5) -> Matrix5 {
        let jacobian = self.jacobian_with_tilt();
        symmetric(jacobian * of_pose * jacobian.transpose())
    }

    /// The same without the tilt.
    pub(crate) fn pose_covariance(&self, of_pose: &Matrix3<f32>) -> Matrix3<f32> {
        symmetric(self.jacobian * of_pose * self.jacobian.transpose())
    }

    /// Information on pose and tilt, of that on the difference.
    pub(crate) fn information(&self, of_difference: &Matrix5) -> Matrix5 {
        // The tilt's derivatives are those of a unit matrix.
        let transposed = self.jacobian.transpose();
        let pose = transposed * of_difference.fixed_view::<3, 3>(0, 0) * self.jacobian;
        let cross = transposed * of_difference.fixed_view::<3, 2>(0, 3);
        let mut information = *of_difference;
        let mut block = information.fixed_view_mut::<3, 3>(0, 0);
        block.copy_from(&symmetric(pose));
        let mut block = information.fixed_view_mut::<3, 2>(0, 3);
        block.copy_from(&cross);
        let mut block = information.fixed_view_mut::<2, 3>(3, 0);
        block.copy_from(&cross.transpose());
        information
    }

    /// The gradient by pose and tilt, of that by the difference.
    pub(super) fn gradient(&self, mut by_difference: Vector5) -> Vector5 {
        let by_pose = self.jacobian.transpose() * by_difference.fixed_rows::<3>(0);
        by_difference.fixed_rows_mut::<3>(0).copy_from(&by_pose);
        by_difference
    }
}

fn symmetric<const N: usize>(matrix: SMatrix<f32, N, N>) -> SMatrix<f32, N, N> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `pose` turned about a point of the field.
    fn turned(pose: Pose, [x, y]: [f32; 2], turn: f32) -> Pose {
        let (sin, cos) = math::sin_cos(turn);
        let (dx, dy) = (pose.x - x, pose.y - y);
        Pose::new(
            x + cos * dx - sin * dy,
            y + sin * dx + cos * dy,
            pose.theta + turn,
        )
    }

    #[test]
    fn turns_about_one_point_lie_on_a_straight_line() {
        let predicted = Pose::new(5.0, -3.0, 2.0);
        for centre in [[0.0, 0.0], [9.0, 6.0], [5.0, -3.0]] {
            let direction = Vector3::new(centre[1] + 3.0, 5.0 - centre[0], 1.0);
            for turn in [-1.2, -0.3, -0.01, 0.004, 0.1, 0.8] {
                let pose = turned(predicted, centre, turn);
                let difference = RigidDifference::between(predicted, pose);
                let off = difference.deviation - direction * turn;
                assert!(off.amax() < 1e-4, "{centre:?} {turn}: {off}");
                // The next turn goes on along the line.
                let here = Vector3::new(centre[1] - pose.y, pose.x - centre[0], 1.0);
                let off = difference.jacobian * here - direction;
                assert!(off.amax() < 1e-3, "{centre:?} {turn}: {off}");
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_deviation() {
        let predicted = Pose::new(-4.0, 2.0, -1.0);
        const STEP: f32 = 1e-2;
        for pose in [Pose::new(-3.6, 2.3, -0.4), Pose::new(-4.1, 2.0, -1.002)] {
            let at = |x: f32, y: f32, theta: f32| {
                let pose = Pose::new(pose.x + x, pose.y + y, pose.theta + theta);
                RigidDifference::between(predicted, pose).deviation
            };
            let columns = [
                at(STEP, 0.0, 0.0) - at(-STEP, 0.0, 0.0),
                at(0.0, STEP, 0.0) - at(0.0, -STEP, 0.0),
                at(0.0, 0.0, STEP) - at(0.0, 0.0, -STEP),
            ];
            let measured = Matrix3::from_columns(&columns.map(|column| column / (2.0 * STEP)));
            let jacobian = RigidDifference::between(predicted, pose).jacobian;
            assert!(
                (measured - jacobian).amax() < 2e-3,
                "{measured} for {jacobian}"
            );
        }
    }
}
