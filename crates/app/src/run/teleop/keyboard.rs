//! What do keys ask for? A motion for as long as one is held, a kick, or the end.

use std::os::fd::OwnedFd;

use anyhow::{Context, Result};
use localize::Stamp;
use localize::omni::Twist;
use rustix::fs::{Mode, OFlags};
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr,
};

use super::twist_from_axes;

/// A key drives for so long after it was pressed, seconds: terminals repeat a held key after half a second.
const KEY_HOLD: f64 = 0.6;
/// Speed at the start, m/s, and what a key or a full stick may make of it.
const INITIAL_SPEED: f32 = 0.5;
const SPEED_RANGE: (f32, f32) = (0.1, 3.0);
/// What a key asks for besides motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum KeyAction {
    Kick,
    Quit,
}

/// The keys' doing.
#[derive(Debug)]
pub(super) struct KeyboardState {
    pub(super) speed: f32,
    direction: Option<([f32; 3], Stamp)>,
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

    pub(super) fn handle_key(&mut self, key: u8, now: Stamp) -> Option<KeyAction> {
        let way = match key.to_ascii_lowercase() {
            b'w' => [1.0, 0.0, 0.0],
            b's' => [-1.0, 0.0, 0.0],
            b'a' => [0.0, 1.0, 0.0],
            b'd' => [0.0, -1.0, 0.0],
            b'q' => [0.0, 0.0, 1.0],
            b'e' => [0.0, 0.0, -1.0],
            b'+' | b'=' => {
                self.speed = (self.speed * 1.25).min(SPEED_RANGE.1);
                return None;
            }
            b'-' => {
                self.speed = (self.speed / 1.25).max(SPEED_RANGE.0);
                return None;
            }
            b'k' => return Some(KeyAction::Kick),
            // Ctrl-C comes as a signal; Ctrl-D is the end of a terminal's input.
            b'x' | 4 => return Some(KeyAction::Quit),
            _ => {
                self.direction = None;
                return None;
            }
        };
        self.direction = Some((way, now + KEY_HOLD));
        None
    }

    pub(super) fn twist(&self, now: Stamp) -> Option<Twist> {
        let (way, until) = self.direction?;
        (now < until).then(|| twist_from_axes(way, self.speed))
    }
}

/// A terminal that gives each key as it is pressed; it is as it was again afterwards.
pub(super) struct RawTerminal {
    pub(super) fd: OwnedFd,
    saved_settings: Termios,
}

impl RawTerminal {
    /// The terminal of this process; none where there is none.
    pub(super) fn open() -> Result<Option<Self>> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let Ok(fd) = rustix::fs::open("/dev/tty", flags, Mode::empty()) else {
            return Ok(None);
        };
        let before = tcgetattr(&fd).context("cannot read the terminal's settings")?;
        let mut single = before.clone();
        single.local_modes &= !(LocalModes::ICANON | LocalModes::ECHO);
        single.special_codes[SpecialCodeIndex::VMIN] = 0;
        single.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(&fd, OptionalActions::Now, &single)
            .context("cannot take single keys from the terminal")?;
        Ok(Some(RawTerminal {
            fd,
            saved_settings: before,
        }))
    }

    pub(super) fn read_keys(&self) -> Vec<u8> {
        let mut bytes = [0; 64];
        // Nothing pressed, or a terminal that is gone: no key either way.
        let count = rustix::io::read(&self.fd, &mut bytes[..]).unwrap_or(0);
        bytes[..count].to_vec()
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        // A terminal that is gone needs no settings.
        let _gone = tcsetattr(&self.fd, OptionalActions::Now, &self.saved_settings);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_drives_for_its_hold_time_and_any_other_key_stops() {
        let mut hand = KeyboardState::new();
        let at = Stamp::from_seconds;
        assert_eq!(hand.twist(at(0.0)), None);
        assert_eq!(hand.handle_key(b'w', at(0.0)), None);
        assert_eq!(
            hand.twist(at(0.5)).map(|twist| twist.x),
            Some(INITIAL_SPEED)
        );
        assert_eq!(hand.twist(at(0.7)), None, "the hand let go");
        hand.handle_key(b'q', at(1.0));
        assert!(hand.twist(at(1.1)).is_some_and(|twist| twist.theta > 0.0));
        hand.handle_key(b' ', at(1.2));
        assert_eq!(hand.twist(at(1.2)), None);
        assert_eq!(hand.handle_key(b'x', at(1.3)), Some(KeyAction::Quit));
        assert_eq!(hand.handle_key(b'k', at(1.3)), Some(KeyAction::Kick));
    }
}
