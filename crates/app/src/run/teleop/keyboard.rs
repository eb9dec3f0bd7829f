//! What do keys command? A motion while a key is held, a kick, or the end.

use std::os::fd::OwnedFd;

use anyhow::{Context, Result};
use localize::Stamp;
use localize::omni::Twist;
use rustix::fs::{Mode, OFlags};
use rustix::termios::{
    LocalModes, OptionalActions, QueueSelector, SpecialCodeIndex, Termios, tcflush, tcgetattr,
    tcsetattr,
};

use super::axes::twist_from_axes;
use super::key_sequences::Key;

/// Time for which a pressed key drives, seconds: terminals repeat a held key after half a second.
const KEY_HOLD: f64 = 0.6;
/// Speed at the start, m/s.
const INITIAL_SPEED: f32 = 0.5;
/// Range of the speed that keys can set, m/s.
const SPEED_MIN: f32 = 0.1;
const SPEED_MAX: f32 = 3.0;

/// A key's command other than motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum KeyAction {
    Kick,
    /// The wheels stop, and programs wait.
    Stop,
    /// Programs may drive again.
    Release,
    Quit,
}

/// Motion commanded by a key.
#[derive(Debug, Clone, Copy)]
struct HeldDirection {
    /// Forward, left and counter-clockwise, −1 to 1.
    axes: [f32; 3],
    until: Stamp,
}

/// Speed and direction that the keys command.
#[derive(Debug)]
pub(super) struct KeyboardState {
    pub(super) speed: f32,
    direction: Option<HeldDirection>,
    pub(super) was_driving: bool,
}

impl KeyboardState {
    pub(super) fn new() -> Self {
        KeyboardState {
            speed: INITIAL_SPEED,
            direction: None,
            was_driving: false,
        }
    }

    pub(super) fn handle_key(&mut self, key: Key, now: Stamp) -> Option<KeyAction> {
        let character = match key {
            Key::Up => b'w',
            Key::Down => b's',
            Key::Left => b'a',
            Key::Right => b'd',
            Key::Character(character) => character.to_ascii_lowercase(),
            Key::Other => 0,
        };
        let axes = match character {
            b'w' => [1.0, 0.0, 0.0],
            b's' => [-1.0, 0.0, 0.0],
            b'a' => [0.0, 1.0, 0.0],
            b'd' => [0.0, -1.0, 0.0],
            b'q' => [0.0, 0.0, 1.0],
            b'e' => [0.0, 0.0, -1.0],
            b'+' | b'=' => {
                self.speed = (self.speed * 1.25).min(SPEED_MAX);
                return None;
            }
            b'-' => {
                self.speed = (self.speed / 1.25).max(SPEED_MIN);
                return None;
            }
            b'k' => return Some(KeyAction::Kick),
            b' ' => {
                self.direction = None;
                return Some(KeyAction::Stop);
            }
            b'r' => return Some(KeyAction::Release),
            // Ctrl-C comes as a signal; Ctrl-D is the end of a terminal's input.
            b'x' | 4 => return Some(KeyAction::Quit),
            _ => {
                self.direction = None;
                return None;
            }
        };
        self.direction = Some(HeldDirection {
            axes,
            until: now + KEY_HOLD,
        });
        None
    }

    pub(super) fn twist(&self, now: Stamp) -> Option<Twist> {
        let held = self.direction?;
        (now < held.until).then(|| twist_from_axes(held.axes, self.speed))
    }
}

/// A terminal that delivers single keys. Its settings are restored on drop.
pub(super) struct RawTerminal {
    pub(super) fd: OwnedFd,
    saved_settings: Termios,
}

impl RawTerminal {
    /// The terminal of this process. None if it has no terminal.
    pub(super) fn open() -> Result<Option<Self>> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let Ok(fd) = rustix::fs::open("/dev/tty", flags, Mode::empty()) else {
            return Ok(None);
        };
        let saved_settings = tcgetattr(&fd).context("cannot read the terminal's settings")?;
        let mut single = saved_settings.clone();
        single.local_modes &= !(LocalModes::ICANON | LocalModes::ECHO);
        single.special_codes[SpecialCodeIndex::VMIN] = 0;
        single.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(&fd, OptionalActions::Now, &single)
            .context("cannot change the terminal's settings")?;
        Ok(Some(RawTerminal { fd, saved_settings }))
    }

    pub(super) fn discard_keys(&self) {
        // An error means that the terminal is gone.
        let _gone = tcflush(&self.fd, QueueSelector::IFlush);
    }

    pub(super) fn read_keys(&self) -> Vec<u8> {
        let mut bytes = [0; 64];
        // An error means that no key was pressed, or that the terminal is gone.
        let count = rustix::io::read(&self.fd, &mut bytes[..]).unwrap_or(0);
        bytes[..count].to_vec()
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        // The terminal may be gone.
        let _gone = tcsetattr(&self.fd, OptionalActions::Now, &self.saved_settings);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_drives_for_its_hold_time_and_any_other_key_stops() {
        let mut keys = KeyboardState::new();
        let at = Stamp::from_seconds;
        assert_eq!(keys.twist(at(0.0)), None);
        let letter = Key::Character;
        assert_eq!(keys.handle_key(letter(b'w'), at(0.0)), None);
        assert_eq!(
            keys.twist(at(0.5)).map(|twist| twist.x),
            Some(INITIAL_SPEED)
        );
        assert_eq!(keys.twist(at(0.7)), None, "after the hold time");
        keys.handle_key(letter(b'q'), at(1.0));
        assert!(keys.twist(at(1.1)).is_some_and(|twist| twist.theta > 0.0));
        keys.handle_key(Key::Up, at(1.1));
        assert!(keys.twist(at(1.1)).is_some_and(|twist| twist.x > 0.0));
        keys.handle_key(Key::Other, at(1.2));
        assert_eq!(keys.twist(at(1.2)), None);
        keys.handle_key(Key::Left, at(1.3));
        assert!(keys.twist(at(1.3)).is_some_and(|twist| twist.y > 0.0));
        let action = keys.handle_key(letter(b' '), at(1.4));
        assert_eq!((action, keys.twist(at(1.4))), (Some(KeyAction::Stop), None));
        for (key, action) in [
            (b'r', KeyAction::Release),
            (b'x', KeyAction::Quit),
            (b'k', KeyAction::Kick),
        ] {
            assert_eq!(keys.handle_key(letter(key), at(1.5)), Some(action));
        }
    }
}
