//! What was the base told, and what do its wheels do now? A command holds for as long as it says, and then the wheels stop.

use localize::Stamp;
use localize::omni::Twist;
use serde::Serialize;

/// What the base was told, for whoever wants to know whether the robot was ever driven without a fresh command.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct CommandStats {
    /// Commands that turn a wheel.
    pub(super) driving: u64,
    /// Commands to stand.
    pub(super) standing: u64,
    /// Commands that wanted to hold for more than 100 ms: there must be none.
    pub(super) too_long: u64,
    /// Driving commands that came first after the line was opened anew: there must be none.
    pub(super) driven_at_once: u64,
    /// Times that a driving command ran out and the base stopped the wheels by itself.
    pub(super) ran_out: u64,
    /// Kicks.
    pub(super) kicks: u64,
    /// When the last driving command came, CLOCK_MONOTONIC, seconds.
    pub(super) last_driving_s: f64,
    /// When the last command came, CLOCK_MONOTONIC, seconds.
    pub(super) last_s: f64,
    /// The last command was to stand.
    pub(super) stands_last: bool,
}

/// The command that holds, and the account of all.
#[derive(Debug, Default)]
pub(super) struct DriveCommand {
    /// What is commanded, and until when it holds.
    active: Option<(Twist, Stamp)>,
    received_since_reconnect: bool,
    pub(super) stats: CommandStats,
}

impl DriveCommand {
    /// The line was pulled out or put in.
    pub(super) fn on_reconnect(&mut self) {
        self.received_since_reconnect = false;
    }

    /// Takes a command that wants to hold for so long; `drives`: it turns a wheel.
    pub(super) fn set(&mut self, twist: Twist, drives: bool, valid_ms: u16, now: Stamp) {
        let audit = &mut self.stats;
        audit.last_s = now.seconds();
        audit.stands_last = !drives;
        audit.too_long += u64::from(valid_ms > 100);
        if drives {
            audit.driving += 1;
            audit.last_driving_s = now.seconds();
            audit.driven_at_once += u64::from(!self.received_since_reconnect);
        } else {
            audit.standing += 1;
        }
        self.received_since_reconnect = true;
        let until = now + f64::from(valid_ms) * 1e-3;
        self.active = drives.then_some((twist, until));
    }

    /// What the wheels are to do now: nothing once the command has run out.
    pub(super) fn twist(&mut self, now: Stamp) -> Twist {
        match self.active {
            Some((twist, until)) if now < until => twist,
            Some(_) => {
                self.active = None;
                self.stats.ran_out += 1;
                Twist::default()
            }
            None => Twist::default(),
        }
    }

    /// The wheels stand for want of a command.
    pub(super) fn is_expired(&self) -> bool {
        self.active.is_none()
    }
}
