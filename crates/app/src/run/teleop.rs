//! How does a hand drive the robot? By keys of the terminal or a game pad, and never longer than the hand is on them.

use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use hw::base::{Drive, Kick};
use localize::Stamp;
use localize::omni::Twist;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr,
};

use super::helm::{Driver, Helm};
use super::stop::Stop;

/// A key drives for so long after it was pressed, seconds: terminals repeat a held key after half a second.
const KEY_HOLD: f64 = 0.6;
/// Commands are good for so long, seconds.
const COMMAND: f64 = 0.08;
/// Time between commands, nanoseconds.
const PERIOD_NS: i64 = 20_000_000;
/// Speed at the start, m/s, and what a key or a full stick may make of it.
const SPEED_FIRST: f32 = 0.5;
const SPEED_RANGE: (f32, f32) = (0.1, 3.0);
/// Rate of turn over speed, rad/s per m/s: a robot that drives fast may turn fast.
const TURN_PER_SPEED: f32 = 2.0;
/// Speed of a kicked ball, m/s.
const KICK_SPEED: f32 = 6.0;

/// What the keys are, for whoever starts.
pub const HELP: &str = "drive: w a s d, turn: q e, slower and faster: - +, kick: k, stop: space, end: x or Ctrl-C\n\
     game pad: hold a shoulder button; left stick drives, right stick turns, first button kicks";

/// Drives by hand until the end is asked for.
pub fn drive(helm: &Helm, stop: &Stop) -> Result<()> {
    let keys = Keys::open()?;
    let keys = keys.as_ref();
    let mut pads = Pads::default();
    let mut hand = Hand::new();
    while !stop.is_raised() {
        pads.look();
        let mut fds: Vec<_> = keys.iter().map(|keys| keys.fd.as_fd()).collect();
        fds.extend(pads.open.iter().map(|pad| pad.fd.as_fd()));
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
        for key in keys.iter().flat_map(|keys| keys.pressed()) {
            match hand.key(key, now) {
                Some(Wish::End) => stop.raise(),
                Some(Wish::Kick) => kick(helm),
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
                let _refused = helm.drive(Driver::Hand, Drive::Twist(twist), now + COMMAND, false);
                hand.drove = true;
            }
            None if std::mem::take(&mut hand.drove) => helm.halt(),
            None => {}
        }
    }
    Ok(())
}

fn kick(helm: &Helm) {
    let kick = Kick {
        speed: KICK_SPEED,
        lofted: false,
    };
    let _refused = helm.kick(Driver::Hand, kick, hw::now() + COMMAND);
}

/// What a key asks for besides motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wish {
    Kick,
    End,
}

/// The keys' doing.
#[derive(Debug)]
struct Hand {
    speed: f32,
    way: Option<([f32; 3], Stamp)>,
    drove: bool,
}

impl Hand {
    fn new() -> Self {
        Hand {
            speed: SPEED_FIRST,
            way: None,
            drove: false,
        }
    }

    fn key(&mut self, key: u8, now: Stamp) -> Option<Wish> {
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
            b'k' => return Some(Wish::Kick),
            // Ctrl-C comes as a signal; Ctrl-D is the end of a terminal's input.
            b'x' | 4 => return Some(Wish::End),
            _ => {
                self.way = None;
                return None;
            }
        };
        self.way = Some((way, now + KEY_HOLD));
        None
    }

    fn twist(&self, now: Stamp) -> Option<Twist> {
        let (way, until) = self.way?;
        (now < until).then(|| twist_of(way, self.speed))
    }
}

fn twist_of([x, y, turn]: [f32; 3], speed: f32) -> Twist {
    Twist {
        x: x * speed,
        y: y * speed,
        theta: turn * speed * TURN_PER_SPEED,
    }
}

/// A terminal that gives each key as it is pressed; it is as it was again afterwards.
struct Keys {
    fd: OwnedFd,
    before: Termios,
}

impl Keys {
    /// The terminal of this process; none where there is none.
    fn open() -> Result<Option<Self>> {
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
        Ok(Some(Keys { fd, before }))
    }

    fn pressed(&self) -> Vec<u8> {
        let mut bytes = [0; 64];
        // Nothing pressed, or a terminal that is gone: no key either way.
        let count = rustix::io::read(&self.fd, &mut bytes[..]).unwrap_or(0);
        bytes[..count].to_vec()
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        // A terminal that is gone needs no settings.
        let _gone = tcsetattr(&self.fd, OptionalActions::Now, &self.before);
    }
}

/// Game pads as linux/joystick.h has them: events of 8 bytes.
#[derive(Default)]
struct Pads {
    open: Vec<Pad>,
    looked: Option<Stamp>,
}

struct Pad {
    path: PathBuf,
    fd: OwnedFd,
    /// −1 to 1: left stick (right, down), triggers and right stick as the driver numbers them.
    axes: [f32; 8],
    buttons: [bool; 16],
    kick: bool,
}

