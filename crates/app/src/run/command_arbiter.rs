//! Who commands the base, and is the command still valid? All commands to the base pass through the arbiter.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use hw::base::{CommandTally, Kick, MotionCommand};
use localize::{Pose, Stamp};

/// Maximum age of a pose for commands that need one, seconds: four images at 30 Hz.
const POSE_AGE_MAX: f64 = 0.15;
/// Time for which a command blocks sources of lower priority, seconds.
const SOURCE_HOLD_TIME: f64 = 0.5;

/// Source of a command, in order of increasing priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum CommandSource {
    /// A patrol of this program.
    Path,
    /// Another program (UDP).
    Program,
    /// A person with keyboard or game pad.
    Operator,
}

/// Why a command was rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CommandError {
    /// The robot has no base.
    #[error("no base. Add [base] to hardware.toml")]
    NoBase,
    /// The base driver rejected the command.
    #[error(transparent)]
    Base(#[from] hw::HwError),
    /// A source of higher priority commands the base.
    #[error("command preempted by source {0:?}")]
    Preempted(CommandSource),
    /// The command needs a pose, and there is none or an old one. The wheels stop.
    #[error("no pose newer than {POSE_AGE_MAX} s")]
    NoPose,
}

/// Passes commands of all sources to the base. Clones share the same state.
#[derive(Clone, Default)]
pub(crate) struct CommandArbiter {
    state: Arc<Mutex<ArbiterState>>,
    /// Counts the commands of other programs.
    program_tally: Arc<CommandTally>,
}

#[derive(Default)]
struct ArbiterState {
    base: Option<hw::BaseHandle>,
    pose: Option<StampedPose>,
    active_source: Option<ActiveSource>,
    /// A person has stopped the robot: programs and paths wait until they are released.
    stopped_by_hand: bool,
    /// The last command is valid only with a pose.
    needs_pose: bool,
}

/// The source of the last command.
struct ActiveSource {
    source: CommandSource,
    stamp: Stamp,
}

/// A pose and its time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StampedPose {
    /// CLOCK_MONOTONIC.
    pub stamp: Stamp,
    /// On the field.
    pub pose: Pose,
}

impl CommandArbiter {
    /// An arbiter without a base.
    pub(crate) fn new() -> Self {
        CommandArbiter::default()
    }

    /// Sets the base that receives the commands.
    pub(crate) fn attach_base(&self, base: Option<hw::BaseHandle>) {
        self.lock().base = base;
    }

    /// What the base took of the commands of other programs.
    pub(crate) fn program_tally(&self) -> &CommandTally {
        &self.program_tally
    }

    /// Drives until the deadline (CLOCK_MONOTONIC) or the maximum command age of hardware.toml, whichever is earlier.
    ///
    /// With `needs_pose` the command ends 0.15 s after the last pose, and the wheels stop as soon as the pose is lost.
    pub(crate) fn drive(
        &self,
        source: CommandSource,
        motion: MotionCommand,
        deadline: Stamp,
        needs_pose: bool,
    ) -> Result<(), CommandError> {
        let now = hw::now();
        let mut state = self.lock();
        let base = state.base.clone().ok_or(CommandError::NoBase)?;
        state.acquire(source, now)?;
        state.needs_pose = needs_pose;
        let mut deadline = deadline;
        if needs_pose {
            let pose_until = state.pose.map(|pose| pose.stamp + POSE_AGE_MAX);
            let Some(until) = pose_until.filter(|until| *until > now) else {
                base.halt(Duration::ZERO);
                return Err(CommandError::NoPose);
            };
            deadline = deadline.min(until);
        }
        Ok(self.counted(base, source).drive(motion, deadline)?)
    }

    /// Kicks once, if that is possible before the deadline.
    pub(crate) fn kick(
        &self,
        source: CommandSource,
        kick: Kick,
        deadline: Stamp,
    ) -> Result<(), CommandError> {
        let base = self.acquire_base(source)?;
        Ok(self.counted(base, source).kick(kick, deadline)?)
    }

    /// The base with the counts of a source.
    fn counted(&self, base: hw::BaseHandle, source: CommandSource) -> hw::BaseHandle {
        match source {
            CommandSource::Program => base.counting(&self.program_tally),
            CommandSource::Path | CommandSource::Operator => base,
        }
    }

    /// The base, if this source may command it now.
    fn acquire_base(&self, source: CommandSource) -> Result<hw::BaseHandle, CommandError> {
        let mut state = self.lock();
        let base = state.base.clone().ok_or(CommandError::NoBase)?;
        state.acquire(source, hw::now())?;
        Ok(base)
    }

    /// Stops the wheels now, whatever the active source.
    pub(crate) fn halt(&self) {
        let base = self.lock().base.clone();
        if let Some(base) = base {
            base.halt(Duration::ZERO);
        }
    }

