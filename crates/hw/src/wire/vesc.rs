//! What does a VESC exchange over its UART? Packets `02 length payload crc16 03`; the payload starts with the command.
//!
//! Numbers are big-endian. Layouts: VESC firmware, commands.c (COMM_GET_VALUES, firmware 3.40 and later). A controller
//! forwards the content of COMM_FORWARD_CAN to another one on its CAN bus; the answer is not wrapped and contains the
//! number of that controller.

use super::crc16;
use super::decoder::{DecodeError, ParseStep, StreamDecoder, skip_to};

const START: u8 = 2;
const STOP: u8 = 3;
const GET_VALUES: u8 = 4;
const SET_CURRENT: u8 = 6;
const SET_RPM: u8 = 8;
const FORWARD_CAN: u8 = 34;
/// Bytes of the answer to GET_VALUES up to and including the controller's number; newer firmware appends more.
const VALUES_BYTES: usize = 59;
/// Steps of the tachometer in one electrical revolution.
const TACHOMETER_STEPS_PER_REVOLUTION: f32 = 6.0;

/// Electrical revolutions per minute at a wheel speed of 1 rad/s, for tachometer ticks per turn of the wheel.
pub fn erpm_per_rad_s(ticks_per_turn: f32) -> f32 {
    60.0 / std::f32::consts::TAU * ticks_per_turn / TACHOMETER_STEPS_PER_REVOLUTION
}

/// A command or query to a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Query the state.
    GetValues,
    /// Set the speed, electrical revolutions per minute.
    SetRpm(i32),
    /// Set the motor current, mA; 0 releases the motor.
    SetCurrentMa(i32),
}

/// A request with the controller that it is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoutedRequest {
    /// Node to which the request is forwarded; `None` for the controller on the UART.
    pub node: Option<u8>,
    /// The request.
    pub request: Request,
}

/// State of a controller, the answer to [`Request::GetValues`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Values {
    /// Node number of the controller on the CAN bus.
    pub node: u8,
    /// Speed, electrical revolutions per minute.
    pub erpm: i32,
    /// Steps of the motor since power-on, six per electrical revolution, wrapping.
    pub tachometer: i32,
    /// Supply voltage, 0.1 V.
    pub voltage_dv: i16,
    /// Motor current, 0.01 A.
    pub motor_current_ca: i32,
    /// Temperature of the transistors, 0.1 °C.
    pub temperature_ddeg: i16,
    /// Fault code, 0 for none.
    pub fault: u8,
}

/// A packet of a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reply {
    /// The answer to [`Request::GetValues`].
    Values(Values),
    /// Another complete packet by its command byte.
    Other(u8),
}

/// A decoder of the controller's stream.
pub fn decoder() -> StreamDecoder<Reply> {
    StreamDecoder::new(parse)
}

/// Classifies the front of `bytes`.
///
/// Packets above 255 bytes (start byte 3) contain configurations and firmware, which are never requested.
pub fn parse(bytes: &[u8]) -> ParseStep<Reply> {
    let begins = |byte| byte == START;
    if bytes.first() != Some(&START) || bytes.get(1) == Some(&0) {
        return skip_to(bytes, begins, DecodeError::Noise);
    }
    let Some(length) = bytes.get(1).map(|length| usize::from(*length)) else {
        return ParseStep::Incomplete;
    };
    let Some(packet) = bytes.get(..length + 5) else {
        return ParseStep::Incomplete;
    };
    let payload = &packet[2..2 + length];
    if packet[length + 4] != STOP || packet[2 + length..4 + length] != crc16(payload).to_be_bytes()
    {
        return skip_to(bytes, begins, DecodeError::Checksum);
    }
    if payload[0] == GET_VALUES && length < VALUES_BYTES {
        return ParseStep::Skip(length + 5, Some(DecodeError::Length));
    }
    ParseStep::Message(length + 5, decode_reply(payload))
}

fn decode_reply(payload: &[u8]) -> Reply {
    if payload[0] != GET_VALUES {
        return Reply::Other(payload[0]);
    }
    let short = |at: usize| i16::from_be_bytes([payload[at], payload[at + 1]]);
    let long = |at: usize| {
        i32::from_be_bytes([
            payload[at],
            payload[at + 1],
            payload[at + 2],
            payload[at + 3],
        ])
    };
    Reply::Values(Values {
        temperature_ddeg: short(1),
        motor_current_ca: long(5),
        erpm: long(23),
        voltage_dv: short(27),
        tachometer: long(45),
        fault: payload[53],
        node: payload[58],
    })
}

impl Values {
    /// The packet as a controller sends it; fields that are not represented here are zero.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = [0; VALUES_BYTES];
        payload[0] = GET_VALUES;
        payload[1..3].copy_from_slice(&self.temperature_ddeg.to_be_bytes());
        payload[5..9].copy_from_slice(&self.motor_current_ca.to_be_bytes());
        payload[23..27].copy_from_slice(&self.erpm.to_be_bytes());
        payload[27..29].copy_from_slice(&self.voltage_dv.to_be_bytes());
        payload[45..49].copy_from_slice(&self.tachometer.to_be_bytes());
        payload[53] = self.fault;
        payload[58] = self.node;
        encode_packet(&payload)
    }
}

impl Request {
    /// The packet to the controller on the UART.
    pub fn encode(self) -> Vec<u8> {
        encode_packet(&self.payload())
    }

    /// The packet that the controller on the UART forwards to `node` on its CAN bus.
    pub fn encode_forwarded(self, node: u8) -> Vec<u8> {
        let mut payload = vec![FORWARD_CAN, node];
        payload.extend_from_slice(&self.payload());
        encode_packet(&payload)
    }

    /// Decodes a packet, for a program that acts as a controller; `None` for other packets.
    pub fn decode(packet: &[u8]) -> Option<RoutedRequest> {
        let length = usize::from(*packet.get(1)?);
        let payload = packet.get(2..2 + length)?;
        if packet.len() != length + 5
            || packet[2 + length..4 + length] != crc16(payload).to_be_bytes()
        {
            return None;
        }
        let (node, payload) = match payload {
            [FORWARD_CAN, node, rest @ ..] => (Some(*node), rest),
            _ => (None, payload),
        };
        let request = match *payload {
            [GET_VALUES] => Request::GetValues,
            [SET_RPM, a, b, c, d] => Request::SetRpm(i32::from_be_bytes([a, b, c, d])),
            [SET_CURRENT, a, b, c, d] => Request::SetCurrentMa(i32::from_be_bytes([a, b, c, d])),
            _ => return None,
        };
        Some(RoutedRequest { node, request })
    }

    fn payload(self) -> Vec<u8> {
        let (command, value) = match self {
            Request::GetValues => return vec![GET_VALUES],
            Request::SetRpm(erpm) => (SET_RPM, erpm),
            Request::SetCurrentMa(current) => (SET_CURRENT, current),
        };
        let mut payload = vec![command];
        payload.extend_from_slice(&value.to_be_bytes());
        payload
    }
}

/// `02 length payload crc16 03`, for a payload of at most 255 bytes.
fn encode_packet(payload: &[u8]) -> Vec<u8> {
    let mut packet = vec![START, payload.len() as u8];
    packet.extend_from_slice(payload);
    packet.extend_from_slice(&crc16(payload).to_be_bytes());
    packet.push(STOP);
    packet
}
