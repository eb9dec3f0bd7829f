//! Sightings between team-mates: their lasting errors, considered by the joint filter (docs/methods.md 12.5).
//!
//! The error of a mate's pose, and that of a sighting, last for seconds, so that a second sighting by the same mate repeats
//! the error of the first. A Schmidt-Kalman filter considers them: it knows the covariance of each of its states with
//! each error, but does not estimate the errors themselves. So no error counts as independent twice, however often
//! the mate reports, and a pose that was right before does not teach the filter to trust a mate for long.

use nalgebra::{Matrix2, SMatrix, Vector2};

use super::JointFilter;
use super::covariance::VARIANCE_MIN;
use super::state::{LATENCY, POSE, ROW_STRIDE, STATES, SparseRow, WHEEL_INCREMENT};
use crate::filter::FilterConfig;
use crate::frames::wrap_angle;
use crate::matching::Matrix5;
use crate::math;

/// Errors of each mate: of its pose, of its sightings of us, and of ours of it; x and y on the field each.
pub const ERRORS_PER_MATE: usize = 6;
/// Most mates whose errors are states at the same time.
const MATES_MAX: usize = 4;
/// Errors of all mates.
const ERRORS: usize = MATES_MAX * ERRORS_PER_MATE;
/// Multiple of the time for which errors last after which nothing is left of them.
const FORGOTTEN_AFTER: f32 = 5.0;

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
    robots: [Option<u32>; MATES_MAX],
    /// Time for which errors last, seconds.
    error_time: f32,
    /// Time since they were last forgotten a little, seconds.
    elapsed: f32,
    /// Covariance of the filter's states (rows) with the errors.
    cross: [[f32; ERRORS]; STATES],
}

impl MateErrors {
    fn new(error_time: f32) -> Self {
        MateErrors {
            robots: [None; MATES_MAX],
            error_time,
            elapsed: 0.0,
            cross: [[0.0; ERRORS]; STATES],
        }
    }

    /// Index of a mate's first error. None if there are too many mates.
    fn first_error_of(&mut self, robot: u32) -> Option<usize> {
        let known = self.robots.iter().position(|known| *known == Some(robot));
        let place = known.or_else(|| self.robots.iter().position(Option::is_none))?;
        self.robots[place] = Some(robot);
        Some(place * ERRORS_PER_MATE)
    }

