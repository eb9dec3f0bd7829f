//! A clone of the pose at the last image, with its covariance (docs/methods.md 8.14).
//!
//! Whatever corrects the pose later corrects the clone too, as far as both share their error.

use nalgebra::SMatrix;

use super::state::{POSE, ROW_STRIDE, SparseRow, WHEEL_INCREMENT};
use crate::matching::{Matrix5, Vector5};

/// The pose at the last image, and its covariance with the states.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PoseClone {
    /// x, y, θ.
    pub(super) pose: [f32; 3],
    pub(super) covariance: [[f32; 3]; 3],
    /// Covariance of x, y, θ (rows) with the states.
    pub(super) cross: [[f32; ROW_STRIDE]; 3],
}

impl PoseClone {
    /// C ← C Fᵀ, as the covariance of the states.
    pub(super) fn propagate(&mut self, rows: &[(usize, SparseRow)]) {
        for line in &mut self.cross {
            let old = *line;
            for &(row, terms) in rows {
                for &(column, factor) in terms {
                    line[row] += factor * old[column];
                }
            }
        }
    }

    /// C Hᵀ of a measurement of the states.
    fn project(&self, jacobian: SparseRow) -> [f32; 3] {
        self.cross.each_ref().map(|line| {
            let terms = jacobian.iter();
            terms.map(|&(column, factor)| factor * line[column]).sum()
        })
    }

    /// Kalman update by one scalar. `states`: P Hᵀ; `innovation_variance`: S.
    pub(super) fn update_scalar(
        &mut self,
        jacobian: SparseRow,
        states: &[f32; ROW_STRIDE],
        innovation: f32,
        innovation_variance: f32,
    ) {
        let projected = self.project(jacobian);
        for (k, projection) in projected.into_iter().enumerate() {
            let gain = projection / innovation_variance;
            self.pose[k] += gain * innovation;
            for (value, state) in self.cross[k].iter_mut().zip(states) {
                *value -= gain * state;
            }
            for (value, other) in self.covariance[k].iter_mut().zip(projected) {
                *value -= gain * other;
            }
        }
    }

    /// Update by an image (docs/methods.md 8.7). `rows`: H; `information`: S⁻¹; `innovation`: ŷ − y; `reduction`: S − P_y;
    /// `gain`: K of the states.
    pub(super) fn update_by_image(
        &mut self,
        rows: &[Vec<(usize, f32)>; 5],
        information: &Matrix5,
        innovation: &Vector5,
        reduction: &Matrix5,
        gain: &SMatrix<f32, ROW_STRIDE, 5>,
    ) {
        let projected = rows.each_ref().map(|row| self.project(row));
        let projected = SMatrix::<f32, 3, 5>::from_fn(|k, i| projected[i][k]);
        let own_gain = projected * information;
        let step = own_gain * innovation;
        let weighted = own_gain * reduction;
        let (of_states, own) = (weighted * gain.transpose(), weighted * own_gain.transpose());
        for k in 0..3 {
            self.pose[k] += step[k];
            for (i, value) in self.cross[k].iter_mut().enumerate() {
                *value -= of_states[(k, i)];
            }
            for (l, value) in self.covariance[k].iter_mut().enumerate() {
                *value -= 0.5 * (own[(k, l)] + own[(l, k)]);
            }
        }
    }

    /// The wheels' increment begins anew.
    pub(super) fn restart_wheels(&mut self) {
        for line in &mut self.cross {
            line[WHEEL_INCREMENT..WHEEL_INCREMENT + 3].fill(0.0);
        }
    }

    /// Only the pose keeps its covariance with the clone: it was inflated, and decorrelated from the other states.
    pub(super) fn decorrelate_other_states(&mut self) {
        for line in &mut self.cross {
            line[POSE + 3..].fill(0.0);
        }
    }

    /// A step (x, y, θ) of the pose that is no motion.
    pub(super) fn shift(&mut self, step: [f32; 3]) {
        for (value, step) in self.pose.iter_mut().zip(step) {
            *value += step;
        }
    }

    /// An error of this variance that the pose has in common with the clone.
    pub(super) fn inflate_common(&mut self, axis: usize, variance: f32) {
        self.covariance[axis][axis] += variance;
        self.cross[axis][POSE + axis] += variance;
    }
}
