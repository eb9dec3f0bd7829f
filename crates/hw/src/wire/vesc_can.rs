//! What do VESCs exchange on a CAN bus? Frames with extended identifiers (command << 8) | node and big-endian numbers.
//!
//! Layouts: VESC firmware, comm_can.c. The controllers' settings select the status frames and their rates: STATUS (speed,
//! current) and STATUS_5 (tachometer, supply) are required, STATUS_4 (temperatures) is optional.

use super::can::CanFrame;

const SET_CURRENT: u32 = 1;
const SET_RPM: u32 = 3;
const STATUS: u32 = 9;
const STATUS_4: u32 = 16;
const STATUS_5: u32 = 27;

/// A message with the controller that sends or receives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Addressed<T> {
    /// Node number of the controller.
    pub node: u8,
    /// The message.
    pub message: T,
}

/// A command to a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VescCommand {
    /// Set the speed, electrical revolutions per minute.
    SetRpm(i32),
    /// Set the motor current, mA; 0 releases the motor.
    SetCurrentMa(i32),
}

/// A status frame, which a controller sends at a fixed rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VescStatus {
    /// STATUS.
    Motion {
        /// Electrical revolutions per minute.
        erpm: i32,
        /// Motor current, 0.1 A.
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
        /// Supply voltage, 0.1 V.
        voltage_dv: i16,
    },
}

impl VescCommand {
    /// The frame to controller `node`.
    pub fn encode(self, node: u8) -> CanFrame {
        let (command, value) = match self {
            VescCommand::SetRpm(erpm) => (SET_RPM, erpm),
            VescCommand::SetCurrentMa(current) => (SET_CURRENT, current),
        };
        encode_frame(command, node, &value.to_be_bytes())
    }

    /// Decodes a frame, for a program that acts as a controller; `None` for other frames.
    pub fn decode(frame: &CanFrame) -> Option<Addressed<VescCommand>> {
        let (command, node) = split_identifier(frame)?;
        let value = i32::from_be_bytes(frame.data().try_into().ok()?);
        let message = match command {
            SET_RPM => VescCommand::SetRpm(value),
            SET_CURRENT => VescCommand::SetCurrentMa(value),
            _ => return None,
        };
        Some(Addressed { node, message })
    }
}

impl VescStatus {
    /// Decodes a frame; `None` for other frames and those that are too short.
    pub fn decode(frame: &CanFrame) -> Option<Addressed<VescStatus>> {
        let (command, node) = split_identifier(frame)?;
        let data = frame.data();
        let short = |at: usize| Some(i16::from_be_bytes([*data.get(at)?, *data.get(at + 1)?]));
        let long = |at: usize| Some(i32::from_be_bytes(data.get(at..at + 4)?.try_into().ok()?));
        let message = match command {
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
        Some(Addressed { node, message })
    }

    /// The frame as controller `node` sends it; fields that are not represented here are zero.
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
