//! Who drives, and is the command still good? The one way from a path, a program or a hand to the wheels.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use hw::base::{Kick, MotionCommand};
use localize::{Pose, Stamp};

/// A pose older than this is none for whoever needs one to drive, seconds: four frames at 30 Hz.
const POSE_AGE_MAX: f64 = 0.15;
/// How long a command keeps lesser drivers from the wheels, seconds.
const SOURCE_HOLD_TIME: f64 = 0.5;

/// Who commands; a later one of this list takes over from an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CommandSource {
    /// A path of this program's own.
    Path,
    /// Another program.
    Program,
    /// A hand at keyboard or game pad.
    Operator,
}

/// Why a command was not taken.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// The robot has no base.
    #[error("this robot has no base")]
    NoBase,
    /// The base refused.
    #[error(transparent)]
    Base(#[from] hw::HwError),
    /// Another drives.
    #[error("{0:?} drives")]
    Preempted(CommandSource),
    /// The command needs a pose and there is none, or an old one: the wheels stop.
    #[error("there is no fresh pose")]
    NoPose,
}

/// Where everyone who drives commands the robot; clones are the same.
#[derive(Clone, Default)]
pub struct CommandArbiter {
    state: Arc<Mutex<ArbiterState>>,
}

#[derive(Default)]
struct ArbiterState {
    base: Option<hw::BaseHandle>,
    pose: Option<(Stamp, Pose)>,
    /// Who commanded last, and when.
    active_source: Option<(CommandSource, Stamp)>,
    /// The last command is good only with a pose.
    needs_pose: bool,
}

impl CommandArbiter {
    /// A helm that commands nothing yet.
    pub fn new() -> Self {
        CommandArbiter::default()
    }

    /// From now on this base is commanded, if there is one.
    pub fn attach_base(&self, base: Option<hw::BaseHandle>) {
        self.lock().base = base;
    }

    /// Drives until the deadline (CLOCK_MONOTONIC), or for as long as hardware.toml lets a command live if that is sooner.
    ///
    /// With `needs_pose` no command outlives the pose by more than 0.15 s, and the wheels stop as soon as there is none.
    pub fn drive(
        &self,
        driver: CommandSource,
        drive: MotionCommand,
        deadline: Stamp,
        needs_pose: bool,
    ) -> Result<(), CommandError> {
        let now = hw::now();
        let mut shared = self.lock();
        let base = shared.base.clone().ok_or(CommandError::NoBase)?;
        shared.acquire(driver, now)?;
        shared.needs_pose = needs_pose;
        let mut deadline = deadline;
        if needs_pose {
            let pose_until = shared.pose.map(|(stamp, _)| stamp + POSE_AGE_MAX);
            let Some(until) = pose_until.filter(|until| *until > now) else {
                base.halt(Duration::ZERO);
                return Err(CommandError::NoPose);
            };
            deadline = deadline.min(until);
        }
        Ok(base.drive(drive, deadline)?)
    }

    /// Kicks once, unless that cannot be done before the deadline.
    pub fn kick(
        &self,
        driver: CommandSource,
        kick: Kick,
        deadline: Stamp,
    ) -> Result<(), CommandError> {
        Ok(self.acquire_base(driver)?.kick(kick, deadline)?)
    }

    /// Turns the left and right dribbling wheel (rad/s, positive pulls the ball in) until the deadline.
    pub fn dribble(
        &self,
        driver: CommandSource,
        speeds: [f32; 2],
        deadline: Stamp,
    ) -> Result<(), CommandError> {
        Ok(self.acquire_base(driver)?.dribble(speeds, deadline)?)
    }

    /// The base, if this driver may command it now.
    fn acquire_base(&self, driver: CommandSource) -> Result<hw::BaseHandle, CommandError> {
        let mut shared = self.lock();
        let base = shared.base.clone().ok_or(CommandError::NoBase)?;
        shared.acquire(driver, hw::now())?;
        Ok(base)
    }

    /// Stops the wheels now, whoever drives.
    pub fn halt(&self) {
        let base = self.lock().base.clone();
        if let Some(base) = base {
            base.halt(Duration::ZERO);
        }
    }

    /// Stops the wheels for good, waiting so long at most until the bus has been told; false if it was not.
    pub fn close(&self, patience: Duration) -> bool {
        let base = self.lock().base.clone();
        base.is_none_or(|base| base.close(patience))
    }

    /// The latest pose and its stamp.
    pub fn pose(&self) -> Option<(Stamp, Pose)> {
        self.lock().pose
    }

    /// The spine's word, once a cycle.
    pub fn set_pose(&self, stamp: Stamp, pose: Option<Pose>) {
        let mut shared = self.lock();
        shared.pose = pose.map(|pose| (stamp, pose));
        let blind = pose.is_none() && std::mem::take(&mut shared.needs_pose);
        drop(shared);
        if blind {
            self.halt();
        }
    }

    fn lock(&self) -> MutexGuard<'_, ArbiterState> {
        // Plain values: true whatever happened to a thread that held them.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ArbiterState {
    fn acquire(&mut self, driver: CommandSource, now: Stamp) -> Result<(), CommandError> {
        match self.active_source {
            Some((other, since)) if other > driver && now - since < SOURCE_HOLD_TIME => {
                Err(CommandError::Preempted(other))
            }
            _ => {
                self.active_source = Some((driver, now));
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operator_preempts_programs_until_hold_time_expires() {
        let mut shared = ArbiterState::default();
        let at = |seconds| Stamp::from_seconds(seconds);
        assert!(shared.acquire(CommandSource::Program, at(0.0)).is_ok());
        assert!(shared.acquire(CommandSource::Operator, at(0.1)).is_ok());
        assert!(matches!(
            shared.acquire(CommandSource::Program, at(0.5)),
            Err(CommandError::Preempted(CommandSource::Operator))
        ));
        assert!(shared.acquire(CommandSource::Program, at(0.61)).is_ok());
    }

    #[test]
    fn drive_without_a_base_is_rejected() {
        let helm = CommandArbiter::new();
        let soon = hw::now() + 1.0;
        let refused = helm.drive(
            CommandSource::Operator,
            MotionCommand::default(),
            soon,
            false,
        );
        assert!(matches!(refused, Err(CommandError::NoBase)));
        assert!(helm.close(Duration::ZERO));
    }
}
