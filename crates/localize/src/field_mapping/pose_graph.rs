//! All keyframes at once: points hold them to the map, wheels to one another, and the wheels have one linear error.
//!
//! The normal equations are block tridiagonal with a border of the nine entries of the wheels' correction.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::FieldMappingConfig;
use super::keyframes::Keyframe;
use crate::frames::{Pose, RobotFrame, Tf};
use crate::math;

/// Entries of the correction.
const BORDER: usize = 9;
type Border = SMatrix<f64, 3, BORDER>;
/// Border and right-hand side.
type Columns = SMatrix<f64, 3, { BORDER + 1 }>;

/// Matrix from the wheels' measured motion to the true one, minus the identity.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct OdometryCorrection {
    error: Matrix3<f64>,
}

/// Normal equations of a keyframe's points for (x, y, θ).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PointEquations {
    pub(super) normal: Matrix3<f64>,
    pub(super) gradient: Vector3<f64>,
}

/// The unknowns.
pub(super) struct PoseGraph<'a> {
    keyframes: &'a mut [Keyframe],
    correction: &'a mut OdometryCorrection,
    config: &'a FieldMappingConfig,
    /// Error of the wheels beside the correction, share of the motion.
    wheel_noise: f32,
}

/// The normal equations.
struct Equations {
    diagonal: Vec<Matrix3<f64>>,
    /// Between a keyframe and the next.
    coupling: Vec<Matrix3<f64>>,
    columns: Vec<Columns>,
    border: SMatrix<f64, BORDER, BORDER>,
    border_gradient: SVector<f64, BORDER>,
}

impl OdometryCorrection {
    /// The true motion from the measured one.
    pub(super) fn apply(&self, motion: Pose) -> Tf<RobotFrame, RobotFrame> {
        let measured = vector(motion);
        let [x, y, theta] = (measured + self.error * measured)
            .map(|value| value as f32)
            .into();
        Tf::new(x, y, theta)
    }

    /// The matrix, row by row.
    pub(super) fn rows(&self) -> [[f32; 3]; 3] {
        let whole = Matrix3::identity() + self.error;
        std::array::from_fn(|row| std::array::from_fn(|column| whole[(row, column)] as f32))
    }
}

fn vector(motion: Pose) -> Vector3<f64> {
    Vector3::new(motion.x.into(), motion.y.into(), motion.theta.into())
}

impl<'a> PoseGraph<'a> {
    pub(super) fn new(
        keyframes: &'a mut [Keyframe],
        correction: &'a mut OdometryCorrection,
        config: &'a FieldMappingConfig,
        wheel_noise: f32,
    ) -> Self {
        PoseGraph {
            keyframes,
            correction,
            config,
            wheel_noise,
        }
    }

    /// One Gauss-Newton step. The first keyframe stays where it is.
    pub(super) fn step(&mut self, points: &[PointEquations]) {
        let mut equations = Equations::new(points);
        let prior = 1.0 / f64::from(self.config.correction_std).powi(2);
        for k in 0..BORDER {
            equations.border[(k, k)] += prior;
            equations.border_gradient[k] += prior * self.correction.error[(k / 3, k % 3)];
        }
        for index in 1..self.keyframes.len() {
            self.add_wheels(index, &mut equations);
        }
        let Some((moves, correction)) = equations.solve() else {
            return;
        };
        for (keyframe, step) in self.keyframes.iter_mut().zip(moves) {
            let pose = keyframe.pose;
            keyframe.pose = Pose::new(
                pose.x - step[0] as f32,
                pose.y - step[1] as f32,
                pose.theta - step[2] as f32,
            );
        }
        for k in 0..BORDER {
            self.correction.error[(k / 3, k % 3)] -= correction[k];
        }
    }

