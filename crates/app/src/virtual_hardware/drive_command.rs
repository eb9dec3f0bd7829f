//! Which drive command is active? A command is valid for its own time, and then the wheels stop.

use hw::config::COMMAND_VALIDITY_MAX;
use localize::Stamp;
use localize::omni::Twist;
use serde::Serialize;

/// Statistics of the received commands: was the robot ever driven without a fresh command?
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct CommandStats {
    /// Commands that turn a wheel.
    pub(super) driving: u64,
    /// Commands to stop.
    pub(super) standing: u64,
    /// Commands with a validity above the maximum: there must be none.
    pub(super) too_long: u64,
    /// Driving commands that came first after a reconnect: there must be none.
    pub(super) driven_at_once: u64,
    /// Driving commands that expired, upon which the base stopped the wheels.
    pub(super) ran_out: u64,
    /// Kicks.
    pub(super) kicks: u64,
    /// Time of the last driving command, CLOCK_MONOTONIC, seconds.
    pub(super) last_driving_s: f64,
    /// Time of the last command, CLOCK_MONOTONIC, seconds.
    pub(super) last_s: f64,
    /// The last command was to stop.
    pub(super) stands_last: bool,
}

/// A driving command until its end.
#[derive(Debug, Clone, Copy)]
struct ActiveCommand {
    twist: Twist,
    until: Stamp,
}

/// The active command, and statistics of all.
#[derive(Debug, Default)]
pub(super) struct DriveCommand {
    active: Option<ActiveCommand>,
    received_since_reconnect: bool,
    pub(super) stats: CommandStats,
}

impl DriveCommand {
    /// The port was unplugged or plugged in.
    pub(super) fn on_reconnect(&mut self) {
        self.received_since_reconnect = false;
    }

    /// Sets a command with its validity; `drives`: it turns a wheel.
    pub(super) fn set(&mut self, twist: Twist, drives: bool, valid_ms: u16, now: Stamp) {
        let stats = &mut self.stats;
        stats.last_s = now.seconds();
        stats.stands_last = !drives;
        stats.too_long += u64::from(f64::from(valid_ms) > COMMAND_VALIDITY_MAX * 1e3);
        if drives {
            stats.driving += 1;
            stats.last_driving_s = now.seconds();
            stats.driven_at_once += u64::from(!self.received_since_reconnect);
        } else {
            stats.standing += 1;
        }
        self.received_since_reconnect = true;
        let until = now + f64::from(valid_ms) * 1e-3;
        self.active = drives.then_some(ActiveCommand { twist, until });
    }

    /// Commanded velocity now: zero once the command has expired.
    pub(super) fn twist(&mut self, now: Stamp) -> Twist {
        match self.active {
            Some(command) if now < command.until => command.twist,
            Some(_) => {
                self.active = None;
                self.stats.ran_out += 1;
                Twist::default()
            }
            None => Twist::default(),
        }
    }

    /// True if no driving command is active.
    pub(super) fn is_expired(&self) -> bool {
        self.active.is_none()
    }
}
