//! What are the wheels to do now? The last command while it is fresh, else stop: the watchdog.

use localize::Stamp;
use localize::omni::Twist;

/// How the robot is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotionCommand {
    /// By its velocity, robot frame.
    Twist(Twist),
    /// By the speed of each wheel, rad/s, in the order of robot.toml's wheels; a fourth that is not there is ignored.
    WheelSpeeds([f32; 4]),
}

/// Standing still.
impl Default for MotionCommand {
    fn default() -> Self {
        MotionCommand::Twist(Twist::default())
    }
}

/// A kick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kick {
    /// Speed of the ball, m/s.
    pub speed: f32,
    /// Lofted, or along the ground.
    pub lofted: bool,
}

/// What the bus is to tell the wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum BaseRequest {
    /// Drive like this; the command holds for so many seconds more.
    Drive(MotionCommand, f64),
    /// Stand: speed zero, held.
    Brake,
    /// Let go: no current.
    Release,
}

/// The commands of those who drive, and whether they still count.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CommandBuffer {
    drive: Option<(MotionCommand, Stamp)>,
    stopped_since: Option<Stamp>,
    kick: Option<(Kick, Stamp)>,
    dribble: Option<([f32; 2], Stamp)>,
    /// True after a command that the bus has not been told.
    pub(crate) pending: bool,
    /// Orders to brake or release that went out.
    pub(crate) stops_sent: u64,
    /// No command is taken any more.
    pub(crate) closed: bool,
}

impl CommandBuffer {
    /// Drive like this until the deadline.
    pub(crate) fn set_drive(&mut self, drive: MotionCommand, deadline: Stamp) {
        self.drive = Some((drive, deadline));
        self.stopped_since = None;
        self.pending = true;
    }

    /// Stop, whatever was commanded.
    pub(crate) fn halt(&mut self, now: Stamp) {
        *self = CommandBuffer {
            stopped_since: self.drive.map(|_| now).or(self.stopped_since),
            stops_sent: self.stops_sent,
            closed: self.closed,
            pending: true,
            ..CommandBuffer::default()
        };
    }

    pub(crate) fn set_kick(&mut self, kick: Kick, deadline: Stamp) {
        self.kick = Some((kick, deadline));
        self.pending = true;
    }

    pub(crate) fn set_dribble(&mut self, speeds: [f32; 2], deadline: Stamp) {
        self.dribble = Some((speeds, deadline));
        self.pending = true;
    }

    /// What the wheels are to do; stopped ones are braked for `brake_time` seconds, then let go.
    pub(crate) fn current_request(&mut self, now: Stamp, brake_time: f32) -> BaseRequest {
        if let Some((drive, deadline)) = self.drive {
            let left = deadline - now;
            if left > 0.0 {
                return BaseRequest::Drive(drive, left);
            }
            self.drive = None;
            self.stopped_since = Some(now);
        }
        match self.stopped_since {
            Some(since) if now - since < f64::from(brake_time) => BaseRequest::Brake,
            _ => BaseRequest::Release,
        }
    }

    /// The kick that is wanted, once; one whose time has passed is forgotten.
    pub(crate) fn take_kick(&mut self, now: Stamp) -> Option<(Kick, f64)> {
        let (kick, deadline) = self.kick.take()?;
        (deadline > now).then_some((kick, deadline - now))
    }

    /// Speeds of the left and right dribbling wheel, rad/s, while they are wanted.
    pub(crate) fn current_dribble(&self, now: Stamp) -> Option<([f32; 2], f64)> {
        let (speeds, deadline) = self.dribble?;
        (deadline > now).then_some((speeds, deadline - now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn stale_command_brakes_then_releases_the_wheels() {
        let mut orders = CommandBuffer::default();
        assert_eq!(orders.current_request(Stamp(0), 0.5), BaseRequest::Release);
        let drive = MotionCommand::WheelSpeeds([1.0; 4]);
        orders.set_drive(drive, Stamp(100 * MS));
        assert_eq!(
            orders.current_request(Stamp(50 * MS), 0.5),
            BaseRequest::Drive(drive, 0.05)
        );
        assert_eq!(
            orders.current_request(Stamp(100 * MS), 0.5),
            BaseRequest::Brake
        );
        assert_eq!(
            orders.current_request(Stamp(599 * MS), 0.5),
            BaseRequest::Brake
        );
        assert_eq!(
            orders.current_request(Stamp(600 * MS), 0.5),
            BaseRequest::Release
        );
        orders.set_drive(drive, Stamp(800 * MS));
        assert!(matches!(
            orders.current_request(Stamp(700 * MS), 0.5),
            BaseRequest::Drive(..)
        ));
        orders.halt(Stamp(710 * MS));
        assert_eq!(
            orders.current_request(Stamp(720 * MS), 0.5),
            BaseRequest::Brake
        );
    }

    #[test]
    fn kick_is_sent_once_and_never_after_its_deadline() {
        let mut orders = CommandBuffer::default();
        let kick = Kick {
            speed: 8.0,
            lofted: false,
        };
        orders.set_kick(kick, Stamp(50 * MS));
        assert_eq!(orders.take_kick(Stamp(30 * MS)), Some((kick, 0.02)));
        assert_eq!(orders.take_kick(Stamp(31 * MS)), None);
        orders.set_kick(kick, Stamp(50 * MS));
        assert_eq!(orders.take_kick(Stamp(60 * MS)), None);
    }
}