    /// Gauss-Markov process over the time since the last call: the errors change, and their covariance with the states
    /// shrinks.
    fn forget(&mut self) {
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
    fn project(&self, jacobian: SparseRow) -> [f32; ERRORS] {
        let mut projected = [0.0; ERRORS];
        for &(column, factor) in jacobian {
            for (value, other) in projected.iter_mut().zip(&self.cross[column]) {
                *value += factor * other;
            }
        }
        projected
    }

    /// C ← C − K (H C) of a scalar update. `states`: P Hᵀ; `errors`: H C.
    fn reduce(
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

impl JointFilter {
    /// Counts the time over which the mates' errors are forgotten.
    pub(super) fn age_mate_errors(&mut self, seconds: f32) {
        if let Some(errors) = &mut self.mate_errors {
            errors.elapsed += seconds;
            if errors.elapsed > FORGOTTEN_AFTER * errors.error_time {
                self.mate_errors = None;
            }
        }
    }

    /// Innovation of a mate's measurement, by what is known of its errors. `error_time`: for which they last, seconds.
    /// None if there are too many mates.
    pub(in crate::filter) fn mate_innovation(
        &mut self,
        measurement: &MateMeasurement,
        error_time: f32,
    ) -> Option<MateInnovation> {
        let errors = self
            .mate_errors
            .get_or_insert_with(|| Box::new(MateErrors::new(error_time)));
        errors.error_time = error_time;
        errors.forget();
        let first = errors.first_error_of(measurement.robot)?;
        let rows = [0, 1].map(|axis| MateRow::new(measurement, axis, first));
        let covariance = Matrix2::from_fn(|i, j| {
            let (states, errors) = self.mate_cross(&rows[j]);
            let white = if i == j { measurement.variance } else { 0.0 };
            rows[i].dot(&states, &errors) + white
        });
        Some(MateInnovation {
            innovation: Vector2::from(measurement.residual),
            covariance: (covariance + covariance.transpose()) * 0.5,
        })
    }

    /// Updates by a mate's measurement whose innovation was accepted. The wheels' noise learns nothing from it.
    pub(in crate::filter) fn update_by_mate(
        &mut self,
        measurement: &MateMeasurement,
        config: &FilterConfig,
    ) {
        let first = self
            .mate_errors
            .as_mut()
            .and_then(|errors| errors.first_error_of(measurement.robot));
        let Some(first) = first else {
            return;
        };
        let pose = self.pose();
        for axis in 0..2 {
            let row = MateRow::new(measurement, axis, first);
            let (states, errors) = self.mate_cross(&row);
            let variance = row.dot(&states, &errors) + measurement.variance;
            if !(variance > 0.0) {
                continue;
            }
            // The step along the first axis changes the prediction of the second.
            let moved = self.pose().difference(pose);
            let predicted = moved[axis] + row.by_heading * moved[2];
            let normalized = (measurement.residual[axis] - predicted) / variance;
            for (value, cross) in self.state.iter_mut().zip(&states) {
                *value += cross * normalized;
            }
            self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
            for (i, line) in self.covariance.iter_mut().enumerate() {
                let gain = states[i] / variance;
                for (value, cross) in line.iter_mut().zip(&states) {
                    *value -= gain * cross;
                }
                line[i] = line[i].max(VARIANCE_MIN);
            }
            if let Some(mates) = &mut self.mate_errors {
                mates.reduce(&states, &errors, variance);
            }
        }
        self.clamp_scales();
        if config.camera_latency_std == 0.0 {
            self.state[LATENCY] = config.camera_latency;
        }
        // What it corrected was not the wheels' noise alone.
        self.wheel_noise = self.wheel_noise.without_derivatives();
    }

    /// P Hᵀ of the states and of the errors.
    fn mate_cross(&self, row: &MateRow) -> ([f32; ROW_STRIDE], [f32; ERRORS]) {
        let mut states = [0.0; ROW_STRIDE];
        let jacobian = [(POSE + row.axis, 1.0), (POSE + 2, row.by_heading)];
        for (column, factor) in jacobian {
            for (value, other) in states.iter_mut().zip(&self.covariance[column]) {
                *value += factor * other;
            }
        }
        let Some(mates) = &self.mate_errors else {
            return (states, [0.0; ERRORS]);
        };
        let mut errors = mates.project(&jacobian);
        for (k, factor) in row.by_errors.into_iter().enumerate() {
            let error = row.first_error + k;
            for (value, cross) in states.iter_mut().zip(&mates.cross) {
                *value += factor * cross[error];
            }
            errors[error] += factor;
        }
        (states, errors)
    }
}

/// Row of H: position along an axis, heading, and the mate's errors.
#[derive(Debug, Clone, Copy)]
struct MateRow {
    axis: usize,
    by_heading: f32,
    by_errors: [f32; ERRORS_PER_MATE],
    first_error: usize,
}

impl MateRow {
    fn new(measurement: &MateMeasurement, axis: usize, first_error: usize) -> Self {
        MateRow {
            axis,
            by_heading: measurement.by_heading[axis],
            by_errors: measurement.by_errors[axis],
            first_error,
        }
    }

    /// H · (P Hᵀ).
    fn dot(&self, states: &[f32; ROW_STRIDE], errors: &[f32; ERRORS]) -> f32 {
        let of_errors: f32 = self
            .by_errors
            .iter()
            .zip(&errors[self.first_error..])
            .map(|(factor, error)| factor * error)
            .sum();
        states[POSE + self.axis] + self.by_heading * states[POSE + 2] + of_errors
    }
}
