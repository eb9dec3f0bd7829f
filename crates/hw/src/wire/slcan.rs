//! How are CAN frames sent over a serial port? The ASCII format of LAWICEL's adapters, which Linux calls slcan.
//!
//! `T`, 8 hex digits of identifier, one of length, two per byte, carriage return; `t` has three digits of identifier; `R`
//! and `r` are remote frames. There is no checksum: a line is accepted only if every character is valid.

use super::can::CanFrame;
use super::decoder::{DecodeError, ParseStep, StreamDecoder};

/// Longest line: T, 8 + 1 + 16 digits, 4 of a time stamp, carriage return.
const LINE_BYTES_MAX: usize = 31;
const CARRIAGE_RETURN: u8 = b'\r';
const BELL: u8 = 7;

/// A message of the adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlcanMessage {
    /// A frame from the bus.
    Frame(CanFrame),
    /// The command succeeded.
    Ack,
    /// The command failed.
    Nack,
    /// Another valid answer (version, serial number, status) by its first letter.
    Other(u8),
}

/// A decoder of the adapter's stream.
pub fn decoder() -> StreamDecoder<SlcanMessage> {
    StreamDecoder::new(parse)
}

/// Classifies the front of `bytes`.
pub fn parse(bytes: &[u8]) -> ParseStep<SlcanMessage> {
    match bytes.first() {
        None => return ParseStep::Incomplete,
        Some(&CARRIAGE_RETURN) => return ParseStep::Message(1, SlcanMessage::Ack),
        Some(&BELL) => return ParseStep::Message(1, SlcanMessage::Nack),
        Some(_) => {}
    }
    let front = &bytes[..bytes.len().min(LINE_BYTES_MAX)];
    let stop = |byte: &u8| matches!(*byte, CARRIAGE_RETURN | BELL);
    let Some(length) = front.iter().position(stop) else {
        if front.len() < LINE_BYTES_MAX {
            return ParseStep::Incomplete;
        }
        return ParseStep::Skip(LINE_BYTES_MAX, Some(DecodeError::Length));
    };
    if bytes[length] == BELL {
        // A bell does not end a line: the bytes before it are a truncated line, and the bell is an answer of its own.
        return ParseStep::Skip(length, Some(DecodeError::Noise));
    }
    match parse_line(&bytes[..length]) {
        Some(line) => ParseStep::Message(length + 1, line),
        None => ParseStep::Skip(length + 1, Some(DecodeError::Noise)),
    }
}

fn parse_line(line: &[u8]) -> Option<SlcanMessage> {
    let (letter, digits) = line.split_first()?;
    let (extended, remote, id_digits) = match letter {
        b'T' => (true, false, 8),
        b'R' => (true, true, 8),
        b't' => (false, false, 3),
        b'r' => (false, true, 3),
        b'z' | b'Z' if digits.is_empty() => return Some(SlcanMessage::Ack),
        b'V' | b'v' | b'N' | b'F' if digits.iter().all(u8::is_ascii_alphanumeric) => {
            return Some(SlcanMessage::Other(*letter));
        }
        _ => return None,
    };
    let id = hex(digits.get(..id_digits)?)?;
    let length = hex(digits.get(id_digits..=id_digits)?)? as usize;
    let rest = &digits[id_digits + 1..];
    if remote {
        let has_stamp = rest.len() == 4 && hex(rest).is_some();
        return (rest.is_empty() || has_stamp)
            .then(|| CanFrame::remote(id, extended, length))?
            .map(SlcanMessage::Frame);
    }
    let mut data = [0; 8];
    for (byte, pair) in data
        .get_mut(..length)?
        .iter_mut()
        .zip(rest.get(..2 * length)?.chunks_exact(2))
    {
        *byte = u8::try_from(hex(pair)?).ok()?;
    }
    // Adapters in mode Z1 append a time stamp of four digits.
    let stamp = &rest[2 * length..];
    if !(stamp.is_empty() || stamp.len() == 4 && hex(stamp).is_some()) {
        return None;
    }
    CanFrame::new(id, extended, &data[..length]).map(SlcanMessage::Frame)
}

fn hex(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0u32, |value, digit| {
        Some((value << 4) | char::from(*digit).to_digit(16)?)
    })
}

/// Appends the line of `frame`.
pub fn encode(frame: &CanFrame, out: &mut Vec<u8>) {
    let letter = match (frame.extended, frame.remote) {
        (true, false) => 'T',
        (true, true) => 'R',
        (false, false) => 't',
        (false, true) => 'r',
    };
    let width = if frame.extended { 8 } else { 3 };
    let head = format!("{letter}{:0width$X}{}", frame.id, frame.data().len());
    out.extend_from_slice(head.as_bytes());
    if !frame.remote {
        for byte in frame.data() {
            out.extend_from_slice(format!("{byte:02X}").as_bytes());
        }
    }
    out.push(CARRIAGE_RETURN);
}

/// The commands that close the adapter's channel, set its bit rate and open it; `None` for an unsupported rate.
///
/// S0 to S8 are 10, 20, 50, 100, 125, 250, 500, 800 kbit/s and 1 Mbit/s. The first, empty line ends a partial command.
pub fn open_channel_commands(bit_rate: u32) -> Option<Vec<u8>> {
    const RATES_KBIT: [u32; 9] = [10, 20, 50, 100, 125, 250, 500, 800, 1000];
    let code = RATES_KBIT.iter().position(|rate| rate * 1000 == bit_rate)?;
    Some(format!("\rC\rS{code}\rO\r").into_bytes())
}