    /// A person stops the wheels. Commands of other sources are rejected until [`CommandArbiter::release`]. False if they were before.
    pub(crate) fn stop_by_hand(&self) -> bool {
        let is_new = !std::mem::replace(&mut self.lock().stopped_by_hand, true);
        self.halt();
        is_new
    }

    /// Ends a stop by hand: the sources command by their priorities again. False if there was none.
    pub(crate) fn release(&self) -> bool {
        std::mem::take(&mut self.lock().stopped_by_hand)
    }

    /// Why commands of programs have no effect now. None if they have.
    pub(crate) fn obstacle_to_programs(&self) -> Option<String> {
        let state = self.lock();
        if state.stopped_by_hand {
            return Some("a person has stopped the robot".to_owned());
        }
        let now = hw::now();
        if state.preemption(CommandSource::Program, now).is_some() {
            return Some("a person drives the robot".to_owned());
        }
        let base = state.base.clone();
        drop(state);
        match base {
            Some(base) => base.obstacle(),
            None => Some(CommandError::NoBase.to_string()),
        }
    }

    /// Stops the wheels for good and waits up to `timeout` until the bus has the command. False if it failed.
    pub(crate) fn close(&self, timeout: Duration) -> bool {
        let base = self.lock().base.clone();
        base.is_none_or(|base| base.close(timeout))
    }

    /// The latest pose.
    pub(crate) fn pose(&self) -> Option<StampedPose> {
        self.lock().pose
    }

    /// Sets the estimated pose, once per cycle. Stops the wheels if the pose is lost and the command needs it.
    pub(crate) fn set_pose(&self, stamp: Stamp, pose: Option<Pose>) {
        let mut state = self.lock();
        state.pose = pose.map(|pose| StampedPose { stamp, pose });
        let pose_lost = pose.is_none() && std::mem::take(&mut state.needs_pose);
        drop(state);
        if pose_lost {
            self.halt();
        }
    }

    fn lock(&self) -> MutexGuard<'_, ArbiterState> {
        // Plain values: valid even if a thread panicked with the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ArbiterState {
    fn acquire(&mut self, source: CommandSource, now: Stamp) -> Result<(), CommandError> {
        if let Some(preempting) = self.preemption(source, now) {
            return Err(CommandError::Preempted(preempting));
        }
        self.active_source = Some(ActiveSource { source, stamp: now });
        Ok(())
    }

    /// The source of higher priority that keeps `source` from commanding.
    fn preemption(&self, source: CommandSource, now: Stamp) -> Option<CommandSource> {
        if self.stopped_by_hand && source < CommandSource::Operator {
            return Some(CommandSource::Operator);
        }
        let active = self.active_source.as_ref()?;
        let holds = active.source > source && now - active.stamp < SOURCE_HOLD_TIME;
        holds.then_some(active.source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operator_preempts_programs_until_hold_time_expires() {
        let mut state = ArbiterState::default();
        let at = |seconds| Stamp::from_seconds(seconds);
        assert!(state.acquire(CommandSource::Program, at(0.0)).is_ok());
        assert!(state.acquire(CommandSource::Operator, at(0.1)).is_ok());
        assert!(matches!(
            state.acquire(CommandSource::Program, at(0.5)),
            Err(CommandError::Preempted(CommandSource::Operator))
        ));
        assert!(state.acquire(CommandSource::Program, at(0.61)).is_ok());
    }

    #[test]
    fn stop_by_hand_blocks_programs_until_they_are_released_and_is_named() {
        let arbiter = CommandArbiter::new();
        assert!(arbiter.stop_by_hand() && !arbiter.stop_by_hand());
        let at = |seconds| Stamp::from_seconds(seconds);
        let acquire = |source, stamp| arbiter.lock().acquire(source, stamp);
        for source in [CommandSource::Path, CommandSource::Program] {
            assert!(acquire(source, at(1000.0)).is_err());
        }
        // Keys drive meanwhile, and do not end it.
        assert!(acquire(CommandSource::Operator, at(1000.0)).is_ok());
        assert!(acquire(CommandSource::Program, at(2000.0)).is_err());
        let obstacle = arbiter.obstacle_to_programs().expect("an obstacle");
        assert!(obstacle.contains("stopped"), "{obstacle}");
        assert!(arbiter.release() && !arbiter.release());
        assert!(acquire(CommandSource::Program, at(2000.0)).is_ok());
        let obstacle = arbiter.obstacle_to_programs().expect("an obstacle");
        assert!(obstacle.contains("no base"), "{obstacle}");
    }

    #[test]
    fn drive_without_a_base_is_rejected() {
        let arbiter = CommandArbiter::new();
        let soon = hw::now() + 1.0;
        let result = arbiter.drive(
            CommandSource::Operator,
            MotionCommand::default(),
            soon,
            false,
        );
        assert!(matches!(result, Err(CommandError::NoBase)));
        assert!(arbiter.close(Duration::ZERO));
    }
}
