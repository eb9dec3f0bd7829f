//! What do the bytes on a wire mean? Pure codecs: bytes to messages and back.
//!
//! Nothing here reads a port or a clock. Every decoder is a [`StreamDecoder`] over its protocol's `parse` function. It
//! accepts bytes however they are split, joined or damaged, and yields only messages with a correct checksum.

pub mod bno085;
pub mod board;
pub mod can;
mod cobs;
pub mod decoder;
pub mod image_stream;
pub mod slcan;
pub mod vesc;
pub mod vesc_can;
pub mod wit;

pub use can::CanFrame;
pub use decoder::{DecodeError, DecoderStats, ParseStep, StreamDecoder};
/// Standard gravity, m/s² (ISO 80000-3).
pub use localize::sensors::attitude::GRAVITY as STANDARD_GRAVITY;

/// CRC-16/XMODEM (polynomial 0x1021, start 0, most significant bit first), of VESC and base board packets.
pub fn crc16(bytes: &[u8]) -> u16 {
    const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_XMODEM);
    CRC.checksum(bytes)
}

/// Low byte of the sum of all bytes, the checksum of the inertial sensors.
fn checksum8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}
