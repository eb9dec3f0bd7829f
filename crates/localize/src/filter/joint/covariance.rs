//! Kernels of the filter equations: P ← F P Fᵀ, P ← P + v vᵀ q, and the scalar Kalman update, with sparse rows.

use super::JointFilter;
use super::state::{POSE, ROW_STRIDE, SparseRow};
use crate::frames::wrap_angle;

/// Smallest variance, resolved by single precision next to one metre squared.
pub(super) const VARIANCE_MIN: f32 = 1e-13;

impl JointFilter {
    /// P ← F P Fᵀ. `rows`: index and entries of each nonzero row of F − I.
    pub(super) fn propagate_covariance(&mut self, rows: &[(usize, SparseRow)]) {
        let p = &mut self.covariance;
        let old = *p;
        for &(row, terms) in rows {
            for &(column, factor) in terms {
                for (value, other) in p[row].iter_mut().zip(&old[column]) {
                    *value += factor * other;
                }
            }
        }
        for line in p.iter_mut() {
            let old = *line;
            for &(row, terms) in rows {
                for &(column, factor) in terms {
                    line[row] += factor * old[column];
                }
            }
        }
        if let Some(errors) = &mut self.mate_errors {
            errors.propagate(rows);
        }
        if let Some(clone) = &mut self.image_clone {
            clone.propagate(rows);
        }
    }

    /// P ← P + v vᵀ · `variance`.
    pub(super) fn add_rank_one_noise(&mut self, vector: SparseRow, variance: f32) {
        for &(i, a) in vector {
            for &(j, b) in vector {
                self.covariance[i][j] += variance * a * b;
            }
        }
    }

    /// P[k][k] ← P[k][k] + `variance`.
    pub(super) fn inflate_variance(&mut self, k: usize, variance: f32) {
        self.covariance[k][k] += variance;
    }

    /// Kalman update by one scalar: H as a sparse row, the innovation and its variance R. Returns S = H P Hᵀ + R.
    pub(super) fn update_scalar(
        &mut self,
        jacobian: SparseRow,
        innovation: f32,
        variance: f32,
    ) -> f32 {
        // P Hᵀ
        let mut cross = [0.0; ROW_STRIDE];
        for &(column, factor) in jacobian {
            for (value, other) in cross.iter_mut().zip(&self.covariance[column]) {
                *value += factor * other;
            }
        }
        // S = H P Hᵀ + R
        let innovation_variance: f32 = jacobian
            .iter()
            .map(|&(column, factor)| factor * cross[column])
            .sum::<f32>()
            + variance;
        if !(innovation_variance > 0.0) {
            return innovation_variance;
        }
        let normalized = innovation / innovation_variance;
        if let Some(errors) = &mut self.mate_errors {
            errors.update_scalar(jacobian, &cross, innovation_variance);
        }
        if let Some(clone) = &mut self.image_clone {
            clone.update_scalar(jacobian, &cross, innovation, innovation_variance);
        }
        for (value, cross) in self.state.iter_mut().zip(&cross) {
            *value += cross * normalized;
        }
        for (i, line) in self.covariance.iter_mut().enumerate() {
            let gain = cross[i] / innovation_variance;
            for (value, cross) in line.iter_mut().zip(&cross) {
                *value -= gain * cross;
            }
            line[i] = line[i].max(VARIANCE_MIN);
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        innovation_variance
    }
}
