//! What is felt and wanted of the motion? Inertial unit, wheels and commands, made ready for every belief alike.

use crate::filter::{ImuInterval, PredictionInput, WheelIncrement};
use crate::omni::Twist;
use crate::sample::{Imu, Odometry, VelocityCommand};
use crate::sensors::attitude::{Attitude, AttitudeConfig};
use crate::sensors::collision::CollisionConfig;
use crate::stamp::Stamp;

/// A sample that moves beliefs.
#[derive(Debug, Clone, Copy)]
pub(super) enum MotionMeasurement {
    /// Of the wheels; their interval is shorter than the longest gap.
    Wheels(Odometry),
    /// Of the wheels, but its interval is unknown or too long: counting begins anew.
    WheelsRestarted(Odometry),
    Imu(Imu),
    Command(VelocityCommand),
}

impl MotionMeasurement {
    pub(super) fn stamp(&self) -> Stamp {
        match self {
            MotionMeasurement::Wheels(one) | MotionMeasurement::WheelsRestarted(one) => one.stamp,
            MotionMeasurement::Imu(one) => one.stamp,
            MotionMeasurement::Command(one) => one.stamp,
        }
    }
}

/// How much an accelerometer rattles is learnt within so long, seconds.
const VIBRATION_TIME_CONSTANT: f32 = 1.0;
/// One reading proves no more than so many times what was known, and this, (m/s²)²: a shock is no rattling.
const VIBRATION_GROWTH_MAX: f32 = 9.0;
const VIBRATION_VARIANCE_STEP: f32 = 0.01;

/// The last reading of the inertial unit.
#[derive(Debug, Clone, Copy)]
struct LastImu {
    stamp: Stamp,
    /// Specific force along x and y, m/s².
    specific_force: [f32; 2],
    rate: [f32; 3],
    /// How fast that changes, rad/s².
    angular_acceleration: [f32; 3],
    /// How fast the force changed, m/s³, and what of it scatters from reading to reading, (m/s²)².
    jerk: [f32; 2],
    vibration_variance: f32,
    /// Since the one before, seconds.
    sample_period: f32,
    shock: bool,
    /// Force and rate times their duration that beliefs were given since.
    integrated: [f32; 5],
}

impl LastImu {
    /// What it says of the last `left` seconds before it, when beliefs were given the rest already.
    fn remaining_interval(&self, before: &LastImu, left: f32) -> ImuInterval {
        // A gyro tells the rate of a moment: between two of them it changes evenly.
        let told: [f32; 5] = std::array::from_fn(|k| match k {
            0 | 1 => self.specific_force[k],
            _ => 0.5 * (before.rate[k - 2] + self.rate[k - 2]),
        });
        let rest = |k: usize| (told[k] * self.sample_period - before.integrated[k]) / left;
        ImuInterval {
            specific_force: [rest(0), rest(1)],
            rate: [rest(2), rest(3), rest(4)],
            yaw_rate: self.rate[2],
            vibration_std: self.vibration_variance.sqrt(),
            sample_period: self.sample_period,
        }
    }

    /// Jerk of the force up to a later reading, and how much readings scatter by then.
    ///
    /// Second differences of independent errors have six times their variance; what a robot does is smooth beside them,
    /// and a shock is no scatter.
    fn estimate_vibration(&self, imu: &Imu, seconds: f32) -> ([f32; 2], f32) {
        let jerk = [0, 1].map(|k| (imu.acceleration[k] - self.specific_force[k]) / seconds);
        let off = [0, 1].map(|k| (jerk[k] - self.jerk[k]) * seconds);
        let proved = (off[0] * off[0] + off[1] * off[1]) / 12.0;
        let most = VIBRATION_GROWTH_MAX * self.vibration_variance + VIBRATION_VARIANCE_STEP;
        let share = (seconds / VIBRATION_TIME_CONSTANT).min(1.0);
        (
            jerk,
            self.vibration_variance + share * (proved.min(most) - self.vibration_variance),
        )
    }

