//! Motion measurements: turns samples of inertial unit, wheels and commands into the inputs of the pose filters.

use crate::filter::{ImuInterval, PredictionInput, WheelIncrement};
use crate::math;
use crate::omni::Twist;
use crate::sample::{Compass, Imu, Odometry, VelocityCommand};
use crate::sensors::attitude::{Attitude, AttitudeConfig};
use crate::sensors::collision::CollisionConfig;
use crate::stamp::Stamp;

/// A sample that changes the pose filters.
#[derive(Debug, Clone, Copy)]
pub(super) enum MotionMeasurement {
    /// Wheel odometry.
    Wheels(Odometry),
    /// Wheel odometry whose interval is unknown or too long. A new interval begins at its stamp.
    WheelsRestarted(Odometry),
    Imu(Imu),
    Command(VelocityCommand),
    /// It moves nothing, but the attitude and the evidence for the field half depend on the order of the samples.
    Compass(Compass),
}

impl MotionMeasurement {
    pub(super) fn stamp(&self) -> Stamp {
        match self {
            MotionMeasurement::Wheels(odometry) | MotionMeasurement::WheelsRestarted(odometry) => {
                odometry.stamp
            }
            MotionMeasurement::Imu(imu) => imu.stamp,
            MotionMeasurement::Command(command) => command.stamp,
            MotionMeasurement::Compass(compass) => compass.stamp,
        }
    }
}

/// Time constant of the vibration estimate, seconds.
const VIBRATION_TIME_CONSTANT: f32 = 1.0;
/// One reading counts at most as this multiple of the vibration variance plus the step below. A shock is no vibration.
const VIBRATION_GROWTH_MAX: f32 = 9.0;
/// (m/s²)².
const VIBRATION_VARIANCE_STEP: f32 = 0.01;

/// Readings over which their mean period is remembered.
const PERIOD_READINGS: f32 = 128.0;

/// Age at which the wheels' acceleration is no longer used, seconds.
const WHEEL_ACCELERATION_AGE_MAX: f64 = 0.1;

/// The last reading of the inertial unit.
#[derive(Debug, Clone, Copy)]
struct LastImu {
    stamp: Stamp,
    /// Along x and y, m/s².
    specific_force: [f32; 2],
    /// rad/s.
    rate: [f32; 3],
    /// Derivative of the rate, rad/s².
    angular_acceleration: [f32; 3],
    /// Derivative of the specific force, m/s³.
    jerk: [f32; 2],
    /// Variance of the specific force from reading to reading, (m/s²)².
    vibration_variance: f32,
    /// Time since the previous reading, seconds.
    sample_period: f32,
    /// Mean of the periods, seconds. A computer that is busy stamps several readings almost at once: derivatives over
    /// their stamps would be many times too large.
    mean_period: f32,
    shock: bool,
    /// Integrals of specific force (x, y) and rate that the filters already received after this reading.
    integrated: [f32; 5],
}

impl LastImu {
    /// This reading's interval without the part that the filters received by extrapolation of the reading `before`.
    ///
    /// `remaining`: length of the result, seconds.
    fn remaining_interval(&self, before: &LastImu, remaining: f32) -> ImuInterval {
        // A gyro measures the rate at an instant. Between two readings it is interpolated linearly.
        let mean: [f32; 5] = std::array::from_fn(|k| match k {
            0 | 1 => self.specific_force[k],
            _ => 0.5 * (before.rate[k - 2] + self.rate[k - 2]),
        });
        let rest = |k: usize| (mean[k] * self.sample_period - before.integrated[k]) / remaining;
        ImuInterval {
            specific_force: [rest(0), rest(1)],
            mean_angular_velocity: [rest(2), rest(3), rest(4)],
            final_yaw_rate: self.rate[2],
            vibration_std: self.vibration_variance.sqrt(),
            sample_period: self.sample_period,
        }
    }

    /// Jerk up to a later reading, and the updated vibration variance.
    ///
    /// Second differences of independent errors have six times their variance. The robot's own acceleration is smooth
    /// in comparison.
    fn estimate_vibration(&self, imu: &Imu, seconds: f32) -> ([f32; 2], f32) {
        let jerk = [0, 1].map(|k| (imu.specific_force[k] - self.specific_force[k]) / seconds);
        let difference = [0, 1].map(|k| (jerk[k] - self.jerk[k]) * seconds);
        let variance = (difference[0] * difference[0] + difference[1] * difference[1]) / 12.0;
        let limit = VIBRATION_GROWTH_MAX * self.vibration_variance + VIBRATION_VARIANCE_STEP;
        let share = (seconds / VIBRATION_TIME_CONSTANT).min(1.0);
        (
            jerk,
            self.vibration_variance + share * (variance.min(limit) - self.vibration_variance),
        )
    }

