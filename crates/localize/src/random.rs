//! Random numbers from a generator that the caller owns.

use rand::{Rng, RngExt};

/// One draw of the standard normal distribution (Box-Muller).
pub fn standard_normal(rng: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}
