//! Updates of the joint filter by sightings between team-mates (docs/methods.md 12.5).

use nalgebra::{Matrix2, Vector2};

use super::JointFilter;
use super::covariance::VARIANCE_MIN;
use super::mate_errors::{
    ERRORS, ERRORS_PER_MATE, FORGOTTEN_AFTER, MateErrors, MateInnovation, MateMeasurement,
};
use super::state::{LATENCY, POSE, ROW_STRIDE, STATES};
use crate::filter::config::FilterConfig;
use crate::frames::wrap_angle;

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
        // No image does it while the robot sees none, and what rounding adds to one side grows.
        for i in 0..STATES {
            for j in 0..i {
                let mean = 0.5 * (self.covariance[i][j] + self.covariance[j][i]);
                self.covariance[i][j] = mean;
                self.covariance[j][i] = mean;
            }
        }
        self.clamp_scales();
        if config.camera_latency_std == 0.0 {
            self.state[LATENCY] = config.camera_latency;
        }
        self.follow_correction(self.pose().difference(pose).into());
        // What it corrected was not the wheels' noise alone.
        self.wheel_noise = self.wheel_noise.without_derivatives();
    }

    /// Adds errors to the pose: mates contradict it.
    pub(in crate::filter) fn doubt_pose(&mut self, position_std: f32, heading_std: f32) {
        for (axis, std) in [position_std, position_std, heading_std]
            .into_iter()
            .enumerate()
        {
            self.add_common_error(axis, std * std);
        }
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

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector, Matrix3};

    use super::*;
    use crate::filter::{OdometryPrior, PoseFilter, PredictionInput};
    use crate::frames::Pose;

    const PRIOR_STD: f32 = 0.5;

    fn filter() -> JointFilter {
        let variances = [PRIOR_STD * PRIOR_STD, PRIOR_STD * PRIOR_STD, 0.01];
        JointFilter::new(
            Pose::new(1.0, -2.0, 0.7),
            &Matrix3::from_diagonal(&variances.into()),
            None,
            &FilterConfig::default(),
            &OdometryPrior::default(),
        )
    }

    /// A sighting by a mate with these standard deviations of its pose and of its sighting, metres.
    fn sighting(robot: u32, residual: [f32; 2], pose_std: f32, std: f32) -> MateMeasurement {
        let mut by_errors = [[0.0; ERRORS_PER_MATE]; 2];
        (by_errors[0][0], by_errors[1][1]) = (pose_std, pose_std);
        (by_errors[0][2], by_errors[1][3]) = (std, std);
        MateMeasurement {
            robot,
            residual,
            by_heading: [0.0; 2],
            by_errors,
            variance: 4e-4,
        }
    }

    /// Accepts a sighting without time in between.
    fn update(filter: &mut JointFilter, measurement: &MateMeasurement) {
        filter.mate_innovation(measurement, 5.0).expect("a place");
        filter.update_by_mate(measurement, &FilterConfig::default());
    }

    #[test]
    fn sightings_by_one_mate_count_once() {
        let mut filter = filter();
        let measurement = sighting(2, [0.0; 2], 0.03, 0.06);
        for _ in 0..1000 {
            update(&mut filter, &measurement);
        }
        // Prior and mate alone, whose variance is (3² + 6²) cm².
        let mate = 0.0045_f32;
        let once = 1.0 / (1.0 / mate + 1.0 / (PRIOR_STD * PRIOR_STD));
        let variance = filter.covariance()[(0, 0)];
        assert!(
            variance > 0.97 * once && variance < 1.03 * once,
            "{variance} {once}"
        );
    }

    #[test]
    fn second_mate_halves_the_variance_and_a_fifth_one_is_refused() {
        let mut filter = filter();
        for robot in 2..4 {
            for _ in 0..1000 {
                update(&mut filter, &sighting(robot, [0.0; 2], 0.03, 0.06));
            }
        }
        // A Schmidt-Kalman filter weighs mates by the order of their sightings, so that it keeps a little more.
        let variance = filter.covariance()[(0, 0)];
        assert!((0.0020..0.0035).contains(&variance), "{variance}");
        for robot in 4..6 {
            update(&mut filter, &sighting(robot, [0.0; 2], 0.03, 0.06));
        }
        let fifth = sighting(6, [0.0; 2], 0.03, 0.06);
        assert_eq!(filter.mate_innovation(&fifth, 5.0), None);
    }

    #[test]
    fn errors_are_independent_again_after_their_time() {
        let measurement = sighting(2, [0.0; 2], 0.03, 0.06);
        let variance_after = |seconds: f32| {
            let mut filter = filter();
            for _ in 0..100 {
                update(&mut filter, &measurement);
            }
            filter.age_mate_errors(seconds);
            for _ in 0..100 {
                update(&mut filter, &measurement);
            }
            filter.covariance()[(0, 0)]
        };
        let [at_once, later] = [0.0, 20.0].map(variance_after);
        assert!(later < 0.7 * at_once, "{later} {at_once}");
    }

    /// The Schmidt-Kalman filter written down for (x, y, θ) and the errors of a mate, without any of the kernels.
    struct Dense {
        covariance: DMatrix<f64>,
    }

    impl Dense {
        const SIZE: usize = 3 + ERRORS_PER_MATE;

        fn update(&mut self, jacobian: &DVector<f64>, variance: f64) {
            let cross = &self.covariance * jacobian;
            let innovation_variance = jacobian.dot(&cross) + variance;
            let mut gain = &cross / innovation_variance;
            // The errors are considered, not estimated.
            for k in 3..Self::SIZE {
                gain[k] = 0.0;
            }
            // Joseph form: valid for any gain.
            let keep = DMatrix::identity(Self::SIZE, Self::SIZE) - &gain * jacobian.transpose();
            self.covariance =
                &keep * &self.covariance * keep.transpose() + &gain * gain.transpose() * variance;
        }
    }

    #[test]
    fn sightings_and_images_give_the_covariance_of_a_dense_filter() {
        let config = FilterConfig::default();
        let mut filter = PoseFilter::Joint(filter());
        let mut dense = Dense {
            covariance: DMatrix::identity(Dense::SIZE, Dense::SIZE),
        };
        for (k, variance) in [0.25, 0.25, 0.01].into_iter().enumerate() {
            dense.covariance[(k, k)] = variance;
        }
        let image = [0.09_f64, 1.0, 0.02];
        for step in 0..6 {
            let lever = [0.4_f32 * step as f32, 1.0 - 0.3 * step as f32];
            let measurement = MateMeasurement {
                by_heading: lever,
                ..sighting(2, [0.02, -0.01], 0.04, 0.08)
            };
            filter.mate_innovation(&measurement, 5.0).expect("a place");
            filter.update_by_mate(&measurement, &config);
            for axis in 0..2 {
                let mut jacobian = DVector::zeros(Dense::SIZE);
                (jacobian[axis], jacobian[2]) = (1.0, f64::from(lever[axis]));
                for k in 0..ERRORS_PER_MATE {
                    jacobian[3 + k] = f64::from(measurement.by_errors[axis][k]);
                }
                dense.update(&jacobian, f64::from(measurement.variance));
            }
            if step % 2 == 1 {
                let covariance = Matrix3::from_diagonal(&image.map(|value| value as f32).into());
                filter.update_pose(filter.pose(), &covariance, &config);
                for (axis, variance) in image.into_iter().enumerate() {
                    let mut jacobian = DVector::zeros(Dense::SIZE);
                    jacobian[axis] = 1.0;
                    dense.update(&jacobian, variance);
                }
            }
            let stated = filter.covariance();
            for i in 0..3 {
                for j in 0..3 {
                    let expected = dense.covariance[(i, j)];
                    let error = f64::from(stated[(i, j)]) - expected;
                    let scale = (dense.covariance[(i, i)] * dense.covariance[(j, j)]).sqrt();
                    assert!(
                        error.abs() < 0.01 * scale,
                        "{step}: {stated} {}",
                        dense.covariance
                    );
                }
            }
        }
    }

    #[test]
    fn half_turned_pose_knows_no_mates_and_a_drive_keeps_the_covariance_positive() {
        let config = FilterConfig::default();
        let mut filter = filter();
        let input = PredictionInput {
            dt: 0.03,
            imu: None,
            command: None,
            shock: false,
        };
        for k in 0..300 {
            filter.predict(&input, &config);
            let robot = 2 + k % 3;
            let lever = [2.0 * (k as f32 * 0.1).sin(), 2.0 * (k as f32 * 0.1).cos()];
            let measurement = MateMeasurement {
                by_heading: lever,
                ..sighting(robot, [0.0; 2], 0.03, 0.05)
            };
            update(&mut filter, &measurement);
            let cholesky = filter.covariance().cholesky();
            assert!(cholesky.is_some(), "{k}: {}", filter.covariance());
        }
        assert!(filter.mate_errors.is_some() && filter.half_turned().mate_errors.is_none());
    }
}
