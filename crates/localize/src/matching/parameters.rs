//! What a match determines: pose and tilt.

use nalgebra::{SMatrix, SVector};

/// Number of parameters: pose and tilt.
pub(crate) const PARAMETERS: usize = 5;
/// A matrix over pose and tilt, (x, y, θ, a, b).
pub type Matrix5 = SMatrix<f32, 5, 5>;
/// A vector over pose and tilt, (x, y, θ, a, b).
pub(crate) type Vector5 = SVector<f32, PARAMETERS>;
