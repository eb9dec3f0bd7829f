//! Which rotation, scale, unevenness and offset make the wheels' steps those of the poses?

use nalgebra::{Complex, Matrix3, Vector3};

use super::step::{MeasuredStep, PASSES, STEP_STD, spread, weight};
use crate::math;

/// Standard deviation of what right wheels may have: the share by which they measure one direction longer than another.
pub(super) const UNEVEN_STD: f32 = 0.04;
/// Standard deviation of the offset of an origin of which nothing is known, metres.
pub(super) const OFFSET_STD: f32 = 0.5;
/// Standard deviation of the factor from the motion of wheels in order to that of the poses.
pub(super) const KNOWN_FACTOR_STD: f32 = 0.2;
/// Passes end with a smaller change: metres, shares.
const SAME_FIT: f32 = 1e-4;

/// What makes the wheels' steps those of the poses. Numbers of the plane are complex: x + iy.
pub(super) struct StepFit {
    /// Rotation and scale.
    pub(super) factor: Complex<f32>,
    /// Factor of the conjugate: directions of unequal length.
    pub(super) unevenness: Complex<f32>,
    /// Offset of the poses' origin, metres.
    pub(super) offset: Complex<f32>,
    /// Variances of their real and imaginary parts, in this order.
    pub(super) variances: [f32; 3],
}

impl StepFit {
    /// Fits steps, with a factor that is expected to be `direction`, up to `std`.
    ///
    /// Turns tell a step with slip as well as positions do.
    pub(super) fn fit(steps: &[MeasuredStep], direction: Complex<f32>, std: f32) -> Option<Self> {
        let steps: Vec<ComplexStep> = steps.iter().map(ComplexStep::new).collect();
        let mut fitted = Vector3::new(direction, Complex::ZERO, Complex::ZERO);
        let mut turn_factor = 1.0;
        let prior =
            Vector3::new(std, UNEVEN_STD, OFFSET_STD).map(|std| Complex::from(1.0 / (std * std)));
        let turn_prior = 1.0 / (KNOWN_FACTOR_STD * KNOWN_FACTOR_STD);
        // Six fitted numbers make few steps look better than they are.
        let coordinates = 2.0 * steps.len() as f32;
        let freedom = coordinates / (coordinates - 6.0);
        let mut variances = [0.0; 3];
        let mut errors = vec![0.0; steps.len()];
        for _ in 0..PASSES {
            for (error, step) in errors.iter_mut().zip(&steps) {
                *error = step.error(&fitted, turn_factor);
            }
            let spread = (spread(&errors) * freedom.sqrt()).max(1.0);
            let mut information = Matrix3::from_diagonal(&prior);
            let mut vector = Vector3::new(direction * prior[0], Complex::ZERO, Complex::ZERO);
            let (mut turn_information, mut turn_vector) = (turn_prior, turn_prior);
            for (error, step) in errors.iter().zip(&steps) {
                let weight = weight(error / spread) / (spread * spread);
                let share = weight / (STEP_STD.0 * STEP_STD.0);
                let terms = step.terms();
                let weighted = terms.map(|term| term.conj() * share);
                information += weighted * terms.transpose();
                vector += weighted * step.poses;
                let share = weight / (STEP_STD.1 * STEP_STD.1);
                turn_information += step.turns.0 * step.turns.0 * share;
                turn_vector += step.turns.0 * step.turns.1 * share;
            }
            let covariance = information.try_inverse()?;
            let before = fitted;
            fitted = covariance * vector;
            turn_factor = turn_vector / turn_information;
            variances = [0, 1, 2].map(|k| covariance[(k, k)].re);
            if (fitted - before).norm_squared() < SAME_FIT * SAME_FIT {
                break;
            }
        }
        let [factor, unevenness, offset] = fitted.into();
        Some(StepFit {
            factor,
            unevenness,
            offset,
            variances,
        })
    }
}

/// A step in complex numbers.
struct ComplexStep {
    wheels: Complex<f32>,
    poses: Complex<f32>,
    /// Motion of a point ahead of the centre by one metre.
    swing: Complex<f32>,
    /// By the wheels and by the poses, radians.
    turns: (f32, f32),
}

impl ComplexStep {
    fn new(MeasuredStep { wheels, poses }: &MeasuredStep) -> Self {
        let (sin, cos) = math::sin_cos(poses.theta);
        ComplexStep {
            wheels: Complex::new(wheels.x, wheels.y),
            poses: Complex::new(poses.x, poses.y),
            swing: Complex::new(cos - 1.0, sin),
            turns: (wheels.theta, poses.theta),
        }
    }

    /// What the factor, the unevenness and the offset are multiplied by.
    fn terms(&self) -> Vector3<Complex<f32>> {
        Vector3::new(self.wheels, self.wheels.conj(), self.swing)
    }

    /// Error of a fit, in standard deviations that are expected.
    fn error(&self, fitted: &Vector3<Complex<f32>>, turn_factor: f32) -> f32 {
        let error = self.terms().dot(fitted) - self.poses;
        let turn = (turn_factor * self.turns.0 - self.turns.1) / STEP_STD.1;
        (error.norm_sqr() / (STEP_STD.0 * STEP_STD.0) + turn * turn).sqrt()
    }
}
