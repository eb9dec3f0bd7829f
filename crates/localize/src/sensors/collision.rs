//! Was the robot hit? Felt acceleration against the commanded one, and the wheels' motion against the felt one.
//!
//! minho2016 V.A: when robots collide their wheels drive on, spinning or skidding, and odometry errs largely; vision is
//! then fused without it. Here the inertial unit takes the wheels' place meanwhile, so that a blind robot keeps its way.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// When are the wheels not believed?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CollisionConfig {
    /// Felt acceleration beyond the commanded one from which on something hit the robot, m/s²: half of gravity, since
    /// rubber on carpet hardly pushes more.
    pub shock_acceleration: f32,
    /// What the motors can do of themselves, m/s²: how fast a commanded twist is taken up.
    pub motor_acceleration_max: f32,
    /// Speed between wheels and ground from which on the wheels are not believed, m/s.
    pub slip_speed_max: f32,
    /// The same of the turn, rad/s.
    pub slip_yaw_rate_max: f32,
    /// In standard deviations of the motion that is believed instead, the same slip must be at least so much.
    pub significance_sigmas: f32,
    /// A collision is over when nothing spoke of it for so long, seconds.
    pub hold_time: f32,
    /// After so long wheels are believed again whatever the inertial unit says, seconds: it drifts, or it is broken.
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

/// How far the wheels are from the motion believed without them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelMismatch {
    /// Speed of the rims over the ground, m/s, and its standard deviation by what is known of the motion.
    pub speed: [f32; 2],
    /// The same of the turn, rad/s.
    pub yaw_rate: [f32; 2],
}

/// Does a collision last?
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CollisionDetector {
    /// Until it is over if nothing more happens, seconds.
    remaining: f32,
    /// Since it began, seconds.
    duration: f32,
}

impl CollisionDetector {
    /// Does it last?
    pub fn is_active(&self) -> bool {
        self.remaining > 0.0
    }

    /// Time passes.
    pub fn advance_time(&mut self, seconds: f32) {
        if self.remaining > 0.0 {
            self.duration += seconds;
            self.remaining -= seconds;
        }
        if self.remaining <= 0.0 {
            *self = CollisionDetector::default();
        }
    }

    /// Something hit the robot.
    pub fn trigger(&mut self, config: &CollisionConfig) {
        self.remaining = config.hold_time;
    }

    /// Hears how far the wheels are off; true if they are to be believed.
    ///
    /// What began a collision must fall to half before it ends, so that it does not flicker.
    pub fn accepts_wheels(&mut self, off: &WheelMismatch, config: &CollisionConfig) -> bool {
        if self.duration >= config.timeout {
            *self = CollisionDetector::default();
            return true;
        }
        let part = if self.is_active() { 0.5 } else { 1.0 };
        let speaks = |[value, std]: [f32; 2], most: f32| {
            value > part * most && value > part * config.significance_sigmas * std
        };
        if speaks(off.speed, config.slip_speed_max)
            || speaks(off.yaw_rate, config.slip_yaw_rate_max)
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
            speed: [speed, std],
            yaw_rate: [0.0, 0.1],
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
        let mut until = 0;
        while !collision.accepts_wheels(&mismatch(0.02, 0.05), &config) {
            collision.advance_time(0.01);
            until += 1;
        }
        assert!((9..=11).contains(&until), "{until}");
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
        let believed = (0..1000).position(|_| {
            collision.advance_time(0.01);
            collision.accepts_wheels(&mismatch(9.0, 0.01), &config)
        });
        assert!((490..520).contains(&believed.expect("believed again")));
    }
}
