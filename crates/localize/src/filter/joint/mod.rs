//! What do pose, twist, lean, slip, biases, scales and latency tell of each other? One Kalman filter over all of them.
//!
//! Where an inertial unit tells, robot and lean follow it, and what it errs by is found from sights and wheels: the
//! accelerometer feels gravity through every lean, so that lean, its bias and the unit's mount are states. Wheels measure
//! the way since their last sample exactly as far as it was driven under this belief, so that frames may fall anywhere
//! between. They wear and slide, and a bias of some per cent is the rule: scales and slip are states (nubot2013 4 and
//! minho2016 IV.C fuse without).

mod pose_update;
mod predict;
#[cfg(test)]
mod tests;
mod wheel_update;

use nalgebra::Matrix3;

use super::pose_gaussian;
use super::{FilterConfig, TiltEstimate};
use crate::frames::{Pose, wrap_angle};
use crate::omni::Twist;
use crate::sensors::collision::CollisionDetector;

/// Pose on the field.
const POSE: usize = 0;
/// Way since the wheels' last sample, in the robot's frame at that time.
const WHEEL_INCREMENT: usize = 3;
/// Velocity, robot frame.
const TWIST: usize = 6;
const YAW_RATE: usize = 8;
/// Up in the inertial unit's frame, its x and y.
const TILT: usize = 9;
/// About x, y and z.
const GYRO_BIAS: usize = 11;
/// Of way and turn.
const ODOMETRY_SCALES: usize = 14;
/// Of both horizontal axes.
const ACCELEROMETER_BIAS: usize = 16;
/// What of the unit's lean is not the camera's.
const IMU_MOUNT: usize = 18;
/// Velocity of the rims over the ground, m/s, rad/s.
const SLIP: usize = 20;
/// True rate over the gyro's, about z.
const GYRO_SCALE: usize = 23;
const LATENCY: usize = 24;
const STATES: usize = 25;
/// Rows are padded to whole vector registers.
const ROW_STRIDE: usize = 28;

type State = [f32; STATES];
type Covariance = [[f32; ROW_STRIDE]; STATES];
/// A row of a matrix: the entries that are not zero.
type SparseRow<'a> = &'a [(usize, f32)];

/// Scales outside these are broken encoders, not wear.
const SCALE_RANGE: (f32, f32) = (0.7, 1.4);
/// Noise is learnt within these factors (variance) of what the configuration says.
const NOISE_FACTOR_RANGE: (f32, f32) = (0.05, 20.0);
/// Most intervals for which the wheels' last word is taken, when some were lost.
const LOST_INTERVALS_MAX: f32 = 20.0;
/// How fast a robot may drive and turn when it is first seen: m/s, rad/s (one sigma).
const INITIAL_TWIST_STD: [f32; 3] = [3.0, 3.0, 6.0];
/// How much a standing robot trembles, metres and radians per square root of a second.
const STATIONARY_NOISE: [f32; 2] = [0.002, 0.0005];
/// Part of a shock that the accelerometer misses: its scale and axes are no better. Were it more, nobody could say
/// afterwards that the wheels err.
const SHOCK_ERROR_SHARE: f32 = 0.03;
/// No variance falls below this: what single precision resolves beside a metre, squared.
const VARIANCE_MIN: f32 = 1e-13;

/// Mean and covariance of everything.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFilter {
    state: State,
    covariance: Covariance,
    /// How long the way has been driven, seconds.
    wheel_interval: f32,
    /// Does an inertial unit tell how it leans?
    imu_active: bool,
    /// Acceleration, smoothed, robot frame, m/s².
    smoothed_acceleration: [f32; 2],
    /// Variance of the wheels' noise over what the configuration says, learnt.
    wheel_noise_factor: f32,
    collision: CollisionDetector,
}

