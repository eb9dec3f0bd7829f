//! Minimisation of the robust error: Gauss-Newton (docs/methods.md 5.4) or RPROP (5.5).

use nalgebra::Vector3;

use super::distance_field::DistanceField;
use super::normal_equations::{NormalEquations, Pass};
use super::{Matcher, Matrix5, Vector5};

impl Matcher {
    /// One pass over the points: normal equations of the reweighted squares, and the sums for the quality.
    pub(super) fn accumulate(
        &self,
        distances: &DistanceField,
        state: &Vector5,
        kernel_factor: f32,
    ) -> NormalEquations {
        self.pass(state, kernel_factor)
            .accumulate(&self.lanes, distances)
    }

    pub(super) fn pass(&self, state: &Vector5, kernel_factor: f32) -> Pass {
        let kernel_scale = self.config.kernel_scale_sigmas * kernel_factor;
        Pass::new(state, self.config.viewpoint_height, kernel_scale)
    }

    /// Gauss-Newton; the kernel scale is halved with every step until it is that of the points.
    pub(super) fn gauss_newton(
        &self,
        distances: &DistanceField,
        state: &mut Vector5,
        mut kernel_factor: f32,
    ) -> usize {
        for steps in 1..=self.config.steps_max {
            let sums = self.accumulate(distances, state, kernel_factor);
            let step = self.gauss_newton_step(&sums, state);
            *state += step;
            if kernel_factor > 1.0 {
                kernel_factor = (kernel_factor * 0.5).max(1.0);
            } else if step.fixed_rows::<3>(0).amax() < self.config.convergence_step {
                return steps;
            }
        }
        self.config.steps_max
    }

    /// RPROP over (x, y, θ): each parameter's step grows by 1.2 while the derivative keeps its sign and is halved when
    /// the sign changes (nubot2013 4 after Lauer et al.). The tilt is not estimated.
    pub(super) fn rprop(
        &self,
        distances: &DistanceField,
        state: &mut Vector5,
        mut kernel_factor: f32,
    ) -> usize {
        let mut steps = Vector3::from_element(0.02_f32);
        let mut last = Vector3::zeros();
        for count in 1..=self.config.steps_max {
            let sums = self.accumulate(distances, state, kernel_factor);
            let (_, prior_gradient) = self.prior_terms(state);
            let gradient = (sums.gradient + prior_gradient)
                .fixed_rows::<3>(0)
                .into_owned();
            for i in 0..3 {
                let kept: f32 = last[i] * gradient[i];
                if kept > 0.0 {
                    steps[i] = (steps[i] * 1.2).min(0.3);
                } else if kept < 0.0 {
                    steps[i] *= 0.5;
                }
                if gradient[i] != 0.0 {
                    state[i] -= steps[i] * gradient[i].signum();
                }
            }
            last = gradient;
            kernel_factor = (kernel_factor * 0.8).max(1.0);
            if steps.amax() < self.config.convergence_step {
                return count;
            }
        }
        self.config.steps_max
    }

    /// Initial factor of the kernel scale, such that it covers `start_error` metres.
    pub(super) fn kernel_start_factor(&self, start_error: f32) -> f32 {
        let variance = self
            .points
            .iter()
            .map(|point| point.tangential_variance)
            .sum::<f32>()
            / self.points.len().max(1) as f32;
        (start_error / (self.config.kernel_scale_sigmas * variance.sqrt())).clamp(1.0, 16.0)
    }

    /// The prior's part of the normal equations: matrix and gradient.
    fn prior_terms(&self, state: &Vector5) -> (Matrix5, Vector5) {
        let difference = self.prior_difference(state);
        let deviation = difference.with_tilt([state[3], state[4]]);
        (
            difference.information(&self.prior.information) * self.repetition,
            difference.gradient(self.prior.information * deviation) * self.repetition,
        )
    }

    /// The Gauss-Newton step with the prior; zero if the normal equations are singular.
    fn gauss_newton_step(&self, sums: &NormalEquations, state: &Vector5) -> Vector5 {
        let (prior_normal, prior_gradient) = self.prior_terms(state);
        let normal = sums.normal + prior_normal;
        let gradient = sums.gradient + prior_gradient;
        let Some(cholesky) = normal.cholesky() else {
            return Vector5::zeros();
        };
        let mut step = -cholesky.solve(&gradient);
        // A larger step would leave the region that the points were linearised in.
        let size = step.fixed_rows::<3>(0).amax();
        if size > 0.5 {
            step *= 0.5 / size;
        }
        step
    }
}
