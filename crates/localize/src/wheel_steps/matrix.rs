//! By which matrix do the wheels differ from the poses?

use nalgebra::{Matrix3, Vector3};

use super::step::{MeasuredStep, PASSES, STEP_STD, STEPS_MIN, spread, weight};
use crate::math;

/// Standard deviation of the elements of a matrix of wrong wheels.
const MATRIX_STD: f32 = 0.3;
/// Smallest spread of steps: that of poses on a perfect map, shares of the expected errors.
const SPREAD_MIN: f32 = 0.2;

/// The matrix by which the wheels' motion (metres, metres, radians) becomes that of the poses. None for too few steps.
pub fn matrix_between(steps: &[MeasuredStep]) -> Option<Matrix3<f32>> {
    if steps.len() < STEPS_MIN {
        return None;
    }
    let pairs = motions(steps);
    let mut matrix = Matrix3::identity();
    for _ in 0..PASSES {
        let errors = matrix_errors(&pairs, &matrix);
        let std = spread(&errors).max(1.0);
        let mut information = Matrix3::identity() / (MATRIX_STD * MATRIX_STD);
        let mut products = information;
        for ((wheels, poses), error) in pairs.iter().zip(&errors) {
            let weight = weight(error / std) / (STEP_STD.0 * std).powi(2);
            information += wheels * wheels.transpose() * weight;
            products += poses * wheels.transpose() * weight;
        }
        matrix = products * information.try_inverse()?;
    }
    Some(matrix)
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
fn motions(steps: &[MeasuredStep]) -> Vec<(Vector3<f32>, Vector3<f32>)> {
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
fn matrix_errors(pairs: &[(Vector3<f32>, Vector3<f32>)], matrix: &Matrix3<f32>) -> Vec<f32> {
    let errors = pairs.iter().map(|(wheels, poses)| {
        let error = matrix * wheels - poses;
        let (position, turn) = (math::hypot(error.x, error.y), error.z);
        math::hypot(position / STEP_STD.0, turn / STEP_STD.1)
    });
    errors.collect()
}
