//! What does a WitMotion sensor send? Acceleration, angular rate, angles and magnetic field, 11 bytes each.
//!
//! `55 type d0..d7 sum`: four i16 LE, the sum of the first ten bytes last (WitMotion, normal protocol).

use super::decoder::{DecodeError, ParseStep, StreamDecoder, skip_to};
use super::{STANDARD_GRAVITY, checksum8};

/// Bytes of one message.
pub const BYTES: usize = 11;
const HEADER: u8 = 0x55;

/// Content of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DataType {
    /// Specific force x, y, z; 16 g at 32768.
    Acceleration,
    /// Angular rate about x, y, z; 2000 °/s at 32768.
    AngularRate,
    /// Roll, pitch, yaw; 180° at 32768.
    Angle,
    /// Magnetic field x, y, z, unit of the sensor.
    MagneticField,
    /// Another message (time, ports, pressure, position...) by its type byte.
    Other(u8),
}

impl DataType {
    /// SI value of a raw 32768: m/s², rad/s or radians; for other data that of raw units.
    pub fn full_scale(self) -> f32 {
        match self {
            DataType::Acceleration => 16.0 * STANDARD_GRAVITY,
            DataType::AngularRate => 2000.0_f32.to_radians(),
            DataType::Angle => std::f32::consts::PI,
            DataType::MagneticField | DataType::Other(_) => 32768.0,
        }
    }
}

/// One message, sensor axes and units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wit {
    /// Type of the data.
    pub kind: DataType,
    /// Three values, and for most types the temperature.
    pub raw: [i16; 4],
}

/// A decoder of the sensor's stream.
pub fn decoder() -> StreamDecoder<Wit> {
    StreamDecoder::new(parse)
}

/// Classifies the front of `bytes`.
pub fn parse(bytes: &[u8]) -> ParseStep<Wit> {
    let begins = |byte| byte == HEADER;
    if bytes.first() != Some(&HEADER) {
        return skip_to(bytes, begins, DecodeError::Noise);
    }
    // Types are 0x50 to 0x5F: with another byte after the header this is no message, and no more bytes are needed.
    if bytes.get(1).is_some_and(|kind| kind >> 4 != 5) {
        return skip_to(bytes, begins, DecodeError::Noise);
    }
    let Some(frame) = bytes.get(..BYTES) else {
        return ParseStep::Incomplete;
    };
    if checksum8(&frame[..BYTES - 1]) != frame[BYTES - 1] {
        return skip_to(bytes, begins, DecodeError::Checksum);
    }
    let kind = match frame[1] {
        0x51 => DataType::Acceleration,
        0x52 => DataType::AngularRate,
        0x53 => DataType::Angle,
        0x54 => DataType::MagneticField,
        other => DataType::Other(other),
    };
    let value = |at: usize| i16::from_le_bytes([frame[at], frame[at + 1]]);
    let raw = [value(2), value(4), value(6), value(8)];
    ParseStep::Message(BYTES, Wit { kind, raw })
}

impl Wit {
    /// The first three values in SI units (m/s², rad/s, radians), or raw if the type has no scale.
    pub fn si(&self) -> [f32; 3] {
        let full_scale = self.kind.full_scale();
        [0, 1, 2].map(|axis| f32::from(self.raw[axis]) / 32768.0 * full_scale)
    }

    /// The message as the sensor sends it.
    pub fn encode(&self) -> [u8; BYTES] {
        let mut frame = [0; BYTES];
        frame[0] = HEADER;
        frame[1] = match self.kind {
            DataType::Acceleration => 0x51,
            DataType::AngularRate => 0x52,
            DataType::Angle => 0x53,
            DataType::MagneticField => 0x54,
            DataType::Other(kind) => kind,
        };
        for (bytes, value) in frame[2..10].chunks_exact_mut(2).zip(self.raw) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        frame[BYTES - 1] = checksum8(&frame[..BYTES - 1]);
        frame
    }
}
