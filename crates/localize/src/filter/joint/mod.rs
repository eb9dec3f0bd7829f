//! Joint pose filter: an extended Kalman filter over pose, twist, tilt, and the errors of all sensors
//! (docs/methods.md 8).
//!
//! | module | content | section |
//! | --- | --- | --- |
//! | `state` | indices of the state vector | 8.1 |
//! | `predict` | motion model f and its Jacobian F | 8.2, 8.3 |
//! | `process_noise` | Q | 8.4 |
//! | `wheel_update` | h, H, R of a wheel increment | 8.5 |
//! | `odometry_correction` | matrix from measured to true motion | 8.5 |
//! | `turning_steps`, `turning_point` | origin of the poses about the point that the wheels turn about | 2.13 |
//! | `wheel_noise` | learned wheel noise | 8.8 |
//! | `zero_velocity_update` | h, H, R at rest | 8.6 |
//! | `pose_update` | H and gain of a matched image | 8.7 |
//! | `mate_errors` | h, H, R of sightings between team-mates | 12.5 |
//! | `image_motion`, `pose_clone` | motion since the last image | 8.14 |
//! | `covariance` | sparse kernels of these equations | |
//!
//! Tilt, accelerometer bias and mount are separate states, since an accelerometer measures gravity through each of them.
//! The increment since the last wheel sample is a clone of the motion, so an image may fall between two wheel samples.

mod covariance;
mod image_motion;
mod mate_errors;
mod mate_update;
mod odometry_correction;
mod pose_clone;
mod pose_update;
mod predict;
mod process_noise;
mod state;
#[cfg(test)]
mod tests;
mod turning_point;
mod turning_steps;
mod wheel_noise;
mod wheel_update;
mod zero_velocity_update;

use nalgebra::Matrix3;

use super::{FilterConfig, TiltEstimate};
use crate::frames::{Pose, wrap_angle};
use crate::omni::Twist;
use crate::sensors::collision::CollisionDetector;

use mate_errors::MateErrors;
pub use mate_errors::{ERRORS_PER_MATE, MateInnovation, MateMeasurement};
pub use odometry_correction::OdometryPrior;
use pose_clone::PoseClone;
use state::{
    ACCELEROMETER_BIAS, Covariance, GYRO_BIAS, GYRO_SCALE, IMU_MOUNT, LATENCY, POSE, ROW_STRIDE,
    STATES, State, TILT, TWIST, YAW_RATE,
};
use turning_steps::TurningSteps;
use wheel_noise::WheelNoiseEstimate;

/// Standard deviation of a new filter's twist: m/s, m/s, rad/s.
const INITIAL_TWIST_STD: [f32; 3] = [3.0, 3.0, 6.0];

/// State estimate of the joint filter.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFilter {
    state: State,
    covariance: Covariance,
    /// Time covered by the increment states, seconds.
    wheel_interval: f32,
    /// Did the last prediction have an inertial unit?
    imu_active: bool,
    /// Robot frame, m/s².
    smoothed_acceleration: [f32; 2],
    odometry_prior: OdometryPrior,
    wheel_noise: WheelNoiseEstimate,
    collision: CollisionDetector,
    turning_steps: TurningSteps,
    /// Of the wheels, (x, y, θ), m/s and rad/s.
    smoothed_velocity: [f32; 3],
    /// Errors of team-mates that corrected the pose lately.
    mate_errors: Option<Box<MateErrors>>,
    /// The pose at the last image. None for a new filter.
    image_clone: Option<PoseClone>,
}

