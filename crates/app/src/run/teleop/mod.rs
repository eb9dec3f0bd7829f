//! How does a hand drive the robot? By keys of the terminal or a game pad, and never longer than the hand is on them.

mod gamepads;
mod keyboard;

use std::os::fd::AsFd;

use anyhow::Result;
use hw::base::{Kick, MotionCommand};
use localize::omni::Twist;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::command_arbiter::{CommandArbiter, CommandSource};
use super::stop_flag::StopFlag;
use gamepads::Gamepads;
use keyboard::{KeyAction, KeyboardState, RawTerminal};

/// Commands are good for so long, seconds.
const COMMAND_VALIDITY: f64 = 0.08;
/// Time between commands, nanoseconds.
const PERIOD_NS: i64 = 20_000_000;
/// Rate of turn over speed, rad/s per m/s: a robot that drives fast may turn fast.
const YAW_RATE_PER_SPEED: f32 = 2.0;
/// Speed of a kicked ball, m/s.
const KICK_SPEED: f32 = 6.0;

/// What the keys are, for whoever starts.
pub const HELP: &str = "drive: w a s d, turn: q e, slower and faster: - +, kick: k, stop: space, end: x or Ctrl-C\n\
     game pad: hold a shoulder button; left stick drives, right stick turns, first button kicks";

/// Drives by hand until the end is asked for.
pub fn drive(helm: &CommandArbiter, stop: &StopFlag) -> Result<()> {
    let keys = RawTerminal::open()?;
    let keys = keys.as_ref();
    let mut pads = Gamepads::default();
    let mut hand = KeyboardState::new();
    while !stop.is_raised() {
        pads.scan();
        let mut fds: Vec<_> = keys.iter().map(|keys| keys.fd.as_fd()).collect();
        fds.extend(pads.pads.iter().map(|pad| pad.fd.as_fd()));
        let mut fds: Vec<_> = fds
            .into_iter()
            .map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN))
            .collect();
        let period = Timespec {
            tv_sec: 0,
            tv_nsec: PERIOD_NS,
        };
        // An interrupted wait is a short one.
        let _interrupted = poll(&mut fds, Some(&period));
        drop(fds);
        let now = hw::now();
        for key in keys.iter().flat_map(|keys| keys.read_keys()) {
            match hand.handle_key(key, now) {
                Some(KeyAction::Quit) => stop.raise(),
                Some(KeyAction::Kick) => kick(helm),
                None => {}
            }
        }
        pads.read();
        if pads.take_kick() {
            kick(helm);
        }
        let twist = pads.twist(hand.speed).or_else(|| hand.twist(now));
        match twist {
            Some(twist) => {
                // A base that is not there now may be there for the next command.
                let _refused = helm.drive(
                    CommandSource::Operator,
                    MotionCommand::Twist(twist),
                    now + COMMAND_VALIDITY,
                    false,
                );
                hand.was_driving = true;
            }
            None if std::mem::take(&mut hand.was_driving) => helm.halt(),
            None => {}
        }
    }
    Ok(())
}

fn kick(helm: &CommandArbiter) {
    let kick = Kick {
        speed: KICK_SPEED,
        lofted: false,
    };
    let _refused = helm.kick(CommandSource::Operator, kick, hw::now() + COMMAND_VALIDITY);
}

fn twist_from_axes([x, y, turn]: [f32; 3], speed: f32) -> Twist {
    Twist {
        x: x * speed,
        y: y * speed,
        theta: turn * speed * YAW_RATE_PER_SPEED,
    }
}
