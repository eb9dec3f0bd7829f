//! Pose update of the joint filter by a matched image (docs/methods.md 8.7).
//!
//! An image measures pose and tilt (x, y, θ, a, b) at its exposure. The matcher already contains the prediction, so the
//! update takes a posterior: x ← x + K (ŷ − y), P ← P − K (S − P_y) Kᵀ with K = P Hᵀ S⁻¹. The difference ŷ − y is that of rigid motions,
//! as in the matcher, and the covariance is that of pose errors at the new pose again in the end.

use nalgebra::{SMatrix, Vector3};

use super::JointFilter;
use super::covariance::VARIANCE_MIN;
use super::state::{IMU_MOUNT, LATENCY, POSE, STATES, TILT, TWIST, YAW_RATE};
use crate::filter::pose_gaussian::PosePosterior;
use crate::filter::{FilterConfig, TiltPrior};
use crate::frames::wrap_angle;
use crate::matching::{Matrix5, PARAMETERS, RigidDifference, Vector5, information_of};
use crate::math;

/// P Hᵀ.
type CrossCovariance = SMatrix<f32, STATES, PARAMETERS>;

impl JointFilter {
    /// P Hᵀ with H: pose → 1, latency → −field velocity, tilt → up direction minus mount.
    ///
    /// The tilt's columns are zero if it is independent in each image.
    fn cross_covariance(&self, tilt_prior: TiltPrior) -> CrossCovariance {
        let p = &self.covariance;
        let velocity = self.field_velocity();
        let tilt_in_state = matches!(tilt_prior, TiltPrior::FromState { .. }) && self.imu_active;
        CrossCovariance::from_fn(|i, j| match j {
            0..3 => p[i][POSE + j] - velocity[j] * p[i][LATENCY],
            _ if tilt_in_state => p[i][TILT + j - 3] - p[i][IMU_MOUNT + j - 3],
            _ => 0.0,
        })
    }

    /// Nonzero entries of the rows of H.
    fn pose_rows(&self, tilt_prior: TiltPrior) -> [Vec<(usize, f32)>; PARAMETERS] {
        let velocity = self.field_velocity();
        let tilt_in_state = matches!(tilt_prior, TiltPrior::FromState { .. }) && self.imu_active;
        std::array::from_fn(|j| match j {
            0..3 => vec![(POSE + j, 1.0), (LATENCY, -velocity[j])],
            _ if tilt_in_state => vec![(TILT + j - 3, 1.0), (IMU_MOUNT + j - 3, -1.0)],
            _ => Vec::new(),
        })
    }

    /// Velocity in the field frame.
    fn field_velocity(&self) -> Vector3<f32> {
        let (sin, cos) = math::sin_cos(self.state[POSE + 2]);
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        Vector3::new(
            cos * vx - sin * vy,
            sin * vx + cos * vy,
            self.state[YAW_RATE],
        )
    }

    /// S = H P Hᵀ: covariance of the predicted (x, y, θ, a, b).
    pub(in crate::filter) fn predicted_covariance(&self, tilt_prior: TiltPrior) -> Matrix5 {
        self.project_covariance(&self.cross_covariance(tilt_prior), tilt_prior)
    }

    /// H · `cross`, plus the variance of a tilt that is not in the state.
    fn project_covariance(&self, cross: &CrossCovariance, tilt_prior: TiltPrior) -> Matrix5 {
        let velocity = self.field_velocity();
        let (tilt_in_state, independent_std) = match tilt_prior {
            TiltPrior::FromState { unmeasured_std } if self.imu_active => (true, unmeasured_std),
            TiltPrior::FromState { .. } => (false, 1.0),
            TiltPrior::Independent(std) => (false, std),
        };
        let full = Matrix5::from_fn(|i, j| {
            if i < 3 {
                return cross[(POSE + i, j)] - velocity[i] * cross[(LATENCY, j)];
            }
            let independent = f32::from(u8::from(i == j)) * independent_std * independent_std;
            if tilt_in_state {
                cross[(TILT + i - 3, j)] - cross[(IMU_MOUNT + i - 3, j)] + independent
            } else {
                independent
            }
        });
        (full + full.transpose()) * 0.5
    }

