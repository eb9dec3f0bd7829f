//! What is felt and wanted of the motion? Inertial unit, wheels and commands, made ready for every belief alike.

use crate::attitude::{Attitude, AttitudeConfig};
use crate::collision::CollisionConfig;
use crate::filter::{Felt, Span, Way};
use crate::omni::Twist;
use crate::sample::{Command, Imu, Odometry};
use crate::stamp::Stamp;

/// A sample that moves beliefs.
#[derive(Debug, Clone, Copy)]
pub(super) enum Witness {
    /// Of the wheels; their interval is shorter than the longest gap.
    Wheels(Odometry),
    /// Of the wheels, but its interval is unknown or too long: counting begins anew.
    WheelsAnew(Odometry),
    Imu(Imu),
    Command(Command),
}

impl Witness {
    pub(super) fn stamp(&self) -> Stamp {
        match self {
            Witness::Wheels(one) | Witness::WheelsAnew(one) => one.stamp,
            Witness::Imu(one) => one.stamp,
            Witness::Command(one) => one.stamp,
        }
    }
}

/// How much an accelerometer rattles is learnt within so long, seconds.
const RATTLE_TIME: f32 = 1.0;
/// One reading proves no more than so many times what was known, and this, (m/s²)²: a shock is no rattling.
const RATTLE_STEP: f32 = 9.0;
const RATTLE_LEAST: f32 = 0.01;

/// The last reading of the inertial unit.
#[derive(Debug, Clone, Copy)]
struct Reading {
    stamp: Stamp,
    /// Specific force along x and y, m/s².
    force: [f32; 2],
    rate: [f32; 3],
    /// How fast that changes, rad/s².
    speeding: [f32; 3],
    /// How fast the force changed, m/s³, and what of it scatters from reading to reading, (m/s²)².
    jerk: [f32; 2],
    rattle: f32,
    /// Since the one before, seconds.
    interval: f32,
    shock: bool,
    /// Force and rate times their duration that beliefs were given since.
    given: [f32; 5],
}

impl Reading {
    /// What it says of the last `left` seconds before it, when beliefs were given the rest already.
    fn rest_of(&self, before: &Reading, left: f32) -> Felt {
        // A gyro tells the rate of a moment: between two of them it changes evenly.
        let told: [f32; 5] = std::array::from_fn(|k| match k {
            0 | 1 => self.force[k],
            _ => 0.5 * (before.rate[k - 2] + self.rate[k - 2]),
        });
        let rest = |k: usize| (told[k] * self.interval - before.given[k]) / left;
        Felt {
            force: [rest(0), rest(1)],
            rate: [rest(2), rest(3), rest(4)],
            spin: self.rate[2],
            rattle: self.rattle.sqrt(),
            interval: self.interval,
        }
    }

    /// Jerk of the force up to a later reading, and how much readings scatter by then.
    ///
    /// Second differences of independent errors have six times their variance; what a robot does is smooth beside them,
    /// and a shock is no scatter.
    fn rattled(&self, imu: &Imu, seconds: f32) -> ([f32; 2], f32) {
        let jerk = [0, 1].map(|k| (imu.acceleration[k] - self.force[k]) / seconds);
        let off = [0, 1].map(|k| (jerk[k] - self.jerk[k]) * seconds);
        let proved = (off[0] * off[0] + off[1] * off[1]) / 12.0;
        let most = RATTLE_STEP * self.rattle + RATTLE_LEAST;
        let share = (seconds / RATTLE_TIME).min(1.0);
        (jerk, self.rattle + share * (proved.min(most) - self.rattle))
    }

    /// What it says of `seconds`, `since` after it, when nothing newer was heard; noted as given.
    ///
    /// The rate changes as it did: a robot that begins to turn is not seen a few milliseconds late.
    fn onward(&mut self, since: f32, seconds: f32) -> Felt {
        let ahead = since + 0.5 * seconds;
        let rate: [f32; 3] = std::array::from_fn(|k| self.rate[k] + ahead * self.speeding[k]);
        let told = self.force.iter().chain(&rate);
        for (given, value) in self.given.iter_mut().zip(told) {
            *given += value * seconds;
        }
        Felt {
            force: self.force,
            rate,
            spin: self.rate[2] + (since + seconds) * self.speeding[2],
            rattle: self.rattle.sqrt(),
            interval: self.interval,
        }
    }
}

