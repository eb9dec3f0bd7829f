//! Where should our robot go now? Along the scenario's path, from where it truly is, around who is in the way.

use localize::frames::{Pose, wrap_angle};
use localize::omni::Twist;
use nalgebra::Vector2;

use crate::scenario::PathConfig;

/// A waypoint counts as passed at this distance, metres.
const WAYPOINT_RADIUS: f32 = 0.25;
/// Braking is planned with this deceleration, m/s².
const BRAKING: f32 = 1.5;
/// Distance from another robot's centre below which ours turns aside, metres.
const AVOIDANCE_DISTANCE: f32 = 0.9;
/// A waypoint that cannot be reached (somebody stands on it) is left out after so long, seconds.
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

    /// The wanted twist (robot frame) at a time and pose; `elapsed` seconds after the last call.
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
        let here = Vector2::new(pose.x, pose.y);
        let way = Vector2::new(target.x, target.y) - here;
        let distance = way.norm();
        // Slow down before corners no more than lets the robot turn in; before the end, to a stop.
        let slowest = if last { 0.0 } else { self.path.speed * 0.4 };
        let speed = (2.0 * BRAKING * distance)
            .sqrt()
            .min(self.path.speed)
            .max(slowest.min(distance * 2.0));
        let mut wanted = if distance > 1e-3 {
            way / distance * speed
        } else {
            way
        };
        for other in others {
            let away = here - Vector2::new(other.x, other.y);
            let near = away.norm();
            if near < AVOIDANCE_DISTANCE && near > 1e-3 {
                let side = Vector2::new(-away.y, away.x);
                wanted += (away + side * 0.7) / near * (AVOIDANCE_DISTANCE - near)
                    / AVOIDANCE_DISTANCE
                    * self.path.speed
                    * 2.0;
            }
        }
        let wanted = wanted.cap_magnitude(self.path.speed);
        let (sin, cos) = pose.theta.sin_cos();
        let turn_rate = self.path.turn_rate_deg.to_radians();
        Twist {
            x: cos * wanted.x + sin * wanted.y,
            y: -sin * wanted.x + cos * wanted.y,
            theta: (wrap_angle(target.theta - pose.theta) * 2.0).clamp(-turn_rate, turn_rate),
        }
    }

    fn scheduled_command(&self, time: f64) -> Twist {
        let past = self
            .path
            .commands
            .iter()
            .rev()
            .find(|command| command.time <= time);
        past.map_or(Twist::default(), |command| Twist {
            x: command.vx,
            y: command.vy,
            theta: command.turn_deg.to_radians(),
        })
    }
}