    pub(in crate::filter) fn update(
        &mut self,
        posterior: &PosePosterior,
        tilt_prior: TiltPrior,
        config: &FilterConfig,
    ) {
        let cross = self.cross_covariance(tilt_prior);
        let predicted = self.project_covariance(&cross, tilt_prior);
        let Some(information) = information_of(&predicted) else {
            return;
        };
        let gain = cross * information;
        let predicted_pose = self.pose();
        let difference = RigidDifference::between(predicted_pose, posterior.pose);
        let innovation = difference.with_tilt(posterior.tilt);
        let remaining = difference.covariance(&posterior.covariance);
        self.update_wheel_noise(&information, &innovation, &remaining);
        let rows = self.pose_rows(tilt_prior);
        if let Some(errors) = &mut self.mate_errors {
            errors.update_by_image(&rows, &cross, &information, &remaining);
        }
        let reduction = predicted - remaining;
        if let Some(clone) = &mut self.image_clone {
            clone.update_by_image(&rows, &information, &innovation, &reduction, &gain);
        }
        let step = gain * innovation;
        for (value, step) in self.state.iter_mut().zip(step.iter()) {
            *value += step;
        }
        let bend = posterior.pose.difference(predicted_pose) - difference.deviation;
        for (value, bend) in self.state[POSE..].iter_mut().zip(bend.iter()) {
            *value += bend;
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        self.clamp_scales();
        if config.camera_latency_std == 0.0 {
            // The smallest variance must not move a known latency: an image a nanosecond older than the wheel sample of
            // its stamp would be matched without that sample.
            self.state[LATENCY] = config.camera_latency;
        }
        let reduction = gain * reduction * gain.transpose();
        self.reduce_covariance(&reduction);
        self.bend_pose_errors(&difference);
        if config.camera_latency_std == 0.0 {
            // Without a latency state the pose's posterior is known without rounding.
            for i in 0..3 {
                for j in 0..3 {
                    self.covariance[i][j] = posterior.covariance[(i, j)];
                }
            }
        }
        self.add_pose_step();
    }

    /// Learns the wheels' noise from an image (docs/methods.md 8.8).
    pub(in crate::filter) fn learn_wheel_noise(
        &mut self,
        posterior: &PosePosterior,
        tilt_prior: TiltPrior,
    ) {
        if let Some(information) = information_of(&self.predicted_covariance(tilt_prior)) {
            let difference = RigidDifference::between(self.pose(), posterior.pose);
            let innovation = difference.with_tilt(posterior.tilt);
            let remaining = difference.covariance(&posterior.covariance);
            self.update_wheel_noise(&information, &innovation, &remaining);
        }
    }

    /// `information`: S⁻¹; `remaining`: P_y. The innovation's own Σ⁻¹ = (S + R)⁻¹ follows from the posterior: S⁻¹ − S⁻¹ P_y S⁻¹.
    fn update_wheel_noise(
        &mut self,
        information: &Matrix5,
        innovation: &Vector5,
        remaining: &Matrix5,
    ) {
        self.wheel_noise.update_by_image(
            &(information * innovation),
            &(information - information * remaining * information),
            information,
            &(remaining.fixed_rows::<3>(0) * information.fixed_columns::<3>(0)),
        );
    }

    /// P ← P − `reduction`, kept symmetric and positive on the diagonal.
    fn reduce_covariance(&mut self, reduction: &SMatrix<f32, STATES, STATES>) {
        for i in 0..STATES {
            for j in 0..=i {
                let mean = 0.5 * (self.covariance[i][j] + self.covariance[j][i]);
                let value = mean - 0.5 * (reduction[(i, j)] + reduction[(j, i)]);
                let value = if i == j {
                    value.max(VARIANCE_MIN)
                } else {
                    value
                };
                self.covariance[i][j] = value;
                self.covariance[j][i] = value;
            }
        }
    }

    /// Errors of the rigid difference from a predicted pose become those of the pose.
    fn bend_pose_errors(&mut self, difference: &RigidDifference) {
        let Some(inverse) = difference.jacobian.try_inverse() else {
            return;
        };
        let bent = |errors: [f32; 3]| <[f32; 3]>::from(inverse * Vector3::from(errors));
        for column in 0..STATES {
            let errors = bent([0, 1, 2].map(|k| self.covariance[POSE + k][column]));
            for (k, error) in errors.into_iter().enumerate() {
                self.covariance[POSE + k][column] = error;
            }
        }
        for line in &mut self.covariance {
            let errors = bent([0, 1, 2].map(|k| line[POSE + k]));
            line[POSE..POSE + 3].copy_from_slice(&errors);
        }
        for line in self
            .image_clone
            .iter_mut()
            .flat_map(|clone| &mut clone.cross)
        {
            let errors = bent([0, 1, 2].map(|k| line[POSE + k]));
            line[POSE..POSE + 3].copy_from_slice(&errors);
        }
    }
}
