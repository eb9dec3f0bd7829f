//! What does a sight say of everything that is believed? The pose at the exposure, and through it all that moved it.

use nalgebra::{SMatrix, SVector, Vector3};

use super::{
    IMU_MOUNT, JointFilter, LATENCY, NOISE_FACTOR_RANGE, POSE, STATES, TILT, TWIST, VARIANCE_MIN,
    YAW_RATE,
};
use crate::filter::pose_gaussian::PosePosterior;
use crate::filter::{FilterConfig, TiltPrior, pose_gaussian};
use crate::frames::wrap_angle;
use crate::matching::{Matrix5, PARAMETERS};

/// Columns of P Hᵀ, H = what a frame shows: pose and lean (x, y, θ, a, b) at the exposure.
type CrossCovariance = SMatrix<f32, STATES, PARAMETERS>;

impl JointFilter {
    /// Covariance of everything with pose and lean at the exposure: H = (1, −velocity) of (pose, latency), and the lean
    /// of the camera, or none where every frame's lean is another one.
    fn cross_covariance(&self, lean: TiltPrior) -> CrossCovariance {
        let p = &self.covariance;
        let velocity = self.field_velocity();
        let own = matches!(lean, TiltPrior::FromState) && self.imu_active;
        CrossCovariance::from_fn(|i, j| match j {
            0..3 => p[i][POSE + j] - velocity[j] * p[i][LATENCY],
            _ if own => p[i][TILT + j - 3] - p[i][IMU_MOUNT + j - 3],
            _ => 0.0,
        })
    }

    fn field_velocity(&self) -> Vector3<f32> {
        let (sin, cos) = self.state[POSE + 2].sin_cos();
        let (vx, vy) = (self.state[TWIST], self.state[TWIST + 1]);
        Vector3::new(
            cos * vx - sin * vy,
            sin * vx + cos * vy,
            self.state[YAW_RATE],
        )
    }

    /// Covariance of what a frame shows, (x, y, θ, a, b).
    pub(in crate::filter) fn predicted_covariance(&self, lean: TiltPrior) -> Matrix5 {
        self.project_covariance(&self.cross_covariance(lean), lean)
    }

    fn project_covariance(&self, with: &CrossCovariance, lean: TiltPrior) -> Matrix5 {
        let velocity = self.field_velocity();
        let fresh = match lean {
            TiltPrior::FromState if self.imu_active => None,
            TiltPrior::FromState => Some(1.0),
            TiltPrior::Independent(std) => Some(std),
        };
        let full = Matrix5::from_fn(|i, j| match (i, fresh) {
            (0..3, _) => with[(POSE + i, j)] - velocity[i] * with[(LATENCY, j)],
            (_, None) => with[(TILT + i - 3, j)] - with[(IMU_MOUNT + i - 3, j)],
            (_, Some(std)) => f32::from(u8::from(i == j)) * std * std,
        });
        (full + full.transpose()) * 0.5
    }

    pub(in crate::filter) fn update(
        &mut self,
        matched: &PosePosterior,
        lean: TiltPrior,
        config: &FilterConfig,
    ) {
        let with = self.cross_covariance(lean);
        let expected = self.project_covariance(&with, lean);
        let Some(inverse) = expected.try_inverse() else {
            return;
        };
        let gain = with * inverse;
        let moved = pose_gaussian::innovation(self.pose(), matched.pose);
        let [a, b] = matched.lean;
        let innovation = SVector::<f32, PARAMETERS>::from([moved[0], moved[1], moved[2], a, b]);
        self.adapt_wheel_noise(&expected, &moved, matched, config);
        let step = gain * innovation;
        for (value, step) in self.state.iter_mut().zip(step.iter()) {
            *value += step;
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        self.clamp_scales();
        let learnt = gain * (expected - matched.covariance);
        let down = learnt * gain.transpose();
        let repeated = pose_gaussian::systematic_covariance(config);
        for i in 0..STATES {
            for j in 0..=i {
                let extra = if i < 3 { repeated[(i, j)] } else { 0.0 };
                let mean = 0.5 * (self.covariance[i][j] + self.covariance[j][i]);
                let value = mean - 0.5 * (down[(i, j)] + down[(j, i)]) + extra;
                let value = if i == j {
                    value.max(VARIANCE_MIN)
                } else {
                    value
                };
                self.covariance[i][j] = value;
                self.covariance[j][i] = value;
            }
        }
        if config.camera_latency_std == 0.0 {
            // The same, without what rounding left.
            for i in 0..3 {
                for j in 0..3 {
                    self.covariance[i][j] = matched.covariance[(i, j)] + repeated[(i, j)];
                }
            }
        }
    }
    /// An honest expectation is left by 3 − tr(P⁻¹P⁺) on average; more means noisier odometry than assumed.
    fn adapt_wheel_noise(
        &mut self,
        expected: &Matrix5,
        moved: &Vector3<f32>,
        matched: &PosePosterior,
        config: &FilterConfig,
    ) {
        let pose_part = expected.fixed_view::<3, 3>(0, 0).into_owned();
        let Some(inverse) = pose_part.try_inverse() else {
            return;
        };
        let strain = moved.dot(&(inverse * moved));
        let usual = 3.0 - (inverse * matched.covariance.fixed_view::<3, 3>(0, 0)).trace();
        self.wheel_noise_factor = (self.wheel_noise_factor
            * (config.noise_adaptation_rate * (strain - usual).clamp(-3.0, 9.0)).exp())
        .clamp(NOISE_FACTOR_RANGE.0, NOISE_FACTOR_RANGE.1);
    }
}
