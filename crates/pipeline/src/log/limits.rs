//! How much may a log unpack to? Limits for chunks and messages, so that a small file cannot exhaust the memory.

use anyhow::{Result, ensure};
use mcap::records::ChunkHeader;

/// Largest unpacked chunk, bytes: docs/log.md. Mirrorball writes chunks of at most 1 MiB and one message.
pub(super) const CHUNK_BYTES_MAX: u64 = 64 * 1024 * 1024;
/// Unpacked size that every chunk may have, whatever its packed size, bytes. Images of one colour shrink a thousandfold.
const CHUNK_BYTES_FREE: u64 = 8 * 1024 * 1024;
/// Largest ratio of unpacked to packed bytes of a larger chunk.
const CHUNK_RATIO_MAX: u64 = 200;
/// Largest number of records in a chunk. Each costs memory beyond its bytes.
pub(super) const CHUNK_RECORDS_MAX: usize = 500_000;
/// Largest number of fields of a message, nested ones included. Minutes without an image stay below it.
const MESSAGE_FIELDS_MAX: usize = 200_000;
/// Largest number of fields of the messages that a reader holds at a time.
const FIELDS_HELD_MAX: usize = 1_000_000;
/// Depth to which nested messages are counted. Those of Mirrorball have at most four levels.
const DEPTH_MAX: u32 = 6;

/// A part of the file is intact, and larger than this program reads.
#[derive(Debug, thiserror::Error)]
#[error("{0}: more than this program reads ({1}, see docs/log.md)")]
pub(super) struct BeyondLimit(pub(super) String, pub(super) String);

/// Errors if a chunk says that it unpacks to more than allowed.
pub(super) fn check_chunk(header: &ChunkHeader, packed_bytes: usize) -> Result<()> {
    let allowed = CHUNK_RATIO_MAX
        .saturating_mul(packed_bytes as u64)
        .clamp(CHUNK_BYTES_FREE, CHUNK_BYTES_MAX);
    let size = header.uncompressed_size;
    ensure!(
        size <= allowed,
        BeyondLimit(
            format!("a chunk of {packed_bytes} bytes that unpacks to {size}"),
            format!("{allowed} bytes")
        )
    );
    Ok(())
}

/// Counts the fields of messages before they are decoded.
///
/// An empty nested message has two bytes, and a hundred times as many when decoded.
#[derive(Default)]
pub(super) struct FieldBudget {
    used: usize,
}

impl FieldBudget {
    /// Errors if this message, or all messages so far, have too many fields.
    pub(super) fn add_message(&mut self, message: &[u8]) -> Result<()> {
        let fields = check_message(message)?;
        self.used += fields;
        ensure!(
            self.used <= FIELDS_HELD_MAX,
            "messages of a chunk with more than {FIELDS_HELD_MAX} fields"
        );
        Ok(())
    }
}

/// Number of a message's fields. Errors if they are too many.
pub(super) fn check_message(message: &[u8]) -> Result<usize> {
    let mut count = 0;
    count_fields(message, 0, &mut count);
    ensure!(
        count <= MESSAGE_FIELDS_MAX,
        "a message with more than {MESSAGE_FIELDS_MAX} fields"
    );
    Ok(count)
}

/// Adds the fields of a protobuf message. False if the bytes are no message; the count then includes what was read.
///
/// Bytes that happen to read as a nested message are counted as one. Texts and packed numbers seldom do.
fn count_fields(mut message: &[u8], depth: u32, count: &mut usize) -> bool {
    while !message.is_empty() && *count <= MESSAGE_FIELDS_MAX {
        let Some(tag) = read_varint(&mut message) else {
            return false;
        };
        if tag >> 3 == 0 {
            return false;
        }
        *count += 1;
        let bytes = match tag & 7 {
            0 => read_varint(&mut message).map(|_| 0),
            1 => Some(8),
            2 => read_varint(&mut message),
            5 => Some(4),
            _ => None,
        };
        let Some(content) = bytes
            .and_then(|bytes| usize::try_from(bytes).ok())
            .and_then(|bytes| message.split_at_checked(bytes))
        else {
            return false;
        };
        message = content.1;
        if tag & 7 == 2 && depth < DEPTH_MAX {
            let mut inner = 0;
            if count_fields(content.0, depth + 1, &mut inner) {
                *count += inner;
            }
        }
    }
    true
}

fn read_varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for place in 0..10 {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << (7 * place);
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use prost::Message;

    use super::*;
    use crate::log::schema::{convert, wire};
    use crate::testing::random_cycle;

    #[test]
    fn message_of_many_empty_reports_is_refused_before_it_is_decoded() {
        let reports = vec![wire::TeamReport::default(); 300_000];
        let cycle = wire::Cycle {
            reports,
            ..wire::Cycle::default()
        };
        assert!(check_message(&cycle.encode_to_vec()).is_err());
    }

    #[test]
    fn ordinary_cycle_stays_far_below_the_limits() {
        let cycle = random_cycle(3);
        let message = convert::cycle_to_wire(0, &cycle, "png").encode_to_vec();
        let fields = check_message(&message).expect("allowed");
        assert!(fields > 20 && fields < 10_000, "{fields}");
        let minutes = wire::Cycle {
            imu: vec![wire::Imu::default(); 12_000],
            ..wire::Cycle::default()
        };
        assert!(check_message(&minutes.encode_to_vec()).is_ok());
    }
}
