//! Random numbers from a generator that the caller owns.

use rand::{Rng, RngExt};

use crate::math;

/// One draw of the standard normal distribution (Box-Muller).
pub fn standard_normal(rng: &mut impl Rng) -> f32 {
    let radius = (-2.0 * math::ln(1.0 - rng.random::<f32>())).sqrt();
    radius * math::cos(std::f32::consts::TAU * rng.random::<f32>())
}
