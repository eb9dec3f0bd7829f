//! What do wheels tell about a map? (docs/methods.md 2.13)

use nalgebra::Matrix2;

use super::state::MapCorrection;
use super::sums::TermVector;
use crate::math;
use crate::wheel_steps::OriginOffset;

impl MapCorrection {
    /// Takes where the origin of the poses lies at the present image, for the next [`MapCorrection::observe`]. None: the wheels do
    /// not tell.
    pub fn take_origin(&mut self, measured: Option<&OriginOffset>, theta: f32) {
        let Some(measured) = measured else {
            self.origin_by_wheels.forget();
            return;
        };
        let (sin, cos) = math::sin_cos(theta);
        let [sin, cos] = [sin, cos].map(f64::from);
        let robot_from_field = Matrix2::new(cos, sin, -sin, cos);
        let by_term = robot_from_field * self.sensitivity.fixed_rows::<2>(0);
        self.origin_by_wheels
            .update(measured, by_term, &self.claim.by_images);
    }

    /// The best estimate of the unknowns by images and wheels, from the map in use.
    pub(super) fn best_step(&self) -> TermVector {
        let step = self.coefficients - self.applied;
        step - self.claim.covariance * self.origin_by_wheels.gradient(&step)
    }
}
