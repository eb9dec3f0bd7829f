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
    pub shock: f32,
    /// What the motors can do of themselves, m/s²: how fast a commanded twist is taken up.
    pub motor_acceleration: f32,
    /// Speed between wheels and ground from which on the wheels are not believed, m/s.
    pub slip_speed: f32,
    /// The same of the turn, rad/s.
    pub slip_turn: f32,
    /// In standard deviations of the motion that is believed instead, the same slip must be at least so much.
    pub significance: f32,
    /// A collision is over when nothing spoke of it for so long, seconds.
    pub hold: f32,
    /// After so long wheels are believed again whatever the inertial unit says, seconds: it drifts, or it is broken.
    pub longest: f32,
}

impl Default for CollisionConfig {
    fn default() -> Self {
        CollisionConfig {
            shock: 5.0,
            motor_acceleration: 3.0,
            slip_speed: 0.25,
            slip_turn: 0.8,
            significance: 3.5,
            hold: 0.1,
            longest: 5.0,
        }
    }
}

/// How far the wheels are from the motion believed without them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mismatch {
    /// Speed of the rims over the ground, m/s, and its standard deviation by what is known of the motion.
    pub speed: [f32; 2],
    /// The same of the turn, rad/s.
    pub turn: [f32; 2],
}

/// Does a collision last?
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Collision {
    /// Until it is over if nothing more happens, seconds.
    left: f32,
    /// Since it began, seconds.
    lasted: f32,
}

impl Collision {
    /// Does it last?
    pub fn lasts(&self) -> bool {
        self.left > 0.0
    }

    /// Time passes.
    pub fn pass(&mut self, seconds: f32) {
        if self.left > 0.0 {
            self.lasted += seconds;
            self.left -= seconds;
        }
        if self.left <= 0.0 {
            *self = Collision::default();
        }
    }

    /// Something hit the robot.
    pub fn hit(&mut self, config: &CollisionConfig) {
        self.left = config.hold;
    }

    /// Hears how far the wheels are off; true if they are to be believed.
    ///
    /// What began a collision must fall to half before it ends, so that it does not flicker.
    pub fn believes(&mut self, off: &Mismatch, config: &CollisionConfig) -> bool {
        if self.lasted >= config.longest {
            *self = Collision::default();
            return true;
        }
        let part = if self.lasts() { 0.5 } else { 1.0 };
        let speaks = |[value, std]: [f32; 2], most: f32| {
            value > part * most && value > part * config.significance * std
        };
        if speaks(off.speed, config.slip_speed) || speaks(off.turn, config.slip_turn) {
            self.hit(config);
        }
        !self.lasts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn off(speed: f32, std: f32) -> Mismatch {
        Mismatch {
            speed: [speed, std],
            turn: [0.0, 0.1],
        }
    }

    #[test]
    fn wheels_that_spin_are_not_believed_until_they_agree_again() {
        let config = CollisionConfig::default();
        let mut collision = Collision::default();
        assert!(collision.believes(&off(0.1, 0.01), &config));
        assert!(!collision.believes(&off(1.0, 0.02), &config));
        for _ in 0..50 {
            collision.pass(0.01);
            assert!(!collision.believes(&off(0.8, 0.05), &config));
        }
        let mut until = 0;
        while !collision.believes(&off(0.02, 0.05), &config) {
            collision.pass(0.01);
            until += 1;
        }
        assert!((9..=11).contains(&until), "{until}");
    }

    #[test]
    fn who_knows_no_better_believes_the_wheels() {
        let config = CollisionConfig::default();
        assert!(Collision::default().believes(&off(1.0, 0.5), &config));
    }

    #[test]
    fn no_broken_unit_silences_the_wheels_for_ever() {
        let config = CollisionConfig::default();
        let mut collision = Collision::default();
        let believed = (0..1000).position(|_| {
            collision.pass(0.01);
            collision.believes(&off(9.0, 0.01), &config)
        });
        assert!((490..520).contains(&believed.expect("believed again")));
    }
}
