//! Normal equations of one image over pose, tilt and the map's unknowns.

use nalgebra::{SMatrix, SVector};

use super::term::TERMS_MAX;
use crate::matching::{Matrix5, PARAMETERS};

/// A matrix over the map's unknowns.
pub(super) type TermMatrix = SMatrix<f64, TERMS_MAX, TERMS_MAX>;
/// A vector over the map's unknowns.
pub(super) type TermVector = SVector<f64, TERMS_MAX>;
/// Pose and tilt by the map's unknowns.
pub(super) type PoseByTerm = SMatrix<f64, PARAMETERS, TERMS_MAX>;
/// A matrix over pose and tilt.
pub(super) type PoseMatrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
/// A vector over pose and tilt.
pub(super) type PoseVector = SVector<f64, PARAMETERS>;

/// Sums of weight × row × rowᵀ over the points.
#[derive(Debug, Clone)]
pub(super) struct ImageSums {
    /// Number of unknowns in use.
    terms: usize,
    pose: [[f32; PARAMETERS]; PARAMETERS],
    cross: [[f32; TERMS_MAX]; PARAMETERS],
    map: [[f32; TERMS_MAX]; TERMS_MAX],
    pose_gradient: [f32; PARAMETERS],
    map_gradient: [f32; TERMS_MAX],
    /// Σ weight d²/σ².
    pub(super) squares: f32,
    /// Σ robust weight.
    pub(super) weight: f32,
}

/// What one image says about the map, pose and tilt eliminated.
#[derive(Debug, Clone)]
pub(super) struct MapEvidence {
    pub(super) information: TermMatrix,
    /// Of the negative log likelihood at the present coefficients.
    pub(super) gradient: TermVector,
    /// Squared residuals that pose and tilt cannot explain.
    pub(super) squares: f64,
}

impl ImageSums {
    pub(super) fn new(terms: usize) -> Self {
        ImageSums {
            terms,
            pose: [[0.0; PARAMETERS]; PARAMETERS],
            cross: [[0.0; TERMS_MAX]; PARAMETERS],
            map: [[0.0; TERMS_MAX]; TERMS_MAX],
            pose_gradient: [0.0; PARAMETERS],
            map_gradient: [0.0; TERMS_MAX],
            squares: 0.0,
            weight: 0.0,
        }
    }

    /// Adds a point at signed distance `distance` with its derivatives by pose and tilt, and by the map's unknowns.
    pub(super) fn add(
        &mut self,
        pose_row: &[f32; PARAMETERS],
        map_row: &[f32; TERMS_MAX],
        distance: f32,
        robust_weight: f32,
        variance: f32,
    ) {
        let factor = robust_weight / variance;
        for i in 0..PARAMETERS {
            let scaled = factor * pose_row[i];
            self.pose_gradient[i] += scaled * distance;
            for (sum, value) in self.pose[i].iter_mut().zip(pose_row) {
                *sum += scaled * value;
            }
            for (sum, value) in self.cross[i][..self.terms].iter_mut().zip(map_row) {
                *sum += scaled * value;
            }
        }
        for i in 0..self.terms {
            let scaled = factor * map_row[i];
            self.map_gradient[i] += scaled * distance;
            for (sum, value) in self.map[i][..=i].iter_mut().zip(map_row) {
                *sum += scaled * value;
            }
        }
        self.squares += factor * distance * distance;
        self.weight += robust_weight;
    }

    /// Adds a point to pose by map alone; `factor`: weight over variance.
    pub(super) fn add_cross(
        &mut self,
        pose_row: &[f32; PARAMETERS],
        map_row: &[f32; TERMS_MAX],
        factor: f32,
    ) {
        for (sums, derivative) in self.cross.iter_mut().zip(pose_row) {
            let scaled = factor * derivative;
            for (sum, value) in sums[..self.terms].iter_mut().zip(map_row) {
                *sum += scaled * value;
            }
        }
    }

    fn pose_information(&self) -> PoseMatrix {
        PoseMatrix::from_fn(|i, j| f64::from(self.pose[i][j]))
    }

    pub(super) fn cross_information(&self) -> PoseByTerm {
        PoseByTerm::from_fn(|i, j| f64::from(self.cross[i][j]))
    }

    /// The step of pose and tilt that belongs to a step of the map's unknowns.
    pub(super) fn pose_step(
        &self,
        prior: &PoseMatrix,
        deviation: &PoseVector,
        map_step: &TermVector,
    ) -> Option<PoseVector> {
        let cholesky = (self.pose_information() + prior).cholesky()?;
        let gradient = self.pose_gradient() + prior * deviation;
        Some(-cholesky.solve(&(gradient + self.cross_information() * map_step)))
    }

    fn pose_gradient(&self) -> PoseVector {
        PoseVector::from_fn(|i, _| f64::from(self.pose_gradient[i]))
    }

    /// Eliminates pose and tilt under the prior information `prior` (Schur complement). `deviation`: of pose and tilt from
    /// their expectation.
    pub(super) fn eliminate_pose(
        &self,
        prior: &PoseMatrix,
        deviation: &PoseVector,
    ) -> Option<MapEvidence> {
        let cholesky = (self.pose_information() + prior).cholesky()?;
        let cross = self.cross_information();
        let pose_gradient = self.pose_gradient() + prior * deviation;
        let explained = cholesky.solve(&cross);
        let map = TermMatrix::from_fn(|i, j| f64::from(self.map[i.max(j)][i.min(j)]));
        let map_gradient = TermVector::from_fn(|i, _| f64::from(self.map_gradient[i]));
        let information = map - cross.transpose() * explained;
        Some(MapEvidence {
            information: (information + information.transpose()) * 0.5,
            gradient: map_gradient - explained.transpose() * pose_gradient,
            squares: f64::from(self.squares) - pose_gradient.dot(&cholesky.solve(&pose_gradient)),
        })
    }
}

/// A single-precision matrix over pose and tilt in double precision.
pub(super) fn widen(matrix: &Matrix5) -> PoseMatrix {
    matrix.map(f64::from)
}
