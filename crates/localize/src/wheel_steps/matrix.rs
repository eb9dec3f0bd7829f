//! By which matrix do the wheels differ from the poses?

use nalgebra::{Matrix3, Vector3};

use super::step::{MeasuredStep, PASSES, STEP_STD, STEPS_MIN, spread, weight};
use crate::math;

/// Standard deviation of the elements of a matrix of wrong wheels.
const MATRIX_STD: f32 = 0.3;
/// Smallest spread of steps: that of poses on a perfect map, shares of the expected errors.
const SPREAD_MIN: f32 = 0.2;

/// A matrix of the wheels, fitted to steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatrixFit {
    /// From the wheels' motion (metres, metres, radians) to that of the poses.
    pub matrix: Matrix3<f32>,
    /// Largest standard deviation of its elements.
    pub std: f32,
}

/// A motion by the wheels and by the poses: metres, metres, radians.
type MotionPair = (Vector3<f32>, Vector3<f32>);

/// The matrix by which the wheels' motion becomes that of the poses. None for too few steps.
pub fn matrix_between(steps: &[MeasuredStep]) -> Option<MatrixFit> {
    fit_reweighted(steps, |pairs, weights| {
        let mut information = Matrix3::identity() / (MATRIX_STD * MATRIX_STD);
        let mut products = information;
        for ((wheels, poses), weight) in pairs.iter().zip(weights) {
            let weight = weight / (STEP_STD.0 * STEP_STD.0);
            information += wheels * wheels.transpose() * weight;
            products += poses * wheels.transpose() * weight;
        }
        let covariance = information.try_inverse()?;
        Some(MatrixFit {
            matrix: products * covariance,
            std: covariance.diagonal().max().sqrt(),
        })
    })
}

/// The factor by which the wheels' motion, turns included, becomes that of the poses, as a matrix: wheels of another size. None for
/// too few steps.
pub fn factor_between(steps: &[MeasuredStep]) -> Option<MatrixFit> {
    let std_of = Vector3::new(STEP_STD.0, STEP_STD.0, STEP_STD.1);
    fit_reweighted(steps, |pairs, weights| {
        let (mut information, mut product) = (0.0_f32, 0.0_f32);
        for ((wheels, poses), weight) in pairs.iter().zip(weights) {
            let wheels = wheels.component_div(&std_of);
            information += weight * wheels.norm_squared();
            product += weight * wheels.dot(&poses.component_div(&std_of));
        }
        (information > 0.0).then(|| MatrixFit {
            matrix: Matrix3::from_diagonal_element(product / information),
            std: information.sqrt().recip(),
        })
    })
}

/// The fit with weights by which outliers do not count. `solve` gets the steps with their weights.
fn fit_reweighted(
    steps: &[MeasuredStep],
    solve: impl Fn(&[MotionPair], &[f32]) -> Option<MatrixFit>,
) -> Option<MatrixFit> {
    if steps.len() < STEPS_MIN {
        return None;
    }
    let pairs = motions(steps);
    let mut fit = MatrixFit {
        matrix: Matrix3::identity(),
        std: MATRIX_STD,
    };
    for _ in 0..PASSES {
        let errors = matrix_errors(&pairs, &fit.matrix);
        let std = spread(&errors).max(1.0);
        let weights = errors.iter().map(|error| weight(error / std) / (std * std));
        fit = solve(&pairs, &weights.collect::<Vec<_>>())?;
    }
    Some(fit)
}

/// Log likelihood that a matrix gains at the steps, whose spread is estimated with it and without it.
pub fn matrix_gain(steps: &[MeasuredStep], matrix: &Matrix3<f32>) -> f32 {
    let pairs = motions(steps);
    let [before, after] = [Matrix3::identity(), *matrix]
        .map(|matrix| spread(&matrix_errors(&pairs, &matrix)).max(SPREAD_MIN));
    // Two coordinates of each step: the turns rarely differ.
    2.0 * steps.len() as f32 * math::ln(before / after)
}

/// Each step by the wheels and by the poses: metres, metres, radians.
fn motions(steps: &[MeasuredStep]) -> Vec<MotionPair> {
    let vector = |x: f32, y: f32, turn: f32| Vector3::new(x, y, turn);
    let pairs = steps.iter().map(|MeasuredStep { wheels, poses }| {
        (
            vector(wheels.x, wheels.y, wheels.theta),
            vector(poses.x, poses.y, poses.theta),
        )
    });
    pairs.collect()
}

/// Errors of steps with a matrix of the wheels, in their expected standard deviations.
fn matrix_errors(pairs: &[MotionPair], matrix: &Matrix3<f32>) -> Vec<f32> {
    let errors = pairs.iter().map(|(wheels, poses)| {
        let error = matrix * wheels - poses;
        let (position, turn) = (math::hypot(error.x, error.y), error.z);
        math::hypot(position / STEP_STD.0, turn / STEP_STD.1)
    });
    errors.collect()
}