impl JointFilter {
    /// A filter at a new pose. Odometry correction, biases, mount, slip and latency are taken over from `previous`.
    pub(super) fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        previous: Option<&JointFilter>,
        config: &FilterConfig,
        odometry_prior: &OdometryPrior,
    ) -> Self {
        let mut state = [0.0; STATES];
        let mut variances = [0.0; STATES];
        (state[POSE], state[POSE + 1], state[POSE + 2]) = (pose.x, pose.y, pose.theta);
        state[GYRO_SCALE] = 1.0;
        state[LATENCY] = config.camera_latency;
        for (k, std) in INITIAL_TWIST_STD.into_iter().enumerate() {
            variances[TWIST + k] = std * std;
        }
        variances[GYRO_SCALE] = config.gyro_scale_std * config.gyro_scale_std;
        for k in 0..3 {
            variances[GYRO_BIAS + k] = config.gyro_bias_std_deg.to_radians().powi(2);
        }
        for k in 0..2 {
            variances[IMU_MOUNT + k] = config.imu_mount_std_deg.to_radians().powi(2);
            variances[ACCELEROMETER_BIAS + k] =
                config.accelerometer_bias_std * config.accelerometer_bias_std;
        }
        variances[LATENCY] = config.camera_latency_std * config.camera_latency_std;
        let mut full = [[0.0; ROW_STRIDE]; STATES];
        for (k, variance) in variances.into_iter().enumerate() {
            full[k][k] = variance;
        }
        odometry_correction::initialize(&mut state, &mut full, odometry_prior);
        let mut wheel_noise = WheelNoiseEstimate::new(config);
        let mut turning_steps = TurningSteps::default();
        if let Some(previous) = previous {
            wheel_noise = previous.wheel_noise.without_derivatives();
            turning_steps = previous.turning_steps.clone();
            turning_steps.interrupt();
            for i in GYRO_BIAS..STATES {
                state[i] = previous.state[i];
                full[i][GYRO_BIAS..].copy_from_slice(&previous.covariance[i][GYRO_BIAS..]);
            }
        }
        for k in 0..2 {
            // An upright robot: the unit's tilt is that of its mount.
            state[TILT + k] = state[IMU_MOUNT + k];
            let mount = full[IMU_MOUNT + k];
            for (j, value) in mount.into_iter().enumerate().take(STATES) {
                full[TILT + k][j] = value;
                full[j][TILT + k] = value;
            }
            full[TILT + k][TILT + k] =
                mount[IMU_MOUNT + k] + config.tilt_std_deg.to_radians().powi(2);
        }
        for i in 0..3 {
            for j in 0..3 {
                full[POSE + i][POSE + j] = covariance[(i, j)];
            }
        }
        JointFilter {
            state,
            covariance: full,
            wheel_interval: 0.0,
            imu_active: false,
            smoothed_acceleration: [0.0; 2],
            odometry_prior: odometry_prior.clone(),
            wheel_noise,
            collision: CollisionDetector::default(),
            turning_steps,
            smoothed_velocity: [0.0; 3],
            mate_errors: None,
            image_clone: None,
        }
    }

    pub(super) fn pose(&self) -> Pose {
        Pose::new(self.state[0], self.state[1], self.state[2])
    }

    pub(super) fn covariance(&self) -> Matrix3<f32> {
        Matrix3::from_fn(|i, j| self.covariance[POSE + i][POSE + j])
    }

    pub(super) fn twist(&self) -> Twist {
        Twist {
            x: self.state[TWIST],
            y: self.state[TWIST + 1],
            theta: self.state[YAW_RATE],
        }
    }

    /// Estimated scales of the odometry: mean of both translations, and rotation.
    pub(super) fn scales(&self) -> [f32; 2] {
        let scale = |k: usize| self.state[odometry_correction::entry(k, k)];
        [0.5 * (scale(0) + scale(1)), scale(2)]
    }

    /// Estimated matrix from the measured motion of the wheels to the true one.
    pub(super) fn odometry_correction(&self) -> [[f32; 3]; 3] {
        [0, 1, 2].map(|i| [0, 1, 2].map(|j| self.state[odometry_correction::entry(i, j)]))
    }

    pub(super) fn gyro_bias(&self) -> f32 {
        self.state[GYRO_BIAS + 2]
    }

    /// Tilt of the camera. None without an inertial unit.
    pub(super) fn tilt(&self) -> Option<TiltEstimate> {
        let mean = [0, 1].map(|k| self.state[TILT + k] - self.state[IMU_MOUNT + k]);
        let p = &self.covariance;
        let variances = [0, 1].map(|k| {
            let (tilt, mount) = (TILT + k, IMU_MOUNT + k);
            p[tilt][tilt] - 2.0 * p[tilt][mount] + p[mount][mount]
        });
        let variance = variances[0].max(variances[1]).max(0.0);
        self.imu_active.then(|| TiltEstimate {
            mean,
            std: variance.sqrt(),
        })
    }

    pub(super) fn latency(&self) -> f32 {
        self.state[LATENCY]
    }

    pub(super) fn in_collision(&self) -> bool {
        self.collision.is_active()
    }

    /// Multiplies the pose's covariance by `factor` and decorrelates it from the other states.
    pub(super) fn inflate_covariance(&mut self, factor: f32) {
        for i in 0..STATES {
            for j in 0..STATES {
                self.covariance[i][j] *= match (i < 3, j < 3) {
                    (true, true) => factor,
                    (false, false) => 1.0,
                    _ => 0.0,
                };
            }
        }
        if let Some(errors) = &mut self.mate_errors {
            errors.decorrelate_pose();
        }
        if let Some(clone) = &mut self.image_clone {
            clone.decorrelate_other_states();
        }
        self.doubt_twist();
    }

    /// Adds errors of an unreported motion to the pose, metres and radians.
    pub(super) fn admit_motion(&mut self, distance: f32, turn: f32) {
        for (axis, std) in [distance, distance, turn].into_iter().enumerate() {
            self.inflate_variance(POSE + axis, std * std);
        }
        self.doubt_twist();
    }

    /// An unreported motion may continue.
    fn doubt_twist(&mut self) {
        for (k, std) in INITIAL_TWIST_STD.into_iter().enumerate() {
            self.covariance[TWIST + k][TWIST + k] += (0.3 * std).powi(2);
        }
    }

    /// Moves pose (x, y, θ) and camera tilt (a, b) by what a step of the map means. The mount of the inertial unit takes the
    /// tilt's part.
    pub(super) fn shift_pose(&mut self, step: [f32; 5]) {
        self.shift_origin([step[0], step[1]]);
        for (value, step) in self.state[POSE..POSE + 3].iter_mut().zip(step) {
            *value += step;
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
        if let Some(clone) = &mut self.image_clone {
            clone.shift([step[0], step[1], step[2]]);
        }
        if self.imu_active {
            for k in 0..2 {
                self.state[IMU_MOUNT + k] -= step[3 + k];
            }
        }
    }

    /// The same estimate in the other field half.
    pub(super) fn half_turned(&self) -> Self {
        let mut turned = self.clone();
        // The mates located the pose in the other half.
        turned.mate_errors = None;
        turned.image_clone = None;
        turned.interrupt_steps();
        turned.state[0] = -self.state[0];
        turned.state[1] = -self.state[1];
        turned.state[2] = wrap_angle(self.state[2] + std::f32::consts::PI);
        for i in 0..2 {
            for j in 2..STATES {
                turned.covariance[i][j] = -self.covariance[i][j];
                turned.covariance[j][i] = -self.covariance[j][i];
            }
        }
        turned
    }
}
