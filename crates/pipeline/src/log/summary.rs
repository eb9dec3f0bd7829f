//! What does the end of a complete file tell? Its channels and schemas, and where its chunks are.

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use localize::input_file;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};

use super::mcap_records::MAX_RECORD_BYTES;

/// Size of a footer's content: start of the summary, start of its offsets, checksum.
const FOOTER_BYTES: u64 = 20;
/// Size of the footer's checksum, bytes.
const CHECKSUM_BYTES: u64 = 4;

/// A complete log of another writer, whose messages lie outside chunks.
#[derive(Debug, thiserror::Error)]
#[error(
    "{}: its messages are not in chunks, which `mirrorball replay` alone reads: `mirrorball recover {} --out COPY.mcap` writes them in chunks",
    .0.display(), .0.display()
)]
pub(super) struct WithoutChunks(PathBuf);

/// Reads the summary at the end of a complete file. None without one. Errors for a file without chunks.
pub(super) fn read_summary(path: &Path) -> Result<Option<mcap::Summary>> {
    let Some(summary) = parse_summary(path)? else {
        return Ok(None);
    };
    let is_counted =
        |stats: &mcap::records::Statistics| stats.message_count > 0 && stats.chunk_count == 0;
    if summary.chunk_indexes.is_empty() && summary.stats.as_ref().is_some_and(is_counted) {
        bail!(WithoutChunks(path.to_owned()));
    }
    Ok((!summary.chunk_indexes.is_empty()).then_some(summary))
}

/// The summary of a file whose data are damaged. None if it is absent or damaged itself.
pub(super) fn intact_summary(path: &Path) -> Option<mcap::Summary> {
    let summary = parse_summary(path).ok().flatten()?;
    is_checksum_correct(path).ok()?.then_some(summary)
}

/// True if the summary has the checksum that the footer states, or the footer states none.
fn is_checksum_correct(path: &Path) -> Result<bool> {
    let mut file = input_file::open(path)?;
    let end = file.metadata()?.len() - mcap::MAGIC.len() as u64;
    let mut footer = [0; FOOTER_BYTES as usize];
    file.seek(SeekFrom::Start(end - FOOTER_BYTES))?;
    file.read_exact(&mut footer)?;
    let [s0, s1, s2, s3, s4, s5, s6, s7, .., c0, c1, c2, c3] = footer;
    let start = u64::from_le_bytes([s0, s1, s2, s3, s4, s5, s6, s7]);
    let stated = u32::from_le_bytes([c0, c1, c2, c3]);
    let length = (end - CHECKSUM_BYTES).saturating_sub(start);
    if stated == 0 || length > MAX_RECORD_BYTES {
        return Ok(stated == 0);
    }
    let mut bytes = vec![0; length as usize];
    file.seek(SeekFrom::Start(start))?;
    file.read_exact(&mut bytes)?;
    Ok(crc32fast::hash(&bytes) == stated)
}

fn parse_summary(path: &Path) -> Result<Option<mcap::Summary>> {
    let mut file = BufReader::new(input_file::open(path)?);
    let size = file.get_ref().metadata()?.len();
    let options = SummaryReaderOptions::default()
        .with_file_size(size)
        .with_record_length_limit(MAX_RECORD_BYTES as usize);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    Ok(reader.finish())
}