/// The last interval of the wheels.
#[derive(Debug, Clone, Copy)]
struct Rolled {
    stamp: Stamp,
    velocity: Twist,
    /// Of the robot over the ground, m/s², robot frame; of one interval, with the noise of coarse ticks.
    acceleration: [f32; 2],
}

/// Samples of all witnesses as they were last heard.
#[derive(Debug, Clone, Default)]
pub(super) struct Motion {
    pub(super) attitude: Attitude,
    felt: Option<Reading>,
    rolled: Option<Rolled>,
    /// When the wheels were last heard.
    counted: Option<Stamp>,
    command: Option<Twist>,
    /// What the motors make of the commands by their limits.
    followed: Twist,
    /// For how long the wheels have stood, seconds.
    stood: f32,
}

impl Motion {
    /// The stretch from `from` to `to`, as far as is known before anything at `to` is heard.
    pub(super) fn span(&mut self, from: Stamp, to: Stamp, config: &AttitudeConfig) -> Span {
        let seconds = from.seconds_until(to) as f32;
        let silence = f64::from(config.silence);
        let felt = self
            .felt
            .as_mut()
            .filter(|felt| felt.stamp.seconds_until(to) <= silence);
        let mut shock = false;
        let felt = felt.map(|felt| {
            shock = felt.shock;
            felt.onward(felt.stamp.seconds_until(from) as f32, seconds)
        });
        Span {
            seconds,
            felt,
            command: self.command,
            shock,
        }
    }

    /// Is the inertial unit alive at that time?
    pub(super) fn watched(&self, now: Stamp, config: &AttitudeConfig) -> bool {
        self.felt
            .is_some_and(|felt| felt.stamp.seconds_until(now).abs() <= f64::from(config.silence))
    }

    /// Hears the inertial unit when beliefs have reached `from`: the stretch to its reading, and for how long the
    /// robot rested, seconds.
    ///
    /// A reading holds for the time since the one before; what beliefs were given of it already is left out.
    pub(super) fn feel(
        &mut self,
        imu: &Imu,
        from: Stamp,
        config: &AttitudeConfig,
        collision: &CollisionConfig,
    ) -> (Span, Option<f32>) {
        let left = from.seconds_until(imu.stamp) as f32;
        let before = self.felt;
        let since = before.map_or(f64::INFINITY, |felt| felt.stamp.seconds_until(imu.stamp));
        let connected = since > 0.0 && since <= f64::from(config.silence);
        let seconds = if connected { since as f32 } else { 0.0 };
        let moving = self
            .rolled
            .filter(|rolled| rolled.stamp.seconds_until(imu.stamp).abs() <= 0.1)
            .map_or([0.0; 2], |rolled| rolled.acceleration);
        let wanted = self.wanted(seconds, collision);
        let resting = self.rests(imu.rate, config);
        if resting && connected {
            self.attitude.rest(imu.rate, seconds, config);
        }
        self.attitude
            .feel(imu.rate, imu.acceleration, moving, seconds, config);
        let acceleration = self.attitude.without_gravity(imu.acceleration);
        let beyond = (acceleration[0] - wanted[0]).hypot(acceleration[1] - wanted[1]);
        let most = if self.command.is_some() {
            collision.shock
        } else {
            collision.shock + collision.motor_acceleration
        };
        let shock = beyond > most;
        let speeding = match before {
            Some(before) if connected && !shock => {
                std::array::from_fn(|k| (imu.rate[k] - before.rate[k]) / seconds)
            }
            _ => [0.0; 3],
        };
        let (jerk, rattle) = match before {
            Some(before) if connected => before.rattled(imu, seconds),
            _ => ([0.0; 2], 0.0),
        };
        let reading = Reading {
            stamp: imu.stamp,
            force: [imu.acceleration[0], imu.acceleration[1]],
            rate: imu.rate,
            speeding,
            jerk,
            rattle,
            interval: seconds,
            shock,
            given: [0.0; 5],
        };
        self.felt = Some(reading);
        let span = Span {
            seconds: left,
            felt: before
                .filter(|_| connected && left > 0.0)
                .map(|before| reading.rest_of(&before, left)),
            command: self.command,
            shock: shock && connected,
        };
        (span, (resting && connected).then_some(seconds))
    }

