//! Sightings between team-mates: their lasting errors, considered by the joint filter (docs/methods.md 12.5).
//!
//! The error of a mate's pose, and that of a sighting, last for seconds, so that a second sighting by the same mate repeats
//! the error of the first. A Schmidt-Kalman filter considers them: it knows the covariance of each of its states with
//! each error, but does not estimate the errors themselves. So no error counts as independent twice, however often
//! the mate reports, and a pose that was right before does not teach the filter to trust a mate for long.

use nalgebra::{Matrix2, SMatrix, Vector2};

use super::state::{POSE, ROW_STRIDE, STATES, SparseRow, WHEEL_INCREMENT};
use crate::matching::Matrix5;
use crate::math;

/// Errors of each mate: of its pose, of its sightings of us, and of ours of it; x and y on the field each.
pub const ERRORS_PER_MATE: usize = 6;
/// Most mates whose errors are states at the same time.
const MATES_MAX: usize = 4;
/// Errors of all mates.
pub(super) const ERRORS: usize = MATES_MAX * ERRORS_PER_MATE;
/// Multiple of the time for which errors last after which nothing is left of them.
pub(super) const FORGOTTEN_AFTER: f32 = 5.0;

/// A point on the field located by a mate, against its place by the own pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MateMeasurement {
    /// Number of the mate.
    pub robot: u32,
    /// Measured minus predicted position: x, y on the field, metres.
    pub residual: [f32; 2],
    /// Derivative of the predicted position by the own heading, metres per radian. By the own position it is 1.
    pub by_heading: [f32; 2],
    /// Derivative of the measured position by the mate's errors, in units of their standard deviations: metres.
    pub by_errors: [[f32; ERRORS_PER_MATE]; 2],
    /// Variance of the error that does not last, per axis, m².
    pub variance: f32,
}

/// Innovation of a measurement and its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MateInnovation {
    /// Measured minus predicted position, field frame, metres.
    pub innovation: Vector2<f32>,
    /// m².
    pub covariance: Matrix2<f32>,
}

/// Covariance with the mates' errors, in units of their standard deviations: N(0, 1), independent of each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MateErrors {
    /// The mate of each group of errors.
    pub(super) robots: [Option<u32>; MATES_MAX],
    /// Time for which errors last, seconds.
    pub(super) error_time: f32,
    /// Time since they were last forgotten a little, seconds.
    pub(super) elapsed: f32,
    /// Covariance of the filter's states (rows) with the errors.
    pub(super) cross: [[f32; ERRORS]; STATES],
}

impl MateErrors {
    pub(super) fn new(error_time: f32) -> Self {
        MateErrors {
            robots: [None; MATES_MAX],
            error_time,
            elapsed: 0.0,
            cross: [[0.0; ERRORS]; STATES],
        }
    }

    /// Index of a mate's first error. None if there are too many mates.
    pub(super) fn first_error_of(&mut self, robot: u32) -> Option<usize> {
        let known = self.robots.iter().position(|known| *known == Some(robot));
        let place = known.or_else(|| self.robots.iter().position(Option::is_none))?;
        self.robots[place] = Some(robot);
        Some(place * ERRORS_PER_MATE)
    }

    /// Gauss-Markov process over the time since the last call: the errors change, and their covariance with the states
    /// shrinks.
    pub(super) fn forget(&mut self) {
        let kept = math::exp(-std::mem::take(&mut self.elapsed) / self.error_time);
        for value in self.cross.as_flattened_mut() {
            *value *= kept;
        }
    }

    /// C ← F C, as the covariance of the states.
    pub(super) fn propagate(&mut self, rows: &[(usize, SparseRow)]) {
        let old = self.cross;
        for &(row, terms) in rows {
            for &(column, factor) in terms {
                for (value, other) in self.cross[row].iter_mut().zip(&old[column]) {
                    *value += factor * other;
                }
            }
        }
    }

    /// H C of a measurement of the states.
    pub(super) fn project(&self, jacobian: SparseRow) -> [f32; ERRORS] {
        let mut projected = [0.0; ERRORS];
        for &(column, factor) in jacobian {
            for (value, other) in projected.iter_mut().zip(&self.cross[column]) {
                *value += factor * other;
            }
        }
        projected
    }

    /// C ← C − K (H C) of a scalar update. `states`: P Hᵀ; `errors`: H C.
    pub(super) fn reduce(
        &mut self,
        states: &[f32; ROW_STRIDE],
        errors: &[f32; ERRORS],
        innovation_variance: f32,
    ) {
        for (line, state) in self.cross.iter_mut().zip(states) {
            let gain = state / innovation_variance;
            for (value, error) in line.iter_mut().zip(errors) {
                *value -= gain * error;
            }
        }
    }

    /// The same for a measurement of the states.
    pub(super) fn update_scalar(
        &mut self,
        jacobian: SparseRow,
        states: &[f32; ROW_STRIDE],
        innovation_variance: f32,
    ) {
        let errors = self.project(jacobian);
        self.reduce(states, &errors, innovation_variance);
    }

    /// The same for a pose update (docs/methods.md 8.7). `rows`: H; `cross`: P Hᵀ; `information`: S⁻¹.
    pub(super) fn update_by_image(
        &mut self,
        rows: &[Vec<(usize, f32)>; 5],
        cross: &SMatrix<f32, STATES, 5>,
        information: &Matrix5,
        posterior: &Matrix5,
    ) {
        let projected = rows.each_ref().map(|row| self.project(row));
        let projected = SMatrix::<f32, 5, ERRORS>::from_fn(|i, k| projected[i][k]);
        // (S + R)⁻¹ = S⁻¹ (S − P_y) S⁻¹
        let inverse = information - information * posterior * information;
        let step = cross * (inverse * projected);
        for (i, line) in self.cross.iter_mut().enumerate() {
            for (k, value) in line.iter_mut().enumerate() {
                *value -= step[(i, k)];
            }
        }
    }

    /// The pose was moved by something that no sensor reported.
    pub(super) fn decorrelate_pose(&mut self) {
        for line in &mut self.cross[POSE..POSE + 3] {
            *line = [0.0; ERRORS];
        }
    }

    /// The wheels' increment begins anew.
    pub(super) fn restart_wheels(&mut self) {
        for line in &mut self.cross[WHEEL_INCREMENT..WHEEL_INCREMENT + 3] {
            *line = [0.0; ERRORS];
        }
    }
}
