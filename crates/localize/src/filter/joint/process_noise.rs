//! Process noise Q of the joint filter (docs/methods.md 8.4).

use super::JointFilter;
use super::predict::{ImuStep, PlanarStep};
use super::state::{
    ACCELEROMETER_BIAS, GYRO_BIAS, POSE, SLIP, TILT, TWIST, WHEEL_INCREMENT, YAW_RATE,
};
use crate::filter::{FilterConfig, ImuInterval, PredictionInput};
use crate::math;

/// Random walk of the slip velocity while the wheels slide: m/s (each axis) and rad/s per square root of a second.
/// Motors pull 2 m/s² harder than the carpet holds, on wheels 0.2 m from the centre.
const SLIP_NOISE: [f32; 3] = [2.0, 2.0, 10.0];
/// Standard deviation of the acceleration in a shock, as a share of the measured force (scale and axes of the
/// accelerometer). Larger values make wheel slip unobservable.
const SHOCK_ERROR_SHARE: f32 = 0.03;
/// Time in which the tilt becomes independent without an inertial unit, seconds.
const TILT_RELAXATION_TIME: f32 = 0.1;

/// Effect of a unit of white noise over a step on a position and its velocity.
struct NoiseMode {
    position: f32,
    velocity: f32,
}

/// White noise of density q over `dt` adds q dt³/3 to the position's variance, q dt to the velocity's, and q dt²/2 to
/// their covariance.
///
/// Two modes for a variance of q/dt: the acceleration's mean, and the rest, which moves the position alone.
/// The mean alone would explain three quarters of the position's variance, and the twist would oscillate.
fn discretize_white_noise(dt: f32) -> [NoiseMode; 2] {
    [
        NoiseMode {
            position: 0.5 * dt * dt,
            velocity: dt,
        },
        NoiseMode {
            position: dt * dt / 12.0_f32.sqrt(),
            velocity: 0.0,
        },
    ]
}

impl JointFilter {
    /// Noise of a step by the inertial unit.
    pub(super) fn add_imu_noise(
        &mut self,
        imu: &ImuInterval,
        input: &PredictionInput,
        step: &ImuStep,
        config: &FilterConfig,
    ) {
        let dt = step.dt;
        let [x, y] = imu.specific_force;
        // The rotation may occur at any time within a shock: a uniform distribution of the heading.
        let (shock_variance, heading_variance) = if input.shock {
            let range = 2.0 * (imu.final_yaw_rate - imu.mean_angular_velocity[2]) * dt;
            (
                (SHOCK_ERROR_SHARE * math::hypot(x, y)).powi(2),
                range * range / 12.0,
            )
        } else {
            (0.0, 0.0)
        };
        let density =
            config.accelerometer_noise.powi(2) + imu.vibration_std.powi(2) * imu.sample_period;
        self.add_acceleration_noise(
            dt,
            density / dt + shock_variance,
            &step.field_step,
            &step.increment_step,
        );
        let density = config.gyro_noise_deg.to_radians().powi(2);
        self.add_rank_one_noise(
            &[(POSE + 2, 1.0), (WHEEL_INCREMENT + 2, 1.0)],
            density * dt + heading_variance,
        );
        self.inflate_variance(YAW_RATE, density / imu.sample_period.max(1e-4));
        for k in 0..2 {
            self.inflate_variance(TILT + k, density * dt);
        }
        for (k, noise) in SLIP_NOISE.into_iter().enumerate() {
            self.inflate_variance(SLIP + k, (noise * step.slip.sliding).powi(2) * dt);
        }
    }

    /// Noise of a step with constant velocity.
    pub(super) fn add_constant_velocity_noise(
        &mut self,
        dt: f32,
        field_step: &PlanarStep,
        increment_step: &PlanarStep,
        config: &FilterConfig,
    ) {
        let variance = config.velocity_process_noise * config.velocity_process_noise / dt;
        self.add_acceleration_noise(dt, variance, field_step, increment_step);
        let variance = config.yaw_rate_process_noise * config.yaw_rate_process_noise / dt;
        for mode in discretize_white_noise(dt) {
            self.add_rank_one_noise(
                &[
                    (POSE + 2, mode.position),
                    (WHEEL_INCREMENT + 2, mode.position),
                    (YAW_RATE, mode.velocity),
                ],
                variance,
            );
        }
    }

    /// White acceleration along each of the robot's axes, with this variance of the mean over `dt`.
    fn add_acceleration_noise(
        &mut self,
        dt: f32,
        variance: f32,
        field: &PlanarStep,
        increment: &PlanarStep,
    ) {
        for NoiseMode { position, velocity } in discretize_white_noise(dt) {
            let axes = [
                (
                    position * field.cos,
                    position * field.sin,
                    position * increment.cos,
                    position * increment.sin,
                ),
                (
                    -position * field.sin,
                    position * field.cos,
                    -position * increment.sin,
                    position * increment.cos,
                ),
            ];
            for (k, (x, y, increment_x, increment_y)) in axes.into_iter().enumerate() {
                let vector = [
                    (POSE, x),
                    (POSE + 1, y),
                    (WHEEL_INCREMENT, increment_x),
                    (WHEEL_INCREMENT + 1, increment_y),
                    (TWIST + k, velocity),
                ];
                self.add_rank_one_noise(&vector, variance);
            }
        }
    }

    /// Random walks of scales and biases.
    pub(super) fn add_sensor_noise(&mut self, dt: f32, config: &FilterConfig) {
        let variance = |drift: f32| drift * drift * dt;
        self.add_correction_noise(dt, config);
        self.wheel_noise.forget(dt);
        for k in 0..3 {
            self.inflate_variance(
                GYRO_BIAS + k,
                variance(config.gyro_bias_drift_deg.to_radians()),
            );
        }
        for k in 0..2 {
            self.inflate_variance(
                ACCELEROMETER_BIAS + k,
                variance(config.accelerometer_bias_drift),
            );
        }
    }

    /// Random walk of the odometry's correction (carpet direction, wear, load).
    fn add_correction_noise(&mut self, dt: f32, config: &FilterConfig) {
        if !(config.odometry_scale_std > 0.0) {
            return;
        }
        let share = config.odometry_scale_drift / config.odometry_scale_std;
        self.odometry_prior
            .add_to(&mut self.covariance, share * share * dt);
    }

    /// Without an inertial unit the tilt's variance relaxes to that of a standing robot.
    pub(super) fn relax_tilt_prior(&mut self, dt: f32, config: &FilterConfig) {
        let stationary = config.tilt_std_deg.to_radians().powi(2);
        let limit = stationary + config.imu_mount_std_deg.to_radians().powi(2);
        for k in TILT..TILT + 2 {
            if self.covariance[k][k] < limit {
                self.inflate_variance(k, stationary * dt / TILT_RELAXATION_TIME);
            }
        }
    }
}