/// Time between looks for pads that were plugged in, seconds.
const LOOK: f64 = 1.0;
/// Deflection of a stick that is none.
const DEAD_ZONE: f32 = 0.1;
/// Axes and buttons as the kernel's driver for most pads (xpad) numbers them.
const LEFT_RIGHT: usize = 0;
const LEFT_DOWN: usize = 1;
const RIGHT_RIGHT: usize = 3;
const KICK_BUTTON: usize = 0;
const SHOULDERS: [usize; 2] = [4, 5];

impl Pads {
    fn look(&mut self) {
        let now = hw::now();
        if self.looked.is_some_and(|looked| now - looked < LOOK) {
            return;
        }
        self.looked = Some(now);
        for number in 0..4 {
            let path = PathBuf::from(format!("/dev/input/js{number}"));
            if !self.open.iter().any(|pad| pad.path == path) {
                self.open.extend(Pad::open(&path));
            }
        }
    }

    /// Takes what the pads say; one that was pulled out says nothing, and drives nothing, any more.
    fn read(&mut self) {
        self.open.retain_mut(Pad::read);
    }

    fn take_kick(&mut self) -> bool {
        self.open
            .iter_mut()
            .any(|pad| std::mem::take(&mut pad.kick))
    }

    fn twist(&self, speed: f32) -> Option<Twist> {
        let held = |pad: &&Pad| SHOULDERS.iter().any(|button| pad.buttons[*button]);
        let pad = self.open.iter().find(held)?;
        let way = [LEFT_DOWN, LEFT_RIGHT, RIGHT_RIGHT].map(|axis| {
            let deflection = pad.axes[axis];
            if deflection.abs() < DEAD_ZONE {
                0.0
            } else {
                -deflection
            }
        });
        Some(twist_of(way, speed))
    }
}

impl Pad {
    fn open(path: &Path) -> Option<Self> {
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = rustix::fs::open(path, flags, Mode::empty()).ok()?;
        Some(Pad {
            path: path.to_owned(),
            fd,
            axes: [0.0; 8],
            buttons: [false; 16],
            kick: false,
        })
    }

    /// False if the pad is gone.
    fn read(&mut self) -> bool {
        let mut bytes = [0; 512];
        match rustix::io::read(&self.fd, &mut bytes[..]) {
            Ok(0) => false,
            Ok(count) => {
                bytes[..count]
                    .chunks_exact(8)
                    .for_each(|event| self.event(event));
                true
            }
            Err(rustix::io::Errno::WOULDBLOCK | rustix::io::Errno::INTR) => true,
            Err(_) => false,
        }
    }

    /// u32 time, i16 value, u8 kind (1 button, 2 axis, with 0x80 the state at the start), u8 number.
    fn event(&mut self, event: &[u8]) {
        let value = i16::from_le_bytes([event[4], event[5]]);
        let (first, number) = (event[6] & 0x80 != 0, usize::from(event[7]));
        match event[6] & 0x7F {
            1 => {
                if let Some(button) = self.buttons.get_mut(number) {
                    *button = value != 0;
                    self.kick |= number == KICK_BUTTON && value != 0 && !first;
                }
            }
            2 => {
                if let Some(axis) = self.axes.get_mut(number) {
                    *axis = f32::from(value) / 32_767.0;
                }
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_drives_for_as_long_as_it_is_held_and_another_stops() {
        let mut hand = Hand::new();
        let at = Stamp::from_seconds;
        assert_eq!(hand.twist(at(0.0)), None);
        assert_eq!(hand.key(b'w', at(0.0)), None);
        assert_eq!(hand.twist(at(0.5)).map(|twist| twist.x), Some(SPEED_FIRST));
        assert_eq!(hand.twist(at(0.7)), None, "the hand let go");
        hand.key(b'q', at(1.0));
        assert!(hand.twist(at(1.1)).is_some_and(|twist| twist.theta > 0.0));
        hand.key(b' ', at(1.2));
        assert_eq!(hand.twist(at(1.2)), None);
        assert_eq!(hand.key(b'x', at(1.3)), Some(Wish::End));
        assert_eq!(hand.key(b'k', at(1.3)), Some(Wish::Kick));
    }

    #[test]
    fn a_pad_drives_only_while_a_shoulder_button_is_held() {
        let fd = rustix::fs::open("/dev/null", OFlags::RDONLY, Mode::empty()).expect("opened");
        let mut pads = Pads::default();
        pads.open.push(Pad {
            path: PathBuf::new(),
            fd,
            axes: [0.0; 8],
            buttons: [false; 16],
            kick: false,
        });
        let event = |value: i16, kind, number| {
            let [low, high] = value.to_le_bytes();
            [0, 0, 0, 0, low, high, kind, number]
        };
        pads.open[0].event(&event(-32_767, 2, 1));
        assert_eq!(pads.twist(1.0), None);
        pads.open[0].event(&event(1, 1, 4));
        let twist = pads.twist(1.0).expect("driven");
        assert!((twist.x - 1.0).abs() < 1e-4 && twist.y == 0.0);
        pads.open[0].event(&event(1, 1 | 0x80, 0));
        assert!(!pads.take_kick(), "held since before");
        pads.open[0].event(&event(1, 1, 0));
        assert!(pads.take_kick() && !pads.take_kick());
        // The end of /dev/null is what an unplugged pad looks like.
        pads.read();
        assert_eq!(pads.twist(1.0), None);
    }
}