    /// The acceleration that motors and commands explain, m/s², robot frame; moves what they follow.
    fn wanted(&mut self, seconds: f32, config: &CollisionConfig) -> [f32; 2] {
        let Some(command) = self.command else {
            // Only what keeps the robot on its curve.
            return self.rolled.map_or([0.0; 2], |rolled| {
                let Twist { x, y, theta } = rolled.velocity;
                [-theta * y, theta * x]
            });
        };
        let now = self.followed;
        let (dx, dy) = (command.x - now.x, command.y - now.y);
        let size = dx.hypot(dy);
        let most = config.motor_acceleration * seconds;
        let part = if size > most { most / size } else { 1.0 };
        self.followed = Twist {
            x: now.x + part * dx,
            y: now.y + part * dy,
            theta: command.theta,
        };
        let per_second = if seconds > 0.0 { part / seconds } else { 0.0 };
        let Twist { x, y, theta } = self.followed;
        [dx * per_second - theta * y, dy * per_second + theta * x]
    }

    fn rests(&self, rate: [f32; 3], config: &AttitudeConfig) -> bool {
        let bias = self.attitude.bias();
        let most = config.rest_rate_deg.to_radians();
        self.stood >= config.rest_after
            && rate
                .iter()
                .zip(bias)
                .all(|(rate, bias)| (rate - bias).abs() <= most)
    }

    /// The wheels' counting begins.
    pub(super) fn roll_anew(&mut self, stamp: Stamp) {
        self.counted = Some(stamp);
        self.rolled = None;
        self.stood = 0.0;
    }

    /// Hears the wheels.
    pub(super) fn roll(&mut self, odometry: &Odometry, config: &AttitudeConfig) -> Way {
        let motion = [odometry.dx, odometry.dy, odometry.dtheta];
        let before = self.counted.replace(odometry.stamp);
        let seconds = before.map_or(0.0, |before| before.seconds_until(odometry.stamp) as f32);
        let way = Way {
            motion,
            seconds,
            slip: odometry.slip,
            watched: self.watched(odometry.stamp, config),
        };
        if !(seconds > 0.0) {
            return way;
        }
        let [x, y, theta] = motion.map(|value| value / seconds);
        let velocity = Twist { x, y, theta };
        let acceleration = self.rolled.map_or([0.0; 2], |before| {
            let before = before.velocity;
            let (dx, dy) = (x - before.x, y - before.y);
            [dx / seconds - theta * y, dy / seconds + theta * x]
        });
        self.rolled = Some(Rolled {
            stamp: odometry.stamp,
            velocity,
            acceleration,
        });
        let stands = motion == [0.0; 3];
        self.stood = if stands { self.stood + seconds } else { 0.0 };
        way
    }

    /// Hears what the motors are told.
    pub(super) fn told(&mut self, twist: Twist) {
        self.command = Some(twist);
    }

    /// Lean at a time shortly after the last reading; none where no inertial unit tells.
    pub(super) fn lean_at(&self, stamp: Stamp, config: &AttitudeConfig) -> Option<[f32; 2]> {
        let felt = self.felt?;
        let since = felt.stamp.seconds_until(stamp) as f32;
        if since.abs() > config.silence {
            return None;
        }
        // Up turns against the robot: u̇ = u × ω.
        let rate =
            nalgebra::Vector3::from(felt.rate) - nalgebra::Vector3::from(self.attitude.bias());
        let up = self.attitude.up();
        let up = up + up.cross(&rate) * since;
        Some([up.x, up.y])
    }
}
