//! What do the bytes on a wire mean? Pure codecs: bytes in, messages out, and the other way round.
//!
//! Nothing here reads a port or a clock. Every decoder is a [`Stream`] over a `parse` function of its protocol; it takes
//! the bytes as they come, however split, joined or damaged, and yields only messages whose checksum is right.

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
pub const STANDARD_GRAVITY: f32 = 9.806_65;

/// CRC-16/XMODEM (polynomial 0x1021, start 0, most significant bit first): VESC's packets and our base board's.
pub fn crc16(bytes: &[u8]) -> u16 {
    const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_XMODEM);
    CRC.checksum(bytes)
}
