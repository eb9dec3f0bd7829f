//! Which records does an MCAP file contain? They are read one by one, with one chunk in memory. A truncated file is
//! read to its last complete chunk.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use localize::input_file;
use mcap::read::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::limits::{BeyondLimit, CHUNK_BYTES_MAX, CHUNK_RECORDS_MAX, check_chunk};
use super::mcap_encoding::RECORD_HEADER_BYTES;

/// Longest accepted record, bytes. A longer one has a damaged length and is not allocated.
pub(super) const MAX_RECORD_BYTES: u64 = 256 * 1024 * 1024;

/// What to do about a damaged file, for readers that cannot skip the damage.
pub(super) const RECOVER_HINT: &str = "`mirrorball recover` saves what can be read";

/// Decodes a chunk for a reader that cannot skip it.
pub(super) fn decode_needed_chunk(body: &[u8]) -> Result<VecDeque<Record<'static>>> {
    decode_chunk(body).map_err(|error| {
        if error.is::<BeyondLimit>() {
            return error;
        }
        anyhow!("{error}; {RECOVER_HINT}")
    })
}

/// An unreadable part of the file. Reading continues after it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DamagedRange {
    /// Start of the part, bytes from the start of the file.
    pub(super) offset: u64,
    /// Description of the damage.
    pub(super) reason: String,
    /// True if the part is intact and larger than this program reads.
    pub(super) is_beyond_limit: bool,
}

impl DamagedRange {
    /// The error for readers that cannot skip it.
    pub(super) fn to_error(&self, path: &Path) -> anyhow::Error {
        if self.is_beyond_limit {
            return anyhow!(
                "{} has at byte {} {}. Write the file again with smaller chunks",
                path.display(),
                self.offset,
                self.reason
            );
        }
        anyhow!(
            "{} is damaged at byte {}: {}; {RECOVER_HINT}",
            path.display(),
            self.offset,
            self.reason
        )
    }
}

/// How a file ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogCompleteness {
    /// With index and summary: the writer was closed.
    Complete,
    /// Without summary: the writer was killed, or the copy is incomplete.
    Truncated,
}

/// The records of an MCAP file up to the end of its data section, chunks decompressed.
pub(super) struct RecordReader {
    path: PathBuf,
    file: BufReader<File>,
    size: u64,
    offset: u64,
    /// Starts of the chunks by the file's index, ascending. After a damaged length, reading continues at the next one.
    chunk_starts: VecDeque<u64>,
    chunk: VecDeque<Record<'static>>,
    end: Option<LogCompleteness>,
    /// Opcode of the record within which the file ended.
    cut_record: Option<u8>,
}