    /// What it says of `seconds`, `since` after it, when nothing newer was heard; noted as given.
    ///
    /// The rate changes as it did: a robot that begins to turn is not seen a few milliseconds late.
    fn extrapolate(&mut self, since: f32, seconds: f32) -> ImuInterval {
        let ahead = since + 0.5 * seconds;
        let rate: [f32; 3] =
            std::array::from_fn(|k| self.rate[k] + ahead * self.angular_acceleration[k]);
        let told = self.specific_force.iter().chain(&rate);
        for (given, value) in self.integrated.iter_mut().zip(told) {
            *given += value * seconds;
        }
        ImuInterval {
            specific_force: self.specific_force,
            rate,
            yaw_rate: self.rate[2] + (since + seconds) * self.angular_acceleration[2],
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
    /// Of the robot over the ground, m/s², robot frame; of one interval, with the noise of coarse ticks.
    acceleration: [f32; 2],
}

/// Samples of all witnesses as they were last heard.
#[derive(Debug, Clone, Default)]
pub(super) struct MotionInputs {
    pub(super) attitude: Attitude,
    imu: Option<LastImu>,
    wheels: Option<LastWheels>,
    /// When the wheels were last heard.
    wheels_stamp: Option<Stamp>,
    command: Option<Twist>,
    /// What the motors make of the commands by their limits.
    achievable_twist: Twist,
    /// For how long the wheels have stood, seconds.
    stationary_time: f32,
}

impl MotionInputs {
    /// The stretch from `from` to `to`, as far as is known before anything at `to` is heard.
    pub(super) fn prediction_input(
        &mut self,
        from: Stamp,
        to: Stamp,
        config: &AttitudeConfig,
    ) -> PredictionInput {
        let seconds = from.seconds_until(to) as f32;
        let silence = f64::from(config.timeout);
        let felt = self
            .imu
            .as_mut()
            .filter(|felt| felt.stamp.seconds_until(to) <= silence);
        let mut shock = false;
        let felt = felt.map(|felt| {
            shock = felt.shock;
            felt.extrapolate(felt.stamp.seconds_until(from) as f32, seconds)
        });
        PredictionInput {
            dt: seconds,
            imu: felt,
            command: self.command,
            shock,
        }
    }

    /// Is the inertial unit alive at that time?
    pub(super) fn imu_active(&self, now: Stamp, config: &AttitudeConfig) -> bool {
        self.imu
            .is_some_and(|felt| felt.stamp.seconds_until(now).abs() <= f64::from(config.timeout))
    }

    /// Hears the inertial unit when beliefs have reached `from`: the stretch to its reading, and for how long the
    /// robot rested, seconds.
    ///
    /// A reading holds for the time since the one before; what beliefs were given of it already is left out.
    pub(super) fn receive_imu(
        &mut self,
        imu: &Imu,
        from: Stamp,
        config: &AttitudeConfig,
        collision: &CollisionConfig,
    ) -> (PredictionInput, Option<f32>) {
        let left = from.seconds_until(imu.stamp) as f32;
        let before = self.imu;
        let since = before.map_or(f64::INFINITY, |felt| felt.stamp.seconds_until(imu.stamp));
        let connected = since > 0.0 && since <= f64::from(config.timeout);
        let seconds = if connected { since as f32 } else { 0.0 };
        let moving = self
            .wheels
            .filter(|rolled| rolled.stamp.seconds_until(imu.stamp).abs() <= 0.1)
            .map_or([0.0; 2], |rolled| rolled.acceleration);
        let wanted = self.commanded_acceleration(seconds, collision);
        let resting = self.is_stationary(imu.rate, config);
        if resting && connected {
            self.attitude.zero_rate_update(imu.rate, seconds, config);
        }
        self.attitude
            .update_imu(imu.rate, imu.acceleration, moving, seconds, config);
        let acceleration = self.attitude.remove_gravity(imu.acceleration);
        let beyond = (acceleration[0] - wanted[0]).hypot(acceleration[1] - wanted[1]);
        let most = if self.command.is_some() {
            collision.shock_acceleration
        } else {
            collision.shock_acceleration + collision.motor_acceleration_max
        };
        let shock = beyond > most;
        let speeding = match before {
            Some(before) if connected && !shock => {
                std::array::from_fn(|k| (imu.rate[k] - before.rate[k]) / seconds)
            }
            _ => [0.0; 3],
        };
        let (jerk, rattle) = match before {
            Some(before) if connected => before.estimate_vibration(imu, seconds),
            _ => ([0.0; 2], 0.0),
        };
        let reading = LastImu {
            stamp: imu.stamp,
            specific_force: [imu.acceleration[0], imu.acceleration[1]],
            rate: imu.rate,
            angular_acceleration: speeding,
            jerk,
            vibration_variance: rattle,
            sample_period: seconds,
            shock,
            integrated: [0.0; 5],
        };
        self.imu = Some(reading);
        let span = PredictionInput {
            dt: left,
            imu: before
                .filter(|_| connected && left > 0.0)
                .map(|before| reading.remaining_interval(&before, left)),
            command: self.command,
            shock: shock && connected,
        };
        (span, (resting && connected).then_some(seconds))
    }

    /// The acceleration that motors and commands explain, m/s², robot frame; moves what they follow.
    fn commanded_acceleration(&mut self, seconds: f32, config: &CollisionConfig) -> [f32; 2] {
        let Some(command) = self.command else {
            // Only what keeps the robot on its curve.
            return self.wheels.map_or([0.0; 2], |rolled| {
                let Twist { x, y, theta } = rolled.velocity;
                [-theta * y, theta * x]
            });
        };
        let now = self.achievable_twist;
        let (dx, dy) = (command.x - now.x, command.y - now.y);
        let size = dx.hypot(dy);
        let most = config.motor_acceleration_max * seconds;
        let part = if size > most { most / size } else { 1.0 };
        self.achievable_twist = Twist {
            x: now.x + part * dx,
            y: now.y + part * dy,
            theta: command.theta,
        };
        let per_second = if seconds > 0.0 { part / seconds } else { 0.0 };
        let Twist { x, y, theta } = self.achievable_twist;
        [dx * per_second - theta * y, dy * per_second + theta * x]
    }

    fn is_stationary(&self, rate: [f32; 3], config: &AttitudeConfig) -> bool {
        let bias = self.attitude.gyro_bias();
        let most = config.stationary_rate_max_deg.to_radians();
        self.stationary_time >= config.stationary_after
            && rate
                .iter()
                .zip(bias)
                .all(|(rate, bias)| (rate - bias).abs() <= most)
    }

    /// The wheels' counting begins.
    pub(super) fn restart_wheels(&mut self, stamp: Stamp) {
        self.wheels_stamp = Some(stamp);
        self.wheels = None;
        self.stationary_time = 0.0;
    }

    /// Hears the wheels.
    pub(super) fn receive_wheels(
        &mut self,
        odometry: &Odometry,
        config: &AttitudeConfig,
    ) -> WheelIncrement {
        let motion = [odometry.dx, odometry.dy, odometry.dtheta];
        let before = self.wheels_stamp.replace(odometry.stamp);
        let seconds = before.map_or(0.0, |before| before.seconds_until(odometry.stamp) as f32);
        let way = WheelIncrement {
            motion,
            dt: seconds,
            slip: odometry.slip,
            imu_active: self.imu_active(odometry.stamp, config),
        };
        if !(seconds > 0.0) {
            return way;
        }
        let [x, y, theta] = motion.map(|value| value / seconds);
        let velocity = Twist { x, y, theta };
        let acceleration = self.wheels.map_or([0.0; 2], |before| {
            let before = before.velocity;
            let (dx, dy) = (x - before.x, y - before.y);
            [dx / seconds - theta * y, dy / seconds + theta * x]
        });
        self.wheels = Some(LastWheels {
            stamp: odometry.stamp,
            velocity,
            acceleration,
        });
        let stands = motion == [0.0; 3];
        self.stationary_time = if stands {
            self.stationary_time + seconds
        } else {
            0.0
        };
        way
    }

    /// Hears what the motors are told.
    pub(super) fn receive_command(&mut self, twist: Twist) {
        self.command = Some(twist);
    }

    /// Lean at a time shortly after the last reading; none where no inertial unit tells.
    pub(super) fn tilt_at(&self, stamp: Stamp, config: &AttitudeConfig) -> Option<[f32; 2]> {
        let felt = self.imu?;
        let since = felt.stamp.seconds_until(stamp) as f32;
        if since.abs() > config.timeout {
            return None;
        }
        // Up turns against the robot: u̇ = u × ω.
        let rate =
            nalgebra::Vector3::from(felt.rate) - nalgebra::Vector3::from(self.attitude.gyro_bias());
        let up = self.attitude.up();
        let up = up + up.cross(&rate) * since;
        Some([up.x, up.y])
    }
}
