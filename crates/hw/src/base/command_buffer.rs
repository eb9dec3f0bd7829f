//! What are the wheels to do now? The last command until its deadline, then stop: the command watchdog.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use localize::Stamp;
use localize::omni::Twist;

use super::command_tally::CommandTally;

/// How the robot is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotionCommand {
    /// Velocity, robot frame.
    Twist(Twist),
    /// Speed of each wheel, rad/s, in the order of robot.toml's wheels; a base of three wheels ignores the fourth.
    WheelSpeeds([f32; 4]),
}

/// Zero velocity.
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
    /// True for a lofted kick, false for one along the ground.
    pub lofted: bool,
}

/// A command with the time at which it expires.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Timed<T> {
    pub(crate) value: T,
    pub(crate) deadline: Stamp,
}

impl<T> Timed<T> {
    /// Seconds until the deadline.
    pub(crate) fn remaining(&self, now: Stamp) -> f64 {
        self.deadline - now
    }
}

/// What the wheels are to do at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum BaseRequest {
    /// Follow this command.
    Drive(Timed<MotionCommand>),
    /// Hold speed zero.
    Brake,
    /// Switch the motors' current off.
    Release,
}

/// The latest commands, each with its deadline.
#[derive(Debug, Clone, Default)]
pub(crate) struct CommandBuffer {
    drive: Option<Timed<MotionCommand>>,
    /// Counts the motion command when it is sent for the first time.
    drive_tally: Option<Arc<CommandTally>>,
    stopped_since: Option<Stamp>,
    kick: Option<Timed<Kick>>,
    kick_tally: Option<Arc<CommandTally>>,
    dribble: Option<Timed<[f32; 2]>>,
    /// True while a command has not been sent yet.
    pub(crate) pending: bool,
    /// Brake and release commands that the bus has carried so far.
    pub(crate) stops_sent: u64,
    /// The base reports a pressed emergency stop.
    pub(crate) emergency_stop: bool,
    /// True once the base accepts no more commands.
    pub(crate) closed: bool,
}

impl CommandBuffer {
    /// Replaces the motion command; `tally` counts it.
    pub(crate) fn set_drive(
        &mut self,
        value: MotionCommand,
        deadline: Stamp,
        tally: Option<Arc<CommandTally>>,
    ) {
        self.drive = Some(Timed { value, deadline });
        self.drive_tally = tally;
        self.stopped_since = None;
        self.pending = true;
    }

    /// Stops the robot and discards all commands.
    pub(crate) fn halt(&mut self, now: Stamp) {
        *self = CommandBuffer {
            stopped_since: self.drive.map(|_| now).or(self.stopped_since),
            stops_sent: self.stops_sent,
            emergency_stop: self.emergency_stop,
            closed: self.closed,
            pending: true,
            ..CommandBuffer::default()
        };
    }

    /// No motion is commanded: such a command does not wait.
    pub(crate) fn stops(&self) -> bool {
        self.drive.is_none()
    }

    /// Replaces the kick; `tally` counts it.
    pub(crate) fn set_kick(
        &mut self,
        value: Kick,
        deadline: Stamp,
        tally: Option<Arc<CommandTally>>,
    ) {
        self.kick = Some(Timed { value, deadline });
        self.kick_tally = tally;
        self.pending = true;
    }

    /// `value`: speeds of the left and right dribbling wheel, rad/s.
    pub(crate) fn set_dribble(&mut self, value: [f32; 2], deadline: Stamp) {
        self.dribble = Some(Timed { value, deadline });
        self.pending = true;
    }

    /// The request for now: the valid motion command, else brake for `brake_time` seconds, then release.
    pub(crate) fn current_request(&mut self, now: Stamp, brake_time: f32) -> BaseRequest {
        if let Some(drive) = self.drive {
            if drive.remaining(now) > 0.0 {
                return BaseRequest::Drive(drive);
            }
            self.drive = None;
            self.drive_tally = None;
            self.stopped_since = Some(now);
        }
        match self.stopped_since {
            Some(since) if now - since < f64::from(brake_time) => BaseRequest::Brake,
            _ => BaseRequest::Release,
        }
    }

    /// Takes the tally of a motion command that is sent for the first time.
    pub(crate) fn take_drive_tally(&mut self) -> Option<Arc<CommandTally>> {
        self.drive_tally.take()
    }

    /// Takes the tally of a kick.
    pub(crate) fn take_kick_tally(&mut self) -> Option<Arc<CommandTally>> {
        self.kick_tally.take()
    }

    /// Takes the kick, so that it is sent once; an expired one is discarded.
    pub(crate) fn take_kick(&mut self, now: Stamp) -> Option<Timed<Kick>> {
        self.kick.take().filter(|kick| kick.deadline > now)
    }

    /// Speeds of the left and right dribbling wheel, rad/s, while they are valid.
    pub(crate) fn current_dribble(&self, now: Stamp) -> Option<Timed<[f32; 2]>> {
        self.dribble.filter(|dribble| dribble.deadline > now)
    }
}

/// The command buffer between those who command and the base's thread.
#[derive(Debug, Default)]
pub(crate) struct SharedCommands {
    buffer: Mutex<CommandBuffer>,
    /// Notified when the bus has carried a brake or release command.
    pub(crate) stop_sent: Condvar,
}

impl SharedCommands {
    pub(crate) fn lock(&self) -> MutexGuard<'_, CommandBuffer> {
        self.buffer.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn stale_command_brakes_then_releases_the_wheels() {
        let mut buffer = CommandBuffer::default();
        let mut request = |milliseconds: i64, command: Option<(MotionCommand, i64)>| {
            if let Some((drive, deadline)) = command {
                buffer.set_drive(drive, Stamp(deadline * MS), None);
            }
            buffer.current_request(Stamp(milliseconds * MS), 0.5)
        };
        assert_eq!(request(0, None), BaseRequest::Release);
        let drive = MotionCommand::WheelSpeeds([1.0; 4]);
        let expected = Timed {
            value: drive,
            deadline: Stamp(100 * MS),
        };
        assert_eq!(
            request(50, Some((drive, 100))),
            BaseRequest::Drive(expected)
        );
        assert_eq!(expected.remaining(Stamp(50 * MS)), 0.05);
        assert_eq!(request(100, None), BaseRequest::Brake);
        assert_eq!(request(599, None), BaseRequest::Brake);
        assert_eq!(request(600, None), BaseRequest::Release);
        let renewed = request(700, Some((drive, 800)));
        assert!(matches!(renewed, BaseRequest::Drive(_)));
        buffer.halt(Stamp(710 * MS));
        let halted = buffer.current_request(Stamp(720 * MS), 0.5);
        assert_eq!(halted, BaseRequest::Brake);
    }

    #[test]
    fn kick_is_sent_once_and_never_after_its_deadline() {
        let mut buffer = CommandBuffer::default();
        let kick = Kick {
            speed: 8.0,
            lofted: false,
        };
        buffer.set_kick(kick, Stamp(50 * MS), None);
        let taken = buffer.take_kick(Stamp(30 * MS)).expect("a kick");
        assert_eq!((taken.value, taken.remaining(Stamp(30 * MS))), (kick, 0.02));
        assert_eq!(buffer.take_kick(Stamp(31 * MS)), None);
        buffer.set_kick(kick, Stamp(50 * MS), None);
        assert_eq!(buffer.take_kick(Stamp(60 * MS)), None);
    }
}
