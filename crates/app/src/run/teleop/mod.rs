//! How does a person drive the robot? By keyboard or game pad, only while a key or button is held.

mod axes;
mod gamepads;
mod key_sequences;
mod keyboard;

use std::os::fd::AsFd;

use anyhow::Result;
use hw::base::{Kick, MotionCommand};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::command_arbiter::{CommandArbiter, CommandSource};
use super::stop_flag::StopFlag;
use gamepads::Gamepads;
use key_sequences::KeyDecoder;
use keyboard::{KeyAction, KeyboardState, RawTerminal};

/// Validity of a command, seconds.
const COMMAND_VALIDITY: f64 = 0.08;
/// Time between commands, nanoseconds.
const PERIOD_NS: i64 = 20_000_000;
/// A thread that did not run for longer was stopped, seconds.
const PAUSE_MIN: f64 = 0.25;
/// Speed of a kicked ball, m/s.
const KICK_SPEED: f32 = 6.0;

/// Help text printed at the start.
pub(crate) const HELP: &str = "drive: w a s d or arrows, turn: q e, slower and faster: - +, kick: k, end: x or Ctrl-C\n\
     stop: space; then no program drives until r is pressed\n\
     game pad: hold a shoulder button; left stick drives, right stick turns, first button kicks";

/// Said without a terminal: keys come from it, not from standard input.
const NO_KEYBOARD: &str =
    "no keyboard: the program has no terminal. Start it in one, or use a game pad";

/// Drives by hand until `stop` is raised.
pub(crate) fn drive(arbiter: &CommandArbiter, stop: &StopFlag) -> Result<()> {
    let terminal = RawTerminal::open()?;
    if terminal.is_none() {
        stderr_line!("{NO_KEYBOARD}");
    }
    let terminal = terminal.as_ref();
    let mut pads = Gamepads::default();
    let mut keyboard = KeyboardState::new();
    let mut decoder = KeyDecoder::default();
    let mut last_run = hw::now();
    while !stop.is_raised() {
        pads.scan();
        let mut fds: Vec<_> = terminal
            .iter()
            .map(|terminal| terminal.fd.as_fd())
            .collect();
        fds.extend(pads.pads.iter().map(|pad| pad.fd.as_fd()));
        let mut fds: Vec<_> = fds
            .into_iter()
            .map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN))
            .collect();
        let period = Timespec {
            tv_sec: 0,
            tv_nsec: PERIOD_NS,
        };
        // An interrupted wait is shorter, which does no harm.
        let _interrupted = poll(&mut fds, Some(&period));
        drop(fds);
        let now = hw::now();
        if now - std::mem::replace(&mut last_run, now) > PAUSE_MIN {
            // Keys that were pressed while this program was stopped are too old to drive or kick.
            terminal.iter().for_each(|terminal| terminal.discard_keys());
            pads.read();
            pads.take_kick();
            continue;
        }
        let bytes = terminal.iter().flat_map(|terminal| terminal.read_keys());
        for key in bytes.filter_map(|byte| decoder.decode(byte, now)) {
            match keyboard.handle_key(key, now) {
                Some(KeyAction::Quit) => stop.raise(),
                Some(KeyAction::Kick) => kick(arbiter),
                Some(KeyAction::Stop) => {
                    keyboard.was_driving = false;
                    stop_robot(arbiter);
                }
                Some(KeyAction::Release) => release_robot(arbiter),
                None => {}
            }
        }
        pads.read();
        if pads.take_kick() {
            kick(arbiter);
        }
        let twist = pads.twist(keyboard.speed).or_else(|| keyboard.twist(now));
        match twist {
            Some(twist) => {
                // After a rejection the next command tries again.
                let _rejected = arbiter.drive(
                    CommandSource::Operator,
                    MotionCommand::Twist(twist),
                    now + COMMAND_VALIDITY,
                    false,
                );
                keyboard.was_driving = true;
            }
            None if std::mem::take(&mut keyboard.was_driving) => arbiter.halt(),
            None => {}
        }
    }
    Ok(())
}

fn stop_robot(arbiter: &CommandArbiter) {
    if arbiter.stop_by_hand() {
        stderr_line!("stopped: no program drives until r is pressed");
    }
}

fn release_robot(arbiter: &CommandArbiter) {
    if arbiter.release() {
        stderr_line!("programs may drive again");
    }
}

fn kick(arbiter: &CommandArbiter) {
    let kick = Kick {
        speed: KICK_SPEED,
        lofted: false,
    };
    let _rejected = arbiter.kick(CommandSource::Operator, kick, hw::now() + COMMAND_VALIDITY);
}
