//! How did the robot move since an earlier time? Its velocity at the last images, for measurements that arrive late.

use std::collections::VecDeque;

use crate::filter::MotionEstimate;
use crate::frames::{RobotFrame, Tf};
use crate::math;
use crate::omni::Twist;
use crate::stamp::Stamp;

/// Images kept.
const IMAGES_MAX: usize = 32;
/// Longest time between two images over which the velocity is interpolated, and for which it is extrapolated, seconds.
const GAP_MAX: f64 = 0.15;

/// Motion of the robot between two images, by everything that localization knows of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageMotion {
    /// Stamp of the earlier image.
    pub from: Stamp,
    /// Stamp of the later image.
    pub to: Stamp,
    /// The robot's motion between both exposures.
    pub estimate: MotionEstimate,
}

/// Velocity at the last images. Corrections of the pose do not show in it.
#[derive(Debug, Clone, Default)]
pub(super) struct OwnMotion {
    samples: VecDeque<(Stamp, Twist)>,
}

impl OwnMotion {
    /// Adds the velocity at an image.
    pub(super) fn add(&mut self, stamp: Stamp, twist: Twist) {
        let gap = self
            .samples
            .back()
            .map_or(0.0, |(last, _)| last.seconds_until(stamp));
        if !(0.0..=GAP_MAX).contains(&gap) {
            self.samples.clear();
        }
        if self.samples.len() == IMAGES_MAX {
            self.samples.pop_front();
        }
        self.samples.push_back((stamp, twist));
    }

    /// Forgets all images.
    pub(super) fn clear(&mut self) {
        self.samples.clear();
    }

    /// The robot at the last image in its frame at `stamp`. None if the images do not cover the time.
    pub(super) fn since(&self, stamp: Stamp) -> Option<Tf<RobotFrame, RobotFrame>> {
        let (last, twist) = *self.samples.back()?;
        let future = last.seconds_until(stamp);
        if future >= 0.0 {
            return (future <= GAP_MAX).then(|| step(twist, -future as f32));
        }
        let mut motion = Tf::new(0.0, 0.0, 0.0);
        let mut after = (last, twist);
        for &(before, twist) in self.samples.iter().rev().skip(1) {
            let interval = before.seconds_until(after.0);
            let part = stamp.seconds_until(after.0).min(interval);
            // Velocity in the middle of the part.
            let share = (0.5 * part / interval.max(1e-9)) as f32;
            let mean = |a: f32, b: f32| a + share * (b - a);
            let velocity = Twist {
                x: mean(after.1.x, twist.x),
                y: mean(after.1.y, twist.y),
                theta: mean(after.1.theta, twist.theta),
            };
            motion = step(velocity, part as f32) * motion;
            if before <= stamp {
                return Some(motion);
            }
            after = (before, twist);
        }
        None
    }
}

/// Motion at constant velocity.
fn step(velocity: Twist, seconds: f32) -> Tf<RobotFrame, RobotFrame> {
    let angle = velocity.theta * seconds;
    let (sin, cos) = math::sin_cos(0.5 * angle);
    let (x, y) = (velocity.x * seconds, velocity.y * seconds);
    Tf::new(cos * x - sin * y, sin * x + cos * y, angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_on_a_circle_is_followed_back_and_ahead() {
        let mut motion = OwnMotion::default();
        let twist = Twist {
            x: 2.0,
            y: 0.0,
            theta: 1.0,
        };
        for k in 0..10 {
            motion.add(Stamp::from_seconds(f64::from(k) / 30.0), twist);
        }
        // 2 m/s at 1 rad/s is a circle of 2 m.
        for at in [0.05_f32, 0.17, 0.29, 0.35] {
            let angle = 0.3 - at;
            let found = motion
                .since(Stamp::from_seconds(f64::from(at)))
                .expect("covered");
            let expected = [2.0 * angle.sin(), 2.0 * (1.0 - angle.cos()), angle];
            let errors = [found.x, found.y, found.theta].map(f64::from);
            for (error, expected) in errors.into_iter().zip(expected) {
                assert!(
                    (error - f64::from(expected)).abs() < 1e-3,
                    "{at}: {found:?}"
                );
            }
        }
        assert_eq!(motion.since(Stamp::from_seconds(-0.1)), None);
        assert_eq!(motion.since(Stamp::from_seconds(0.6)), None);
    }
}