    /// Extrapolation over `seconds`, beginning `since` seconds after this reading. Counted as received by the filters.
    ///
    /// The rate continues with its derivative, so a rotation that begins is not delayed by a few milliseconds.
    fn extrapolate(&mut self, since: f32, seconds: f32) -> ImuInterval {
        // Beyond the next reading that was due, the derivative says nothing.
        let derived = |time: f32| time.min(self.mean_period.max(self.sample_period));
        let middle = derived(since + 0.5 * seconds);
        let rate: [f32; 3] =
            std::array::from_fn(|k| self.rate[k] + middle * self.angular_acceleration[k]);
        let end = derived(since + seconds);
        let values = self.specific_force.iter().chain(&rate);
        for (integral, value) in self.integrated.iter_mut().zip(values) {
            *integral += value * seconds;
        }
        ImuInterval {
            specific_force: self.specific_force,
            mean_angular_velocity: rate,
            final_yaw_rate: self.rate[2] + end * self.angular_acceleration[2],
            vibration_std: self.vibration_variance.sqrt(),
            sample_period: self.sample_period,
        }
    }
}

/// The last interval of the wheels.
#[derive(Debug, Clone, Copy)]
struct LastWheels {
    stamp: Stamp,
    velocity: Twist,
    /// Acceleration over the ground, m/s², robot frame. From one interval, so it carries the encoders' quantisation.
    acceleration: [f32; 2],
}

/// Prediction over the interval up to a reading of the inertial unit.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImuPrediction {
    pub(super) input: PredictionInput,
    /// Length of the reading's interval if the robot stood still, seconds.
    pub(super) stationary: Option<f32>,
}

/// The last samples of all motion sensors.
#[derive(Debug, Clone, Default)]
pub(super) struct MotionInputs {
    pub(super) attitude: Attitude,
    imu: Option<LastImu>,
    wheels: Option<LastWheels>,
    /// Stamp of the last wheel sample.
    wheels_stamp: Option<Stamp>,
    command: Option<Twist>,
    /// Commanded twist under the motors' acceleration limit.
    achievable_twist: Twist,
    /// Time since the wheels stopped, seconds.
    stationary_time: f32,
}

impl MotionInputs {
    /// Prediction from `from` to `to` by the samples before `to`.
    pub(super) fn prediction_input(
        &mut self,
        from: Stamp,
        to: Stamp,
        config: &AttitudeConfig,
    ) -> PredictionInput {
        let seconds = from.seconds_until(to) as f32;
        let timeout = f64::from(config.timeout);
        let imu = self
            .imu
            .as_mut()
            .filter(|imu| imu.stamp.seconds_until(to) <= timeout);
        let mut shock = false;
        let interval = imu.map(|imu| {
            shock = imu.shock;
            imu.extrapolate(imu.stamp.seconds_until(from) as f32, seconds)
        });
        PredictionInput {
            dt: seconds,
            imu: interval,
            command: self.command,
            shock,
        }
    }

    /// Stamp of the last reading of the inertial unit.
    pub(super) fn imu_stamp(&self) -> Option<Stamp> {
        self.imu.map(|imu| imu.stamp)
    }

    /// Is the last reading of the inertial unit within the timeout?
    pub(super) fn imu_active(&self, now: Stamp, config: &AttitudeConfig) -> bool {
        self.imu
            .is_some_and(|imu| imu.stamp.seconds_until(now).abs() <= f64::from(config.timeout))
    }

    /// Takes a reading of the inertial unit while the filters are at `from`.
    ///
    /// A reading covers the time since the previous one. The part that the filters already received is left out.
    pub(super) fn receive_imu(
        &mut self,
        imu: &Imu,
        from: Stamp,
        config: &AttitudeConfig,
        collision: &CollisionConfig,
    ) -> ImuPrediction {
        let remaining = from.seconds_until(imu.stamp) as f32;
        let previous = self.imu;
        let interval = previous.map_or(f64::INFINITY, |last| last.stamp.seconds_until(imu.stamp));
        let connected = interval > 0.0 && interval <= f64::from(config.timeout);
        let seconds = if connected { interval as f32 } else { 0.0 };
        let wheel_acceleration = self
            .wheels
            .filter(|wheels| {
                wheels.stamp.seconds_until(imu.stamp).abs() <= WHEEL_ACCELERATION_AGE_MAX
            })
            .map_or([0.0; 2], |wheels| wheels.acceleration);
        let commanded = self.commanded_acceleration(seconds, collision);
        let stationary = self.is_stationary(imu.angular_velocity, config);
        if stationary && connected {
            self.attitude
                .zero_rate_update(imu.angular_velocity, seconds, config);
        }
        self.attitude.update_imu(
            imu.angular_velocity,
            imu.specific_force,
            wheel_acceleration,
            seconds,
            config,
        );
        let acceleration = self.attitude.remove_gravity(imu.specific_force);
        let excess = math::hypot(
            acceleration[0] - commanded[0],
            acceleration[1] - commanded[1],
        );
        let excess_max = if self.command.is_some() {
            collision.shock_acceleration
        } else {
            collision.shock_acceleration + collision.motor_acceleration_max
        };
        let shock = excess > excess_max;
        let mean_period = match previous {
            Some(last) if connected && last.mean_period > 0.0 => {
                last.mean_period + (seconds - last.mean_period) / PERIOD_READINGS
            }
            _ => seconds,
        };
        let step = seconds.max(mean_period);
        let angular_acceleration = match previous {
            Some(last) if connected && !shock => {
                std::array::from_fn(|k| (imu.angular_velocity[k] - last.rate[k]) / step)
            }
            _ => [0.0; 3],
        };
        let (jerk, vibration_variance) = match previous {
            Some(last) if connected => last.estimate_vibration(imu, step),
            _ => ([0.0; 2], 0.0),
        };
        let reading = LastImu {
            stamp: imu.stamp,
            specific_force: [imu.specific_force[0], imu.specific_force[1]],
            rate: imu.angular_velocity,
            angular_acceleration,
            jerk,
            vibration_variance,
            sample_period: seconds,
            mean_period,
            shock,
            integrated: [0.0; 5],
        };
        self.imu = Some(reading);
        ImuPrediction {
            input: PredictionInput {
                dt: remaining,
                imu: previous
                    .filter(|_| connected && remaining > 0.0)
                    .map(|last| reading.remaining_interval(&last, remaining)),
                command: self.command,
                shock: shock && connected,
            },
            stationary: (stationary && connected).then_some(seconds),
        }
    }

