//! What turns the virtual robot's wheels? A base board, or a VESC for each.

use hw::config::Bus;
use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::{Compass, Imu};

use super::board::Board;
use super::orders::{Audit, Orders};
use super::vescs::{Reach, Vescs};

/// Either.
pub(super) enum Base {
    Board(Board),
    Vescs(Vescs),
}

impl Base {
    pub(super) fn new(bus: Bus, omni: OmniKinematics, ticks_per_turn: f32) -> Self {
        match bus {
            Bus::Board => Base::Board(Board::new(omni, ticks_per_turn)),
            Bus::VescUart => Base::Vescs(Vescs::new(omni, ticks_per_turn, Reach::Uart)),
            Bus::VescCan | Bus::VescSlcan => {
                let reach = Reach::Slcan { open: false };
                Base::Vescs(Vescs::new(omni, ticks_per_turn, reach))
            }
        }
    }

    /// The line was pulled out or put in.
    pub(super) fn plugged_anew(&mut self) {
        match self {
            Base::Board(board) => board.plugged_anew(),
            Base::Vescs(vescs) => vescs.plugged_anew(),
        }
    }

    /// Takes what was sent; returns the answers.
    pub(super) fn hear(&mut self, bytes: &[u8], now: Stamp) -> Vec<u8> {
        match self {
            Base::Board(board) => {
                board.hear(bytes, now);
                Vec::new()
            }
            Base::Vescs(vescs) => vescs.hear(bytes, now),
        }
    }

    /// What the wheels are to do now.
    pub(super) fn wanted(&mut self, now: Stamp) -> Twist {
        self.orders().wanted(now)
    }

    /// What it was told.
    pub(super) fn audit(&mut self) -> Audit {
        self.orders().audit
    }

    fn orders(&mut self) -> &mut Orders {
        match self {
            Base::Board(board) => &mut board.orders,
            Base::Vescs(vescs) => &mut vescs.orders,
        }
    }

    /// The inertial unit's message; VESCs have none.
    pub(super) fn inertia(&mut self, imu: &Imu, time_us: u32) -> Vec<u8> {
        match self {
            Base::Board(board) => board.inertia(imu, time_us),
            Base::Vescs(_) => Vec::new(),
        }
    }

    /// The compass's message; VESCs have none.
    pub(super) fn heading(&mut self, compass: &Compass, time_us: u32) -> Vec<u8> {
        match self {
            Base::Board(board) => board.heading(compass, time_us),
            Base::Vescs(_) => Vec::new(),
        }
    }
}