impl RecordReader {
    /// Opens an MCAP file.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let file =
            input_file::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let size = file
            .metadata()
            .with_context(|| format!("cannot read {}", path.display()))?
            .len();
        let mut file = BufReader::new(file);
        let mut magic = Vec::new();
        (&mut file)
            .take(mcap::MAGIC.len() as u64)
            .read_to_end(&mut magic)
            .with_context(|| format!("cannot read {}", path.display()))?;
        ensure!(magic == mcap::MAGIC, "{} is no MCAP file", path.display());
        let offset = magic.len() as u64;
        Ok(RecordReader {
            path: path.to_owned(),
            file,
            size,
            offset,
            chunk_starts: VecDeque::new(),
            chunk: VecDeque::new(),
            end: None,
            cut_record: None,
        })
    }

    /// Gives the starts of the file's chunks, so that reading can continue after a damaged length.
    pub(super) fn set_chunk_starts(&mut self, starts: impl Iterator<Item = u64>) {
        self.chunk_starts = starts.collect();
        self.chunk_starts.make_contiguous().sort_unstable();
    }

    /// How the file ended. None before the end is read.
    pub(super) fn end(&self) -> Option<LogCompleteness> {
        self.end
    }

    /// True if the file ended within an attachment: a file of the run's set-up.
    pub(super) fn is_cut_within_attachment(&self) -> bool {
        self.cut_record == Some(op::ATTACHMENT)
    }

    /// The next record, None at the end. After an error for a damaged part, reading can continue.
    pub(super) fn next_record(&mut self) -> Result<Option<Record<'static>>, DamagedRange> {
        loop {
            if let Some(record) = self.chunk.pop_front() {
                return Ok(Some(record));
            }
            if self.end.is_some() {
                return Ok(None);
            }
            let offset = self.offset;
            let Some((opcode, body)) = self.read_record()? else {
                self.end = Some(LogCompleteness::Truncated);
                return Ok(None);
            };
            let damage = |reason: String| DamagedRange {
                offset,
                reason,
                is_beyond_limit: false,
            };
            if opcode == op::ATTACHMENT && !is_complete_attachment(&body) {
                return Err(damage("a broken attachment".to_owned()));
            }
            if opcode == op::CHUNK {
                self.chunk = decode_chunk(&body).map_err(|error| DamagedRange {
                    is_beyond_limit: error.is::<BeyondLimit>(),
                    ..damage(error.to_string())
                })?;
                continue;
            }
            match parse_record(opcode, &body).map_err(|error| damage(error.to_string()))? {
                Record::DataEnd(_) => self.end = Some(self.read_rest()?),
                Record::MessageIndex(_) | Record::Unknown { .. } => {}
                record => return Ok(Some(record.into_owned())),
            }
        }
    }

    /// Reads what follows the data: index and summary up to the footer, and the magic bytes, unless the file was cut.
    fn read_rest(&mut self) -> Result<LogCompleteness, DamagedRange> {
        loop {
            let mut prefix = [0; RECORD_HEADER_BYTES];
            if !self.fill(&mut prefix)? {
                return Ok(LogCompleteness::Truncated);
            }
            let [opcode, length @ ..] = prefix;
            let length = u64::from_le_bytes(length);
            let passed = std::io::copy(&mut (&mut self.file).take(length), &mut std::io::sink());
            let passed = passed.map_err(|error| self.io_damage(&error))?;
            self.offset += RECORD_HEADER_BYTES as u64 + passed;
            if passed != length {
                return Ok(LogCompleteness::Truncated);
            }
            if opcode == op::FOOTER {
                break;
            }
        }
        let mut magic = [0; mcap::MAGIC.len()];
        if !self.fill(&mut magic)? || magic != mcap::MAGIC {
            return Ok(LogCompleteness::Truncated);
        }
        self.offset += magic.len() as u64;
        if !self.fill(&mut [0])? {
            return Ok(LogCompleteness::Complete);
        }
        self.end = Some(LogCompleteness::Complete);
        Err(DamagedRange {
            offset: self.offset,
            reason: "the log ends, and more follows: of joined logs the first one is read"
                .to_owned(),
            is_beyond_limit: false,
        })
    }

    // Opcode and bytes of a record. None if the file ends within it.
    fn read_record(&mut self) -> Result<Option<(u8, Vec<u8>)>, DamagedRange> {
        let mut prefix = [0; RECORD_HEADER_BYTES];
        if !self.fill(&mut prefix)? {
            return Ok(None);
        }
        let [opcode, length @ ..] = prefix;
        let length = u64::from_le_bytes(length);
        let next = self.offset.saturating_add(RECORD_HEADER_BYTES as u64);
        let next = next.saturating_add(length);
        if let Some(start) = self.next_chunk_start().filter(|start| next > *start) {
            return Err(self.skip_to(start, "a record that reaches into the next chunk", false));
        }
        if length > MAX_RECORD_BYTES && opcode == op::CHUNK && next <= self.size {
            let reason = BeyondLimit(
                format!("a chunk of {length} bytes"),
                format!("{MAX_RECORD_BYTES} bytes"),
            );
            return Err(self.skip_to(next, &reason.to_string(), true));
        }
        if length > MAX_RECORD_BYTES {
            // With this record's length, the start of the next one is unknown.
            self.end = Some(LogCompleteness::Truncated);
            let reason = format!("a record of {length} bytes, which none is");
            return Err(DamagedRange {
                offset: self.offset,
                reason,
                is_beyond_limit: false,
            });
        }
        let mut body = Vec::new();
        let read = (&mut self.file).take(length).read_to_end(&mut body);
        let read = read.map_err(|error| self.io_damage(&error))?;
        self.offset += (RECORD_HEADER_BYTES + read) as u64;
        if read as u64 != length {
            self.cut_record = Some(opcode);
            return Ok(None);
        }
        Ok(Some((opcode, body)))
    }

    /// The first start of a chunk behind the current record's.
    fn next_chunk_start(&mut self) -> Option<u64> {
        while self
            .chunk_starts
            .front()
            .is_some_and(|start| *start <= self.offset)
        {
            self.chunk_starts.pop_front();
        }
        self.chunk_starts.front().copied()
    }

    /// Reading continues at `next`, after a part that cannot be read.
    fn skip_to(&mut self, next: u64, reason: &str, is_beyond_limit: bool) -> DamagedRange {
        let offset = std::mem::replace(&mut self.offset, next);
        match self.file.seek(SeekFrom::Start(next)) {
            Ok(_) => DamagedRange {
                offset,
                reason: reason.to_owned(),
                is_beyond_limit,
            },
            Err(error) => self.io_damage(&error),
        }
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<bool, DamagedRange> {
        match self.file.read_exact(bytes) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
            Err(error) => Err(self.io_damage(&error)),
        }
    }

    fn io_damage(&mut self, error: &std::io::Error) -> DamagedRange {
        self.end = Some(LogCompleteness::Truncated);
        DamagedRange {
            offset: self.offset,
            reason: format!("cannot read {}: {error}", self.path.display()),
            is_beyond_limit: false,
        }
    }
}

