//! Which base does the virtual robot have? A base board, or a VESC for each wheel.

use hw::config::Bus;
use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::{Compass, Imu};

use super::board::{ReceivedKick, VirtualBoard};
use super::drive_command::{CommandStats, DriveCommand};
use super::vescs::{VescBus, VirtualVescs};

/// Firmware of the virtual base.
pub(super) enum VirtualBase {
    Board(VirtualBoard),
    Vescs(VirtualVescs),
}

impl VirtualBase {
    pub(super) fn new(bus: Bus, omni: OmniKinematics, ticks_per_turn: f32) -> Self {
        match bus {
            Bus::Board => VirtualBase::Board(VirtualBoard::new(omni, ticks_per_turn)),
            Bus::VescUart => {
                VirtualBase::Vescs(VirtualVescs::new(omni, ticks_per_turn, VescBus::Uart))
            }
            Bus::VescCan | Bus::VescSlcan => {
                let bus = VescBus::Slcan { open: false };
                VirtualBase::Vescs(VirtualVescs::new(omni, ticks_per_turn, bus))
            }
        }
    }

    /// The port was unplugged or plugged in.
    pub(super) fn on_reconnect(&mut self) {
        match self {
            VirtualBase::Board(board) => board.on_reconnect(),
            VirtualBase::Vescs(vescs) => vescs.on_reconnect(),
        }
    }

    /// Processes received bytes; returns the answers.
    pub(super) fn receive(&mut self, bytes: &[u8], now: Stamp) -> Vec<u8> {
        match self {
            VirtualBase::Board(board) => {
                board.receive(bytes, now);
                Vec::new()
            }
            VirtualBase::Vescs(vescs) => vescs.receive(bytes, now),
        }
    }

    /// Commanded velocity now.
    pub(super) fn commanded_twist(&mut self, now: Stamp) -> Twist {
        self.drive_command().twist(now)
    }

    /// Takes the last kick; VESCs have no kicker.
    pub(super) fn take_kick(&mut self) -> Option<ReceivedKick> {
        match self {
            VirtualBase::Board(board) => board.take_kick(),
            VirtualBase::Vescs(_) => None,
        }
    }

    /// Statistics of the commands.
    pub(super) fn command_stats(&mut self) -> CommandStats {
        self.drive_command().stats
    }

    fn drive_command(&mut self) -> &mut DriveCommand {
        match self {
            VirtualBase::Board(board) => &mut board.drive_command,
            VirtualBase::Vescs(vescs) => &mut vescs.drive_command,
        }
    }

    /// Message of the IMU; VESCs have none.
    pub(super) fn encode_imu(&mut self, imu: &Imu, time_us: u32) -> Vec<u8> {
        match self {
            VirtualBase::Board(board) => board.encode_imu(imu, time_us),
            VirtualBase::Vescs(_) => Vec::new(),
        }
    }

    /// Message of the compass; VESCs have none.
    pub(super) fn encode_heading(&mut self, compass: &Compass, time_us: u32) -> Vec<u8> {
        match self {
            VirtualBase::Board(board) => board.encode_heading(compass, time_us),
            VirtualBase::Vescs(_) => Vec::new(),
        }
    }
}
