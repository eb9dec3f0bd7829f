//! Collision detection (docs/methods.md 10): measured against commanded acceleration, and wheels against inertial unit.
//!
//! minho2016 V.A: in a collision the wheels spin or skid and odometry fails, so vision is fused without it. Here the
//! inertial unit replaces the wheels meanwhile.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Limits of the collision detector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CollisionConfig {
    /// Deviation of the measured from the commanded acceleration that starts a collision, m/s². Half of gravity: rubber
    /// on carpet hardly transmits more.
    pub shock_acceleration: f32,
    /// Acceleration limit of the motors, m/s²: the ramp of a commanded twist.
    pub motor_acceleration_max: f32,
    /// Deviation of the wheels' speed from the predicted one that starts a collision, m/s.
    pub slip_speed_max: f32,
    /// Deviation of the wheels' yaw rate from the predicted one that starts a collision, rad/s.
    pub slip_yaw_rate_max: f32,
    /// Smallest deviation for a collision, in standard deviations of the predicted motion. A smaller value detects more
    /// collisions and more false ones.
    pub significance_sigmas: f32,
    /// Time from the last sign of a collision to its end, seconds.
    pub hold_time: f32,
    /// Longest collision, seconds. Afterwards the wheels are used again, since the inertial unit may be faulty.
    pub timeout: f32,
}

impl Default for CollisionConfig {
    fn default() -> Self {
        CollisionConfig {
            shock_acceleration: 5.0,
            motor_acceleration_max: 3.0,
            slip_speed_max: 0.25,
            slip_yaw_rate_max: 0.8,
            significance_sigmas: 3.5,
            hold_time: 0.1,
            timeout: 5.0,
        }
    }
}

/// A value with its standard deviation, in the same unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f32,
    /// Standard deviation.
    pub std: f32,
}

/// Velocity of the wheels against the motion predicted without them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelMismatch {
    /// Translation, m/s.
    pub speed: Measured,
    /// Rotation, rad/s.
    pub yaw_rate: Measured,
}

/// State of the collision detector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CollisionDetector {
    /// Time to the end without a further sign, seconds.
    remaining: f32,
    /// Time since the start, seconds.
    duration: f32,
}

impl CollisionDetector {
    /// Is a collision in progress?
    pub fn is_active(&self) -> bool {
        self.remaining > 0.0
    }

    /// Advances the detector's time.
    pub fn advance_time(&mut self, seconds: f32) {
        if self.remaining > 0.0 {
            self.duration += seconds;
            self.remaining -= seconds;
        }
        if self.remaining <= 0.0 {
            *self = CollisionDetector::default();
        }
    }

    /// Starts or prolongs a collision.
    pub fn trigger(&mut self, config: &CollisionConfig) {
        self.remaining = config.hold_time;
    }

    /// Takes a deviation of the wheels. Returns whether the wheel sample may be used.
    ///
    /// During a collision half of each limit prolongs it (hysteresis).
    pub fn accepts_wheels(&mut self, mismatch: &WheelMismatch, config: &CollisionConfig) -> bool {
        if self.duration >= config.timeout {
            *self = CollisionDetector::default();
            return true;
        }
        let share = if self.is_active() { 0.5 } else { 1.0 };
        let exceeds = |Measured { value, std }: Measured, limit: f32| {
            value > share * limit && value > share * config.significance_sigmas * std
        };
        if exceeds(mismatch.speed, config.slip_speed_max)
            || exceeds(mismatch.yaw_rate, config.slip_yaw_rate_max)
        {
            self.trigger(config);
        }
        !self.is_active()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mismatch(speed: f32, std: f32) -> WheelMismatch {
        WheelMismatch {
            speed: Measured { value: speed, std },
            yaw_rate: Measured {
                value: 0.0,
                std: 0.1,
            },
        }
    }

    #[test]
    fn spinning_wheels_are_rejected_until_they_agree_with_the_imu() {
        let config = CollisionConfig::default();
        let mut collision = CollisionDetector::default();
        assert!(collision.accepts_wheels(&mismatch(0.1, 0.01), &config));
        assert!(!collision.accepts_wheels(&mismatch(1.0, 0.02), &config));
        for _ in 0..50 {
            collision.advance_time(0.01);
            assert!(!collision.accepts_wheels(&mismatch(0.8, 0.05), &config));
        }
        let mut steps = 0;
        while !collision.accepts_wheels(&mismatch(0.02, 0.05), &config) {
            collision.advance_time(0.01);
            steps += 1;
        }
        assert!((9..=11).contains(&steps), "{steps}");
    }

    #[test]
    fn wheels_are_accepted_while_the_imu_motion_is_uncertain() {
        let config = CollisionConfig::default();
        assert!(CollisionDetector::default().accepts_wheels(&mismatch(1.0, 0.5), &config));
    }

    #[test]
    fn wheels_are_accepted_again_after_the_collision_timeout() {
        let config = CollisionConfig::default();
        let mut collision = CollisionDetector::default();
        let accepted = (0..1000).position(|_| {
            collision.advance_time(0.01);
            collision.accepts_wheels(&mismatch(9.0, 0.01), &config)
        });
        assert!((490..520).contains(&accepted.expect("wheels accepted again")));
    }
}
