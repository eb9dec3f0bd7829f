//! What does a VESC say over its UART? Packets `02 length payload crc16 03`, the first byte of the payload the command.
//!
//! Numbers are big-endian. Layouts: VESC firmware, commands.c (COMM_GET_VALUES, firmware 3.40 and later). A controller
//! hands on what is wrapped in COMM_FORWARD_CAN to another one on its CAN bus, and the answer comes back unwrapped with
//! that one's number in it.

use super::crc16;
use super::decoder::{DecodeError, ParseStep, StreamDecoder, skip_to};

const START: u8 = 2;
const STOP: u8 = 3;
const GET_VALUES: u8 = 4;
const SET_CURRENT: u8 = 6;
const SET_RPM: u8 = 8;
const FORWARD_CAN: u8 = 34;
/// Bytes of the answer to GET_VALUES up to and with the controller's number; newer firmware appends more.
const VALUES_BYTES: usize = 59;

/// What a controller is told or asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Say how you are.
    GetValues,
    /// Turn at so many electrical revolutions per minute.
    SetRpm(i32),
    /// Drive this current through the motor; 0 lets it coast.
    SetCurrentMa(i32),
}

/// What a controller answers to [`Request::GetValues`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Values {
    /// Number of the controller on the CAN bus.
    pub node: u8,
    /// Speed, electrical revolutions per minute.
    pub erpm: i32,
    /// Steps of the motor since power-on, six per electrical revolution, wrapping.
    pub tachometer: i32,
    /// Supply, 0.1 V.
    pub voltage_dv: i16,
    /// Current through the motor, 0.01 A.
    pub motor_current_ca: i32,
    /// Temperature of the transistors, 0.1 °C.
    pub temperature_ddeg: i16,
    /// Fault code, 0 for none.
    pub fault: u8,
}

/// What a controller sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reply {
    /// The answer to [`Request::GetValues`].
    Values(Values),
    /// Another whole packet, by its command byte.
    Other(u8),
}

/// A decoder of the controller's stream.
pub fn decoder() -> StreamDecoder<Reply> {
    StreamDecoder::new(parse)
}

/// What the front of `bytes` is.
///
/// Packets above 255 bytes (start byte 3) carry configurations and firmware, which nobody here asks for.
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
    /// The packet as a controller sends it, fields that are not held here being zero.
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
    /// The packet that tells the controller at the other end of the UART.
    pub fn encode(self) -> Vec<u8> {
        encode_packet(&self.payload())
    }

    /// The packet that has the controller at the other end hand it on to `node` on its CAN bus.
    pub fn encode_forwarded(self, node: u8) -> Vec<u8> {
        let mut payload = vec![FORWARD_CAN, node];
        payload.extend_from_slice(&self.payload());
        encode_packet(&payload)
    }

    /// What a packet asks, and of which other node; `None` for what is not spoken here. For whoever plays a controller.
    pub fn decode(packet: &[u8]) -> Option<(Option<u8>, Request)> {
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
        Some((node, request))
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

/// `02 length payload crc16 03`; the payload has at most 255 bytes.
fn encode_packet(payload: &[u8]) -> Vec<u8> {
    let mut packet = vec![START, payload.len() as u8];
    packet.extend_from_slice(payload);
    packet.extend_from_slice(&crc16(payload).to_be_bytes());
    packet.push(STOP);
    packet
}
