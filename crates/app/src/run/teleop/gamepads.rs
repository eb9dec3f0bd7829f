//! What do game pads command? A motion while a shoulder button is held, and kicks.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use localize::Stamp;
use localize::omni::Twist;
use rustix::fs::{Mode, OFlags};

use super::axes::twist_from_axes;

/// Game pads by the protocol of linux/joystick.h: events of 8 bytes.
#[derive(Default)]
pub(super) struct Gamepads {
    pub(super) pads: Vec<Gamepad>,
    last_scan: Option<Stamp>,
}

pub(super) struct Gamepad {
    path: PathBuf,
    pub(super) fd: OwnedFd,
    /// −1 to 1: left stick (right, down), triggers and right stick in the driver's numbering.
    axes: [f32; 8],
    buttons: [bool; 16],
    kick_pressed: bool,
}

/// Period of the scan for new pads, seconds.
const SCAN_PERIOD: f64 = 1.0;
/// Deflections of a stick below this are zero.
const DEAD_ZONE: f32 = 0.1;
/// Axes and buttons in the numbering of the kernel driver for most pads (xpad).
const AXIS_LEFT_X: usize = 0;
const AXIS_LEFT_Y: usize = 1;
const AXIS_RIGHT_X: usize = 3;
const KICK_BUTTON: usize = 0;
const SHOULDER_BUTTONS: [usize; 2] = [4, 5];

impl Gamepads {
    pub(super) fn scan(&mut self) {
        let now = hw::now();
        if self.last_scan.is_some_and(|last| now - last < SCAN_PERIOD) {
            return;
        }
        self.last_scan = Some(now);
        for number in 0..4 {
            let path = PathBuf::from(format!("/dev/input/js{number}"));
            if !self.pads.iter().any(|pad| pad.path == path) {
                self.pads.extend(Gamepad::open(&path));
            }
        }
    }

    /// Reads the pads' events and removes pads that were unplugged.
    pub(super) fn read(&mut self) {
        self.pads.retain_mut(Gamepad::read);
    }

    pub(super) fn take_kick(&mut self) -> bool {
        self.pads
            .iter_mut()
            .any(|pad| std::mem::take(&mut pad.kick_pressed))
    }

    pub(super) fn twist(&self, speed: f32) -> Option<Twist> {
        let held = |pad: &&Gamepad| SHOULDER_BUTTONS.iter().any(|button| pad.buttons[*button]);
        let pad = self.pads.iter().find(held)?;
        let axes = [AXIS_LEFT_Y, AXIS_LEFT_X, AXIS_RIGHT_X].map(|axis| {
            let deflection = pad.axes[axis];
            if deflection.abs() < DEAD_ZONE {
                0.0
            } else {
                -deflection
            }
        });
        Some(twist_from_axes(axes, speed))
    }
}

impl Gamepad {
    fn open(path: &Path) -> Option<Self> {
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = rustix::fs::open(path, flags, Mode::empty()).ok()?;
        Some(Gamepad {
            path: path.to_owned(),
            fd,
            axes: [0.0; 8],
            buttons: [false; 16],
            kick_pressed: false,
        })
    }

    /// Reads the pending events. False if the pad is gone.
    fn read(&mut self) -> bool {
        let mut bytes = [0; 512];
        match rustix::io::read(&self.fd, &mut bytes[..]) {
            Ok(0) => false,
            Ok(count) => {
                bytes[..count]
                    .chunks_exact(8)
                    .for_each(|event| self.handle_event(event));
                true
            }
            Err(rustix::io::Errno::WOULDBLOCK | rustix::io::Errno::INTR) => true,
            Err(_) => false,
        }
    }

    /// An event: u32 time, i16 value, u8 kind (1 button, 2 axis, with 0x80 the initial state), u8 number.
    fn handle_event(&mut self, event: &[u8]) {
        let value = i16::from_le_bytes([event[4], event[5]]);
        let (is_initial, number) = (event[6] & 0x80 != 0, usize::from(event[7]));
        match event[6] & 0x7F {
            1 => {
                if let Some(button) = self.buttons.get_mut(number) {
                    *button = value != 0;
                    self.kick_pressed |= number == KICK_BUTTON && value != 0 && !is_initial;
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
    fn gamepad_drives_only_with_shoulder_button_held() {
        let fd = rustix::fs::open("/dev/null", OFlags::RDONLY, Mode::empty()).expect("opened");
        let mut pads = Gamepads::default();
        pads.pads.push(Gamepad {
            path: PathBuf::new(),
            fd,
            axes: [0.0; 8],
            buttons: [false; 16],
            kick_pressed: false,
        });
        let event = |value: i16, kind, number| {
            let [low, high] = value.to_le_bytes();
            [0, 0, 0, 0, low, high, kind, number]
        };
        pads.pads[0].handle_event(&event(-32_767, 2, 1));
        assert_eq!(pads.twist(1.0), None);
        pads.pads[0].handle_event(&event(1, 1, 4));
        let twist = pads.twist(1.0).expect("driven");
        assert!((twist.x - 1.0).abs() < 1e-4 && twist.y == 0.0);
        pads.pads[0].handle_event(&event(1, 1 | 0x80, 0));
        assert!(!pads.take_kick(), "the button was pressed before the start");
        pads.pads[0].handle_event(&event(1, 1, 0));
        assert!(pads.take_kick() && !pads.take_kick());
        // /dev/null ends at once, as an unplugged pad does.
        pads.read();
        assert_eq!(pads.twist(1.0), None);
    }
}
