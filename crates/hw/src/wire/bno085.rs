//! What does a BNO085 send in UART-RVC mode? Attitude and acceleration at 100 Hz and 115200 baud.
//!
//! 19 bytes: `AA AA index yaw pitch roll ax ay az 0 0 0 sum`; the six values are i16 LE in 0.01° and mg; sum is the low
//! byte of the sum from index to the last zero (CEVA, BNO08X data sheet, UART-RVC).

use super::checksum8;
use super::decoder::{DecodeError, ParseStep, StreamDecoder, skip_to};

/// Bytes of one message.
pub const BYTES: usize = 19;
const HEADER: u8 = 0xAA;

/// One message, sensor axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rvc {
    /// Message counter, wrapping.
    pub index: u8,
    /// About z, 0.01°, −180° to 180°; relative to power-on, not to north.
    pub yaw_cdeg: i16,
    /// About y, 0.01°.
    pub pitch_cdeg: i16,
    /// About x, 0.01°.
    pub roll_cdeg: i16,
    /// Specific force along x, y, z, thousandths of standard gravity.
    pub acceleration_mg: [i16; 3],
}

/// A decoder of the sensor's stream.
pub fn decoder() -> StreamDecoder<Rvc> {
    StreamDecoder::new(parse)
}

/// Classifies the front of `bytes`.
pub fn parse(bytes: &[u8]) -> ParseStep<Rvc> {
    if bytes.first() != Some(&HEADER) || bytes.get(1).is_some_and(|byte| *byte != HEADER) {
        return skip_to(bytes, |byte| byte == HEADER, DecodeError::Noise);
    }
    let Some(frame) = bytes.get(..BYTES) else {
        return ParseStep::Incomplete;
    };
    if checksum8(&frame[2..BYTES - 1]) != frame[BYTES - 1] {
        return skip_to(bytes, |byte| byte == HEADER, DecodeError::Checksum);
    }
    let value = |at: usize| i16::from_le_bytes([frame[at], frame[at + 1]]);
    let message = Rvc {
        index: frame[2],
        yaw_cdeg: value(3),
        pitch_cdeg: value(5),
        roll_cdeg: value(7),
        acceleration_mg: [value(9), value(11), value(13)],
    };
    ParseStep::Message(BYTES, message)
}

impl Rvc {
    /// The message as the sensor sends it.
    pub fn encode(&self) -> [u8; BYTES] {
        let mut frame = [0; BYTES];
        frame[..3].copy_from_slice(&[HEADER, HEADER, self.index]);
        let [ax, ay, az] = self.acceleration_mg;
        let values = [self.yaw_cdeg, self.pitch_cdeg, self.roll_cdeg, ax, ay, az];
        for (bytes, value) in frame[3..15].chunks_exact_mut(2).zip(values) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        frame[BYTES - 1] = checksum8(&frame[2..BYTES - 1]);
        frame
    }
}