    /// Acceleration that the command explains, m/s², robot frame (docs/methods.md 10). Advances the achievable twist.
    fn commanded_acceleration(&mut self, seconds: f32, config: &CollisionConfig) -> [f32; 2] {
        let Some(command) = self.command else {
            // The centripetal acceleration alone.
            return self.wheels.map_or([0.0; 2], |wheels| {
                let Twist { x, y, theta } = wheels.velocity;
                [-theta * y, theta * x]
            });
        };
        let current = self.achievable_twist;
        let (dx, dy) = (command.x - current.x, command.y - current.y);
        let change = math::hypot(dx, dy);
        let change_max = config.motor_acceleration_max * seconds;
        let share = if change > change_max {
            change_max / change
        } else {
            1.0
        };
        self.achievable_twist = Twist {
            x: current.x + share * dx,
            y: current.y + share * dy,
            theta: command.theta,
        };
        let per_second = if seconds > 0.0 { share / seconds } else { 0.0 };
        let Twist { x, y, theta } = self.achievable_twist;
        [dx * per_second - theta * y, dy * per_second + theta * x]
    }

    fn is_stationary(&self, rate: [f32; 3], config: &AttitudeConfig) -> bool {
        let bias = self.attitude.gyro_bias();
        let rate_max = config.stationary_rate_max_deg.to_radians();
        self.stationary_time >= config.stationary_after
            && rate
                .iter()
                .zip(bias)
                .all(|(rate, bias)| (rate - bias).abs() <= rate_max)
    }

    /// Begins a new wheel interval.
    pub(super) fn restart_wheels(&mut self, stamp: Stamp) {
        self.wheels_stamp = Some(stamp);
        self.wheels = None;
        self.stationary_time = 0.0;
    }

    /// Takes a wheel sample and returns the filters' measurement.
    pub(super) fn receive_wheels(
        &mut self,
        odometry: &Odometry,
        config: &AttitudeConfig,
    ) -> WheelIncrement {
        let motion = [odometry.dx, odometry.dy, odometry.dtheta];
        let previous = self.wheels_stamp.replace(odometry.stamp);
        let seconds = previous.map_or(0.0, |stamp| stamp.seconds_until(odometry.stamp) as f32);
        let increment = WheelIncrement {
            motion,
            dt: seconds,
            slip: odometry.slip,
            imu_active: self.imu_active(odometry.stamp, config),
        };
        if !(seconds > 0.0) {
            return increment;
        }
        let [x, y, theta] = motion.map(|value| value / seconds);
        let acceleration = self.wheels.map_or([0.0; 2], |last| {
            let (dx, dy) = (x - last.velocity.x, y - last.velocity.y);
            [dx / seconds - theta * y, dy / seconds + theta * x]
        });
        self.wheels = Some(LastWheels {
            stamp: odometry.stamp,
            velocity: Twist { x, y, theta },
            acceleration,
        });
        self.stationary_time = if motion == [0.0; 3] {
            self.stationary_time + seconds
        } else {
            0.0
        };
        increment
    }

    /// Takes a velocity command.
    pub(super) fn receive_command(&mut self, twist: Twist) {
        self.command = Some(twist);
    }

    /// Tilt (a, b) at a time close to the last reading. None without a reading within the timeout.
    pub(super) fn tilt_at(&self, stamp: Stamp, config: &AttitudeConfig) -> Option<[f32; 2]> {
        let last = self.imu?;
        let since = last.stamp.seconds_until(stamp) as f32;
        if since.abs() > config.timeout {
            return None;
        }
        // The up direction rotates against the robot: u̇ = u × ω.
        let rate =
            nalgebra::Vector3::from(last.rate) - nalgebra::Vector3::from(self.attitude.gyro_bias());
        let up = self.attitude.up();
        let up = up + up.cross(&rate) * since;
        Some([up.x, up.y])
    }
}

#[cfg(test)]
mod tests;