/// Decodes the records of a chunk with a correct checksum. Errors if it unpacks to more than allowed.
pub(super) fn decode_chunk(body: &[u8]) -> Result<VecDeque<Record<'static>>> {
    let Record::Chunk { header, data } = parse_record(op::CHUNK, body)? else {
        return Err(anyhow!("not a chunk"));
    };
    check_chunk(&header, data.len())?;
    // The reader applies the limit to the whole chunk only if there is a checksum. Without one, the sum below does it.
    let mut remaining = header.uncompressed_size;
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(CHUNK_BYTES_MAX as usize);
    let mut reader = LinearReader::new_with_options(options);
    let prefix: Vec<u8> = [op::CHUNK]
        .into_iter()
        .chain((body.len() as u64).to_le_bytes())
        .collect();
    let mut source = prefix.as_slice().chain(body);
    let mut records = VecDeque::new();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = source.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode, data } => {
                let bytes = (RECORD_HEADER_BYTES + data.len()) as u64;
                remaining = remaining
                    .checked_sub(bytes)
                    .context("a chunk that unpacks to more than it says")?;
                ensure!(
                    records.len() < CHUNK_RECORDS_MAX,
                    BeyondLimit(
                        format!("a chunk of more than {CHUNK_RECORDS_MAX} records"),
                        format!("{CHUNK_RECORDS_MAX} records")
                    )
                );
                records.push_back(parse_record(opcode, data)?.into_owned());
            }
        }
    }
    Ok(records)
}

/// True if the parts of an attachment record fit into it. The parser does not check this.
pub(super) fn is_complete_attachment(body: &[u8]) -> bool {
    // Log and creation time, name, media type, data, checksum.
    let mut rest = body.get(16..);
    for _ in 0..2 {
        rest = rest.and_then(|rest| {
            let (length, text) = rest.split_first_chunk::<4>()?;
            text.get(u32::from_le_bytes(*length) as usize..)
        });
    }
    let data = rest.and_then(|rest| rest.split_first_chunk::<8>());
    data.is_some_and(|(length, data)| {
        u64::from_le_bytes(*length).checked_add(4) == Some(data.len() as u64)
    })
}
