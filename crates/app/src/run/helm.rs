//! Who drives, and is the command still good? The one way from a path, a program or a hand to the wheels.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use hw::base::{Drive, Kick};
use localize::{Pose, Stamp};

/// A pose older than this is none for whoever needs one to drive, seconds: four frames at 30 Hz.
const POSE_AGE_MAX: f64 = 0.15;
/// How long a command keeps lesser drivers from the wheels, seconds.
const HOLD: f64 = 0.5;

/// Who commands; a later one of this list takes over from an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Driver {
    /// A path of this program's own.
    Path,
    /// Another program.
    Program,
    /// A hand at keyboard or game pad.
    Hand,
}

/// Why a command was not taken.
#[derive(Debug, thiserror::Error)]
pub enum Refused {
    /// The robot has no base.
    #[error("this robot has no base")]
    NoBase,
    /// The base refused.
    #[error(transparent)]
    Base(#[from] hw::HwError),
    /// Another drives.
    #[error("{0:?} drives")]
    Taken(Driver),
    /// The command needs a pose and there is none, or an old one: the wheels stop.
    #[error("there is no fresh pose")]
    NoPose,
}

/// Where everyone who drives commands the robot; clones are the same.
#[derive(Clone, Default)]
pub struct Helm {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Default)]
struct Shared {
    base: Option<hw::Helm>,
    pose: Option<(Stamp, Pose)>,
    /// Who commanded last, and when.
    driver: Option<(Driver, Stamp)>,
    /// The last command is good only with a pose.
    needs_pose: bool,
}

impl Helm {
    /// A helm that commands nothing yet.
    pub fn new() -> Self {
        Helm::default()
    }

    /// From now on this base is commanded, if there is one.
    pub fn attach(&self, base: Option<hw::Helm>) {
        self.lock().base = base;
    }

    /// Drives until the deadline (CLOCK_MONOTONIC), or for as long as hardware.toml lets a command live if that is sooner.
    ///
    /// With `needs_pose` no command outlives the pose by more than 0.15 s, and the wheels stop as soon as there is none.
    pub fn drive(
        &self,
        driver: Driver,
        drive: Drive,
        deadline: Stamp,
        needs_pose: bool,
    ) -> Result<(), Refused> {
        let now = hw::now();
        let mut shared = self.lock();
        let base = shared.base.clone().ok_or(Refused::NoBase)?;
        shared.take(driver, now)?;
        shared.needs_pose = needs_pose;
        let mut deadline = deadline;
        if needs_pose {
            let pose_until = shared.pose.map(|(stamp, _)| stamp + POSE_AGE_MAX);
            let Some(until) = pose_until.filter(|until| *until > now) else {
                base.halt(Duration::ZERO);
                return Err(Refused::NoPose);
            };
            deadline = deadline.min(until);
        }
        Ok(base.drive(drive, deadline)?)
    }

    /// Kicks once, unless that cannot be done before the deadline.
    pub fn kick(&self, driver: Driver, kick: Kick, deadline: Stamp) -> Result<(), Refused> {
        Ok(self.taken(driver)?.kick(kick, deadline)?)
    }

    /// Turns the left and right dribbling wheel (rad/s, positive pulls the ball in) until the deadline.
    pub fn dribble(
        &self,
        driver: Driver,
        speeds: [f32; 2],
        deadline: Stamp,
    ) -> Result<(), Refused> {
        Ok(self.taken(driver)?.dribble(speeds, deadline)?)
    }

    /// The base, if this driver may command it now.
    fn taken(&self, driver: Driver) -> Result<hw::Helm, Refused> {
        let mut shared = self.lock();
        let base = shared.base.clone().ok_or(Refused::NoBase)?;
        shared.take(driver, hw::now())?;
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
    pub fn publish(&self, stamp: Stamp, pose: Option<Pose>) {
        let mut shared = self.lock();
        shared.pose = pose.map(|pose| (stamp, pose));
        let blind = pose.is_none() && std::mem::take(&mut shared.needs_pose);
        drop(shared);
        if blind {
            self.halt();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        // Plain values: true whatever happened to a thread that held them.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shared {
    fn take(&mut self, driver: Driver, now: Stamp) -> Result<(), Refused> {
        match self.driver {
            Some((other, since)) if other > driver && now - since < HOLD => {
                Err(Refused::Taken(other))
            }
            _ => {
                self.driver = Some((driver, now));
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_keeps_programs_from_the_wheels_until_it_lets_go() {
        let mut shared = Shared::default();
        let at = |seconds| Stamp::from_seconds(seconds);
        assert!(shared.take(Driver::Program, at(0.0)).is_ok());
        assert!(shared.take(Driver::Hand, at(0.1)).is_ok());
        assert!(matches!(
            shared.take(Driver::Program, at(0.5)),
            Err(Refused::Taken(Driver::Hand))
        ));
        assert!(shared.take(Driver::Program, at(0.61)).is_ok());
    }

    #[test]
    fn without_a_base_or_a_pose_nothing_drives() {
        let helm = Helm::new();
        let soon = hw::now() + 1.0;
        let refused = helm.drive(Driver::Hand, Drive::default(), soon, false);
        assert!(matches!(refused, Err(Refused::NoBase)));
        assert!(helm.close(Duration::ZERO));
    }
}
