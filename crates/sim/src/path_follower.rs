//! How does our robot drive? Along the scenario's path by its true pose, avoiding other robots.

use localize::frames::{Pose, wrap_angle};
use localize::omni::Twist;
use nalgebra::Vector2;

use crate::scenario::PathConfig;

/// Distance at which a waypoint counts as passed, metres.
const WAYPOINT_RADIUS: f32 = 0.25;
/// Planned deceleration, m/s².
const BRAKING: f32 = 1.5;
/// Distance between robots' centres below which ours evades, metres.
const AVOIDANCE_DISTANCE: f32 = 0.9;
/// Time after which an unreachable (occupied) waypoint is skipped, seconds.
const WAYPOINT_TIMEOUT: f32 = 12.0;

/// Follows a path.
#[derive(Debug, Clone)]
pub(crate) struct PathFollower {
    path: PathConfig,
    next: usize,
    waypoint_time: f32,
}

impl PathFollower {
    pub(crate) fn new(path: PathConfig) -> Self {
        PathFollower {
            path,
            next: 0,
            waypoint_time: 0.0,
        }
    }

    /// The commanded twist (robot frame) at a time and pose; `elapsed`: seconds since the last call.
    pub(crate) fn command(
        &mut self,
        time: f64,
        elapsed: f32,
        pose: Pose,
        others: impl Iterator<Item = Pose>,
    ) -> Twist {
        if self.path.waypoints.is_empty() {
            return self.scheduled_command(time);
        }
        let Some(mut target) = self.path.waypoints.get(self.next).map(|place| place.pose()) else {
            return Twist::default();
        };
        self.waypoint_time += elapsed;
        let last = self.next + 1 == self.path.waypoints.len() && !self.path.repeat;
        let reached = pose.origin().distance_to(target.origin()) < WAYPOINT_RADIUS;
        if (reached || self.waypoint_time > WAYPOINT_TIMEOUT) && !last {
            self.next = (self.next + 1) % self.path.waypoints.len();
            self.waypoint_time = 0.0;
            target = self.path.waypoints[self.next].pose();
        }
        let position = Vector2::new(pose.x, pose.y);
        let offset = Vector2::new(target.x, target.y) - position;
        let distance = offset.norm();
        // At a corner the robot keeps 40 % of its speed; at the end it stops.
        let slowest = if last { 0.0 } else { self.path.speed * 0.4 };
        let speed = (2.0 * BRAKING * distance)
            .sqrt()
            .min(self.path.speed)
            .max(slowest.min(distance * 2.0));
        let mut velocity = if distance > 1e-3 {
            offset / distance * speed
        } else {
            offset
        };
        for other in others {
            let away = position - Vector2::new(other.x, other.y);
            let near = away.norm();
            if near < AVOIDANCE_DISTANCE && near > 1e-3 {
                let side = Vector2::new(-away.y, away.x);
                velocity += (away + side * 0.7) / near * (AVOIDANCE_DISTANCE - near)
                    / AVOIDANCE_DISTANCE
                    * self.path.speed
                    * 2.0;
            }
        }
        let velocity = velocity.cap_magnitude(self.path.speed);
        let (sin, cos) = pose.theta.sin_cos();
        let turn_rate = self.path.turn_rate_deg.to_radians();
        Twist {
            x: cos * velocity.x + sin * velocity.y,
            y: -sin * velocity.x + cos * velocity.y,
            theta: (wrap_angle(target.theta - pose.theta) * 2.0).clamp(-turn_rate, turn_rate),
        }
    }

    fn scheduled_command(&self, time: f64) -> Twist {
        let latest = self
            .path
            .commands
            .iter()
            .rev()
            .find(|command| command.time <= time);
        latest.map_or(Twist::default(), |command| Twist {
            x: command.vx,
            y: command.vy,
            theta: command.turn_deg.to_radians(),
        })
    }
}
