//! One pass over the points at a pose: normal equations of the reweighted squares, and the sums for the quality
//! (docs/methods.md 5.2 to 5.4).

use super::distance_field::DistanceField;
use super::{Matcher, Matrix5, PARAMETERS, Vector5};
use crate::{math, tilt};

/// A point with its quantities that are constant between steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct PreparedPoint {
    pub(super) x: f32,
    pub(super) y: f32,
    /// Variance across the bearing plus the map's variance, m².
    pub(super) tangential_variance: f32,
    /// Radial minus tangential variance over the squared distance.
    pub(super) radial_excess_variance: f32,
}

/// Sums over the points at one pose.
pub(super) struct NormalEquations {
    pub(super) normal: Matrix5,
    pub(super) gradient: Vector5,
    /// Σ w, Σ ψ², Σ ψ′, Σ w d², Σ |d|, Σ (1 − e), inliers.
    pub(super) weight: f32,
    pub(super) psi_squared: f32,
    pub(super) psi_slope: f32,
    pub(super) weighted_squares: f32,
    pub(super) distance_sum: f32,
    pub(super) score: f32,
    pub(super) inliers: f32,
}

impl Matcher {
    /// One pass over the points: normal equations of the reweighted squares, and the sums for the quality.
    pub(super) fn accumulate(
        &self,
        distances: &DistanceField,
        state: &Vector5,
        kernel_factor: f32,
    ) -> NormalEquations {
        let (sin, cos) = math::sin_cos(state[2]);
        let (a, b) = (state[3], state[4]);
        let height = self.config.viewpoint_height;
        let inverse_height = 1.0 / height;
        let kernel_squared = (self.config.kernel_scale_sigmas * kernel_factor).powi(2);
        let mut normal = [0.0_f32; 15];
        let mut gradient = [0.0_f32; PARAMETERS];
        let (mut weight, mut psi_squared, mut psi_slope) = (0.0, 0.0, 0.0);
        let (mut squares, mut deviations, mut score, mut inliers) = (0.0, 0.0, 0.0, 0.0);
        for point in &self.points {
            let [x, y] = tilt::ground_from_map([point.x, point.y], [a, b], height);
            let (rx, ry) = (cos * x - sin * y, sin * x + cos * y);
            let near = distances.nearest(state[0] + rx, state[1] + ry);
            let [nx, ny] = near.normal;
            let radial = nx * rx + ny * ry;
            let variance =
                point.tangential_variance + point.radial_excess_variance * radial * radial;
            // By the tilt: docs/methods.md 3.5.
            let along = radial * inverse_height;
            let row = [nx, ny, ny * rx - nx * ry, x * along, y * along];
            let information = 1.0 / variance;
            let squared = near.signed_distance * near.signed_distance * information;
            // e(t) with t in standard deviations: 1 − e = k²/(k² + t²).
            let kept = kernel_squared / (kernel_squared + squared);
            let root_weight = kept * kept;
            let factor = root_weight * information;
            weight += root_weight;
            psi_squared += root_weight * root_weight * squared;
            psi_slope += root_weight * (4.0 * kept - 3.0);
            squares += root_weight * near.signed_distance * near.signed_distance;
            deviations += near.signed_distance.abs();
            score += kept;
            inliers += f32::from(u8::from(squared < kernel_squared));
            let mut k = 0;
            for i in 0..PARAMETERS {
                let scaled = factor * row[i];
                gradient[i] += scaled * near.signed_distance;
                for value in &row[i..] {
                    normal[k] += scaled * value;
                    k += 1;
                }
            }
        }
        NormalEquations {
            normal: symmetric_from_upper(&normal),
            gradient: Vector5::from(gradient),
            weight,
            psi_squared,
            psi_slope,
            weighted_squares: squares,
            distance_sum: deviations,
            score,
            inliers,
        }
    }
}

/// The full matrix from its upper triangle, row by row.
fn symmetric_from_upper(upper: &[f32; 15]) -> Matrix5 {
    let mut full = Matrix5::zeros();
    let mut k = 0;
    for i in 0..PARAMETERS {
        for j in i..PARAMETERS {
            full[(i, j)] = upper[k];
            full[(j, i)] = upper[k];
            k += 1;
        }
    }
    full
}
