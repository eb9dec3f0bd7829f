//! What do VESCs say on a CAN bus? Extended identifiers (command << 8) | node, numbers big-endian.
//!
//! Layouts: VESC firmware, comm_can.c. Which status frames are sent, and how often, is set in the controllers: STATUS (speed,
//! current) and STATUS_5 (tachometer, supply) are needed here, STATUS_4 (temperatures) is welcome.

use super::can::CanFrame;

const SET_CURRENT: u32 = 1;
const SET_RPM: u32 = 3;
const STATUS: u32 = 9;
const STATUS_4: u32 = 16;
const STATUS_5: u32 = 27;

/// What a controller is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VescCommand {
    /// Turn at so many electrical revolutions per minute.
    SetRpm(i32),
    /// Drive this current through the motor; 0 lets it coast.
    SetCurrentMa(i32),
}

/// What a controller says by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VescStatus {
    /// STATUS.
    Motion {
        /// Electrical revolutions per minute.
        erpm: i32,
        /// Current through the motor, 0.1 A.
        current_da: i16,
        /// Duty cycle, thousandths.
        duty_permille: i16,
    },
    /// STATUS_4.
    Temperature {
        /// Temperature of the transistors, 0.1 °C.
        temperature_ddeg: i16,
    },
    /// STATUS_5.
    Position {
        /// Steps of the motor since power-on, six per electrical revolution, wrapping.
        tachometer: i32,
        /// Supply, 0.1 V.
        voltage_dv: i16,
    },
}

impl VescCommand {
    /// The frame that tells controller `node`.
    pub fn encode(self, node: u8) -> CanFrame {
        let (command, value) = match self {
            VescCommand::SetRpm(erpm) => (SET_RPM, erpm),
            VescCommand::SetCurrentMa(current) => (SET_CURRENT, current),
        };
        encode_frame(command, node, &value.to_be_bytes())
    }

    /// Node and order of a frame; `None` for another frame. For whoever plays a controller.
    pub fn decode(frame: &CanFrame) -> Option<(u8, VescCommand)> {
        let (command, node) = split_identifier(frame)?;
        let value = i32::from_be_bytes(frame.data().try_into().ok()?);
        match command {
            SET_RPM => Some((node, VescCommand::SetRpm(value))),
            SET_CURRENT => Some((node, VescCommand::SetCurrentMa(value))),
            _ => None,
        }
    }
}

impl VescStatus {
    /// Node and status of a frame; `None` for another frame (or one that is too short).
    pub fn decode(frame: &CanFrame) -> Option<(u8, VescStatus)> {
        let (command, node) = split_identifier(frame)?;
        let data = frame.data();
        let short = |at: usize| Some(i16::from_be_bytes([*data.get(at)?, *data.get(at + 1)?]));
        let long = |at: usize| Some(i32::from_be_bytes(data.get(at..at + 4)?.try_into().ok()?));
        let status = match command {
            STATUS => VescStatus::Motion {
                erpm: long(0)?,
                current_da: short(4)?,
                duty_permille: short(6)?,
            },
            STATUS_4 => VescStatus::Temperature {
                temperature_ddeg: short(0)?,
            },
            STATUS_5 => VescStatus::Position {
                tachometer: long(0)?,
                voltage_dv: short(4)?,
            },
            _ => return None,
        };
        Some((node, status))
    }

    /// The frame as controller `node` sends it, fields that are not held here being zero.
    pub fn encode(self, node: u8) -> CanFrame {
        let mut data = [0; 8];
        let command = match self {
            VescStatus::Motion {
                erpm,
                current_da,
                duty_permille,
            } => {
                data[..4].copy_from_slice(&erpm.to_be_bytes());
                data[4..6].copy_from_slice(&current_da.to_be_bytes());
                data[6..].copy_from_slice(&duty_permille.to_be_bytes());
                STATUS
            }
            VescStatus::Temperature { temperature_ddeg } => {
                data[..2].copy_from_slice(&temperature_ddeg.to_be_bytes());
                STATUS_4
            }
            VescStatus::Position {
                tachometer,
                voltage_dv,
            } => {
                data[..4].copy_from_slice(&tachometer.to_be_bytes());
                data[4..6].copy_from_slice(&voltage_dv.to_be_bytes());
                STATUS_5
            }
        };
        encode_frame(command, node, &data)
    }
}

/// Command and node of an extended data frame.
fn split_identifier(frame: &CanFrame) -> Option<(u32, u8)> {
    let [_, _, _, node] = frame.id.to_be_bytes();
    (frame.extended && !frame.remote).then_some((frame.id >> 8, node))
}

fn encode_frame(command: u32, node: u8, data: &[u8]) -> CanFrame {
    CanFrame::extended((command << 8) | u32::from(node), data)
}
