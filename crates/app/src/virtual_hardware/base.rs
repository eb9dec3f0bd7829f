//! What turns the virtual robot's wheels? A base board, or a VESC for each.

use hw::config::Bus;
use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::{Compass, Imu};

use super::board::VirtualBoard;
use super::drive_command::{CommandStats, DriveCommand};
use super::vescs::{VescBus, VirtualVescs};

/// Either.
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
                let reach = VescBus::Slcan { open: false };
                VirtualBase::Vescs(VirtualVescs::new(omni, ticks_per_turn, reach))
            }
        }
    }

    /// The line was pulled out or put in.
    pub(super) fn on_reconnect(&mut self) {
        match self {
            VirtualBase::Board(board) => board.on_reconnect(),
            VirtualBase::Vescs(vescs) => vescs.on_reconnect(),
        }
    }

    /// Takes what was sent; returns the answers.
    pub(super) fn receive(&mut self, bytes: &[u8], now: Stamp) -> Vec<u8> {
        match self {
            VirtualBase::Board(board) => {
                board.receive(bytes, now);
                Vec::new()
            }
            VirtualBase::Vescs(vescs) => vescs.receive(bytes, now),
        }
    }

    /// What the wheels are to do now.
    pub(super) fn commanded_twist(&mut self, now: Stamp) -> Twist {
        self.drive_command().twist(now)
    }

    /// What it was told.
    pub(super) fn command_stats(&mut self) -> CommandStats {
        self.drive_command().stats
    }

    fn drive_command(&mut self) -> &mut DriveCommand {
        match self {
            VirtualBase::Board(board) => &mut board.drive_command,
            VirtualBase::Vescs(vescs) => &mut vescs.drive_command,
        }
    }

    /// The inertial unit's message; VESCs have none.
    pub(super) fn encode_imu(&mut self, imu: &Imu, time_us: u32) -> Vec<u8> {
        match self {
            VirtualBase::Board(board) => board.encode_imu(imu, time_us),
            VirtualBase::Vescs(_) => Vec::new(),
        }
    }

    /// The compass's message; VESCs have none.
    pub(super) fn encode_heading(&mut self, compass: &Compass, time_us: u32) -> Vec<u8> {
        match self {
            VirtualBase::Board(board) => board.encode_heading(compass, time_us),
            VirtualBase::Vescs(_) => Vec::new(),
        }
    }
}
