//! How does the robot follow waypoints? It steers by the estimated pose and stops without one.

use std::path::Path;
use std::time::Duration;

use anyhow::{Result, ensure};
use hw::base::MotionCommand;
use localize::Pose;
use localize::frames::wrap_angle;
use localize::omni::Twist;
use localize::toml_file;
use serde::Deserialize;

use super::command_arbiter::{CommandArbiter, CommandSource, StampedPose};
use super::stop_flag::StopFlag;

/// Validity of a command, seconds: two of them may be lost.
const COMMAND_VALIDITY: f64 = 0.06;
/// Time between commands.
const PERIOD: Duration = Duration::from_millis(20);
/// Deceleration before a waypoint, m/s².
const DECELERATION: f32 = 1.0;
/// Gain of the heading controller, 1/s.
const HEADING_GAIN: f32 = 2.0;

/// A patrol file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Patrol {
    /// Waypoints to pass in a loop.
    waypoints: Vec<Waypoint>,
    /// Maximum speed, m/s.
    #[serde(default = "default_speed")]
    speed: f32,
    /// Maximum yaw rate, degrees/s.
    #[serde(default = "default_turn_rate_deg")]
    turn_rate_deg: f32,
    /// A waypoint counts as passed at this distance, metres.
    #[serde(default = "default_passed")]
    passed: f32,
}

fn default_speed() -> f32 {
    0.5
}
fn default_turn_rate_deg() -> f32 {
    60.0
}
fn default_passed() -> f32 {
    0.25
}

/// A position and the heading at which to pass it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Waypoint {
    /// Metres.
    x: f32,
    /// Metres.
    y: f32,
    /// Degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    theta_deg: f32,
}

impl Patrol {
    /// Reads a patrol file.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let (patrol, _): (Patrol, _) = toml_file::read(path)?;
        ensure!(
            !patrol.waypoints.is_empty(),
            "{}: empty waypoints (expected at least one)",
            path.display()
        );
        for (key, value) in [
            ("speed", patrol.speed),
            ("turn_rate_deg", patrol.turn_rate_deg),
            ("passed", patrol.passed),
        ] {
            ensure!(
                value > 0.0 && value.is_finite(),
                "{}: invalid {key}: {value} (expected above 0)",
                path.display()
            );
        }
        Ok(patrol)
    }

    /// Drives until `stop` is raised.
    pub(crate) fn drive(&self, arbiter: &CommandArbiter, stop: &StopFlag) {
        let mut next = 0;
        while !stop.is_raised() {
            if let Some(StampedPose { pose, .. }) = arbiter.pose() {
                let twist = self.velocity_command(&mut next, pose);
                let deadline = hw::now() + COMMAND_VALIDITY;
                // After a rejection the next command tries again.
                let _rejected = arbiter.drive(
                    CommandSource::Path,
                    MotionCommand::Twist(twist),
                    deadline,
                    true,
                );
            }
            std::thread::sleep(PERIOD);
        }
    }

    /// The velocity towards the next waypoint.
    fn velocity_command(&self, next: &mut usize, pose: Pose) -> Twist {
        let mut target = self.waypoints[*next];
        let offset_to = |target: Waypoint| (target.x - pose.x, target.y - pose.y);
        let (x, y) = offset_to(target);
        if x.hypot(y) < self.passed {
            *next = (*next + 1) % self.waypoints.len();
            target = self.waypoints[*next];
        }
        let (x, y) = offset_to(target);
        let distance = x.hypot(y);
        let speed = (2.0 * DECELERATION * distance).sqrt().min(self.speed);
        let share = if distance > 0.0 {
            speed / distance
        } else {
            0.0
        };
        let (sin, cos) = pose.theta.sin_cos();
        let yaw_rate_max = self.turn_rate_deg.to_radians();
        let yaw_rate = wrap_angle(target.theta_deg.to_radians() - pose.theta) * HEADING_GAIN;
        Twist {
            x: share * (cos * x + sin * y),
            y: share * (cos * y - sin * x),
            theta: yaw_rate.clamp(-yaw_rate_max, yaw_rate_max),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patrol(text: &str) -> Result<Patrol> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("patrol.toml");
        std::fs::write(&path, text)?;
        Patrol::load(&path)
    }

    #[test]
    fn ideal_robot_passes_all_waypoints() {
        let patrol = patrol(
            "speed = 1.0\nwaypoints = [{ x = 2.0, y = 0.0 }, { x = 0.0, y = 1.0, theta_deg = 90.0 }]",
        )
        .expect("a patrol");
        let (mut pose, mut next, mut passed) = (Pose::new(0.0, 0.0, 1.0), 0, 0);
        for _ in 0..1000 {
            let before = next;
            let twist = patrol.velocity_command(&mut next, pose);
            passed += usize::from(before != next);
            assert!(twist.x.hypot(twist.y) < 1.0 + 1e-5);
            let (sin, cos) = pose.theta.sin_cos();
            pose = Pose::new(
                pose.x + 0.02 * (cos * twist.x - sin * twist.y),
                pose.y + 0.02 * (sin * twist.x + cos * twist.y),
                pose.theta + 0.02 * twist.theta,
            );
        }
        assert!(passed >= 6, "{passed}");
    }

    #[test]
    fn empty_path_or_non_finite_speed_is_rejected() {
        for text in [
            "waypoints = []",
            "speed = nan\nwaypoints = [{ x = 0.0, y = 0.0 }]",
        ] {
            let error = patrol(text).expect_err("rejected");
            assert!(format!("{error:#}").contains("patrol.toml"), "{error:#}");
        }
    }
}