impl JointFilter {
    pub(super) fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        known: Option<&JointFilter>,
        config: &FilterConfig,
    ) -> Self {
        let mut state = [0.0; STATES];
        let mut variances = [0.0; STATES];
        (state[POSE], state[POSE + 1], state[POSE + 2]) = (pose.x, pose.y, pose.theta);
        (
            state[ODOMETRY_SCALES],
            state[ODOMETRY_SCALES + 1],
            state[GYRO_SCALE],
        ) = (1.0, 1.0, 1.0);
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
            variances[ODOMETRY_SCALES + k] = config.odometry_scale_std * config.odometry_scale_std;
            variances[ACCELEROMETER_BIAS + k] =
                config.accelerometer_bias_std * config.accelerometer_bias_std;
        }
        variances[LATENCY] = config.camera_latency_std * config.camera_latency_std;
        let mut full = [[0.0; ROW_STRIDE]; STATES];
        for (k, variance) in variances.into_iter().enumerate() {
            full[k][k] = variance;
        }
        let mut noise = 1.0;
        if let Some(known) = known {
            noise = known.wheel_noise_factor;
            // Wheels and units stay the same wherever the robot is put.
            for i in GYRO_BIAS..STATES {
                state[i] = known.state[i];
                full[i][GYRO_BIAS..].copy_from_slice(&known.covariance[i][GYRO_BIAS..]);
            }
        }
        for k in 0..2 {
            // Upright as robots stand, as far as it is known how the unit is mounted.
            state[TILT + k] = state[IMU_MOUNT + k];
            let mounted = full[IMU_MOUNT + k];
            for (j, value) in mounted.into_iter().enumerate().take(STATES) {
                full[TILT + k][j] = value;
                full[j][TILT + k] = value;
            }
            full[TILT + k][TILT + k] =
                mounted[IMU_MOUNT + k] + config.tilt_std_deg.to_radians().powi(2);
        }
        let seen = covariance + pose_gaussian::systematic_covariance(config);
        for i in 0..3 {
            for j in 0..3 {
                full[POSE + i][POSE + j] = seen[(i, j)];
            }
        }
        JointFilter {
            state,
            covariance: full,
            wheel_interval: 0.0,
            imu_active: false,
            smoothed_acceleration: [0.0; 2],
            wheel_noise_factor: noise,
            collision: CollisionDetector::default(),
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

    pub(super) fn scales(&self) -> [f32; 2] {
        [self.state[ODOMETRY_SCALES], self.state[ODOMETRY_SCALES + 1]]
    }

    pub(super) fn gyro_bias(&self) -> f32 {
        self.state[GYRO_BIAS + 2]
    }

    /// Lean of the camera (MATH.md 2, "Tilt") with its standard deviation, radians; none where no inertial unit tells.
    pub(super) fn tilt(&self) -> Option<TiltEstimate> {
        let mean = [0, 1].map(|k| self.state[TILT + k] - self.state[IMU_MOUNT + k]);
        let p = &self.covariance;
        let variances = [0, 1].map(|k| {
            let (lean, mount) = (TILT + k, IMU_MOUNT + k);
            p[lean][lean] - 2.0 * p[lean][mount] + p[mount][mount]
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

    /// A measurement: Σ terms·state deviates from what was measured by `residual`, whose own variance is given.
    fn update_scalar(&mut self, terms: SparseRow, residual: f32, variance: f32) {
        let mut gain = [0.0; ROW_STRIDE];
        for &(column, factor) in terms {
            for (value, other) in gain.iter_mut().zip(&self.covariance[column]) {
                *value += factor * other;
            }
        }
        let total: f32 = terms
            .iter()
            .map(|&(column, factor)| factor * gain[column])
            .sum::<f32>()
            + variance;
        if !(total > 0.0) {
            return;
        }
        let part = residual / total;
        for (value, gain) in self.state.iter_mut().zip(&gain) {
            *value += gain * part;
        }
        for (i, line) in self.covariance.iter_mut().enumerate() {
            let factor = gain[i] / total;
            for (value, gain) in line.iter_mut().zip(&gain) {
                *value -= factor * gain;
            }
            line[i] = line[i].max(VARIANCE_MIN);
        }
        self.state[POSE + 2] = wrap_angle(self.state[POSE + 2]);
    }

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
        // What moved it may move it still.
        for (k, std) in INITIAL_TWIST_STD.into_iter().enumerate() {
            self.covariance[TWIST + k][TWIST + k] += (0.3 * std).powi(2);
        }
    }

    pub(super) fn half_turned(&self) -> Self {
        let mut other = self.clone();
        other.state[0] = -self.state[0];
        other.state[1] = -self.state[1];
        other.state[2] = wrap_angle(self.state[2] + std::f32::consts::PI);
        for i in 0..2 {
            for j in 2..STATES {
                other.covariance[i][j] = -self.covariance[i][j];
                other.covariance[j][i] = -self.covariance[j][i];
            }
        }
        other
    }
}
