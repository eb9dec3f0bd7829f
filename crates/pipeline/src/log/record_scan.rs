//! Where are the records of a file? It is read from record to record by their lengths, without their contents.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::{Context, Result};
use localize::{Stamp, input_file};
use mcap::records::op;

use super::mcap_encoding::RECORD_HEADER_BYTES;
use super::mcap_records::MAX_RECORD_BYTES;

/// Size of the two times at the start of a chunk record, bytes.
const CHUNK_TIMES_BYTES: usize = 16;

/// A chunk of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChunkInfo {
    pub(super) offset: u64,
    pub(super) length: u64,
    /// Time of its first message.
    pub start: Stamp,
    /// Time of its last message.
    pub end: Stamp,
}

/// A record outside chunks.
pub(super) struct RecordPlace {
    pub(super) opcode: u8,
    /// Its start, bytes from the start of the file.
    pub(super) offset: u64,
    /// Length of its content, bytes.
    pub(super) length: u64,
}

/// Visits the complete records of a file up to the first one of an impossible length.
///
/// `visit` may read from the start of the content, and returns how many bytes it has read.
pub(super) fn scan_records(
    path: &Path,
    mut visit: impl FnMut(&RecordPlace, &mut BufReader<File>) -> Result<u64>,
) -> Result<()> {
    let file = input_file::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    let size = file.metadata()?.len();
    let mut file = BufReader::new(file);
    let mut offset = mcap::MAGIC.len() as u64;
    file.seek(SeekFrom::Start(offset))?;
    loop {
        let mut prefix = [0; RECORD_HEADER_BYTES];
        if file.read_exact(&mut prefix).is_err() {
            return Ok(());
        }
        let [opcode, length @ ..] = prefix;
        let length = u64::from_le_bytes(length);
        let whole = (RECORD_HEADER_BYTES as u64).saturating_add(length);
        if length > MAX_RECORD_BYTES || offset + whole > size {
            return Ok(());
        }
        let place = RecordPlace {
            opcode,
            offset,
            length,
        };
        let passed = visit(&place, &mut file)?;
        file.seek_relative((length - passed) as i64)?;
        offset += whole;
    }
}

/// Finds the complete chunks of a file without a summary.
pub(super) fn scan_chunks(path: &Path) -> Result<Vec<ChunkInfo>> {
    let mut parts = Vec::new();
    scan_records(path, |record, file| {
        if record.opcode != op::CHUNK || record.length < CHUNK_TIMES_BYTES as u64 {
            return Ok(0);
        }
        let mut times = [0; CHUNK_TIMES_BYTES];
        file.read_exact(&mut times)?;
        let time = |at: usize| {
            let mut bytes = [0; 8];
            bytes.copy_from_slice(&times[at..at + 8]);
            stamp_from_log_time(u64::from_le_bytes(bytes))
        };
        parts.push(ChunkInfo {
            offset: record.offset,
            length: RECORD_HEADER_BYTES as u64 + record.length,
            start: time(0),
            end: time(8),
        });
        Ok(CHUNK_TIMES_BYTES as u64)
    })?;
    Ok(parts)
}

pub(super) fn stamp_from_log_time(log_time: u64) -> Stamp {
    Stamp(i64::try_from(log_time).unwrap_or(i64::MAX))
}