    /// Adds the motion by the wheels from the keyframe before `index`.
    fn add_wheels(&self, index: usize, equations: &mut Equations) {
        let (from, to) = (&self.keyframes[index - 1], &self.keyframes[index]);
        let relative = from.pose.inverse() * to.pose;
        let measured = vector(to.motion);
        let expected = measured + self.correction.error * measured;
        let residual = Vector3::new(
            f64::from(relative.x) - expected[0],
            f64::from(relative.y) - expected[1],
            crate::frames::wrap_angle(relative.theta - expected[2] as f32).into(),
        );
        let noise = f64::from(self.wheel_noise);
        let distance = measured.xy().norm();
        let along = noise * (distance + 0.06);
        let turn = noise * (measured[2].abs() + 0.2 * distance + 0.06);
        let information =
            Matrix3::from_diagonal(&Vector3::new(along.powi(-2), along.powi(-2), turn.powi(-2)));
        let (sin, cos) = math::sin_cos(f64::from(from.pose.theta));
        let turned = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        let mut of_from = -turned;
        of_from[(0, 2)] = relative.y.into();
        of_from[(1, 2)] = -f64::from(relative.x);
        let of_to = turned;
        let mut of_error = Border::zeros();
        for row in 0..3 {
            for column in 0..3 {
                of_error[(row, 3 * row + column)] = -measured[column];
            }
        }
        equations.diagonal[index - 1] += of_from.transpose() * information * of_from;
        equations.diagonal[index] += of_to.transpose() * information * of_to;
        equations.coupling[index - 1] += of_from.transpose() * information * of_to;
        for (at, jacobian) in [(index - 1, of_from), (index, of_to)] {
            let weighted = jacobian.transpose() * information;
            let mut columns = Columns::zeros();
            columns
                .fixed_columns_mut::<BORDER>(0)
                .copy_from(&(weighted * of_error));
            columns
                .fixed_columns_mut::<1>(BORDER)
                .copy_from(&(weighted * residual));
            equations.columns[at] += columns;
        }
        equations.border += of_error.transpose() * information * of_error;
        equations.border_gradient += of_error.transpose() * information * residual;
    }
}

impl Equations {
    fn new(points: &[PointEquations]) -> Self {
        let mut diagonal: Vec<Matrix3<f64>> = points.iter().map(|point| point.normal).collect();
        let columns = points.iter().map(|point| {
            let mut columns = Columns::zeros();
            columns
                .fixed_columns_mut::<1>(BORDER)
                .copy_from(&point.gradient);
            columns
        });
        let columns = columns.collect();
        // A small part of the identity keeps a keyframe without points solvable.
        for block in &mut diagonal {
            *block += Matrix3::identity() * 1e-3;
        }
        if let Some(first) = diagonal.first_mut() {
            *first += Matrix3::identity() * 1e9;
        }
        Equations {
            coupling: vec![Matrix3::zeros(); points.len().saturating_sub(1)],
            diagonal,
            columns,
            border: SMatrix::zeros(),
            border_gradient: SVector::zeros(),
        }
    }

    /// Solves for the poses' steps and the correction's. None if the equations are singular.
    fn solve(mut self) -> Option<(Vec<Vector3<f64>>, SVector<f64, BORDER>)> {
        let count = self.diagonal.len();
        let mut inverse: Vec<Matrix3<f64>> = Vec::with_capacity(count);
        let sides = self.columns.clone();
        for k in 0..count {
            if let Some(last) = k.checked_sub(1) {
                let through = self.coupling[last].transpose() * inverse[last];
                let (block, column) = (through * self.coupling[last], through * self.columns[last]);
                self.diagonal[k] -= block;
                self.columns[k] -= column;
            }
            inverse.push(self.diagonal[k].try_inverse()?);
        }
        let mut solved = vec![Columns::zeros(); count];
        for k in (0..count).rev() {
            let right = match solved.get(k + 1) {
                Some(next) if k + 1 < count => self.columns[k] - self.coupling[k] * next,
                _ => self.columns[k],
            };
            solved[k] = inverse[k] * right;
        }
        let mut border = self.border;
        let mut gradient = self.border_gradient;
        for (side, solved) in sides.iter().zip(&solved) {
            let own = side.fixed_columns::<BORDER>(0).transpose();
            border -= own * solved.fixed_columns::<BORDER>(0);
            gradient -= own * solved.fixed_columns::<1>(BORDER);
        }
        let correction = border.try_inverse()? * gradient;
        let moves = solved.iter().map(|solved| {
            let step: Vector3<f64> = solved.fixed_columns::<1>(BORDER).into_owned();
            step - solved.fixed_columns::<BORDER>(0) * correction
        });
        Some((moves.collect(), correction))
    }
}
