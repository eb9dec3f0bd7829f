//! How is the file of a table read? Up to a size, with the line of each record.

use std::cell::{Cell, RefCell};
use std::fs::File;
use std::io::{Error, ErrorKind, Read};
use std::rc::Rc;

/// Largest table, bytes: four hours of wheels at 1 kHz.
const TABLE_BYTES_MAX: u64 = 1 << 30;

/// First byte of a line that is a comment.
pub(crate) const COMMENT: u8 = b'#';

/// Longest record, bytes: an open quotation mark makes one record of all that follows.
const RECORD_BYTES_MAX: usize = 1 << 20;

/// A table's file, which ends with an error where it or one of its records is too long.
pub(crate) struct TableInput {
    file: File,
    bytes: u64,
    progress: ReadingProgress,
}

/// How far a table has been read: shared by its file and its reader.
#[derive(Clone)]
pub(crate) struct ReadingProgress {
    /// Bytes since the reader's last complete record; the reader buffers some more.
    since_record: Rc<Cell<usize>>,
    lines: Rc<RefCell<RecordLines>>,
}

impl ReadingProgress {
    /// At the start of a file.
    pub(crate) fn new() -> Self {
        ReadingProgress {
            since_record: Rc::default(),
            lines: Rc::new(RefCell::new(RecordLines::new())),
        }
    }

    /// The reader has a complete record.
    pub(crate) fn end_record(&self) {
        self.since_record.set(0);
    }

    /// Line of a record, the header counted as 0, if each record has one line.
    pub(crate) fn line_of_record(&self, index: usize) -> u64 {
        self.lines.borrow().of_record(index)
    }
}

impl TableInput {
    /// Reads a file from its start.
    pub(crate) fn new(file: File, progress: ReadingProgress) -> Self {
        TableInput {
            file,
            bytes: 0,
            progress,
        }
    }
}

/// Numbers of the lines that hold records: not the empty ones and the comments, which the CSV reader skips without counting
/// them for the record behind them.
struct RecordLines {
    numbers: Vec<u32>,
    current: u32,
    last_byte: u8,
}

impl RecordLines {
    fn new() -> Self {
        RecordLines {
            numbers: Vec::new(),
            current: 0,
            last_byte: b'\n',
        }
    }

    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let is_first = matches!(self.last_byte, b'\n' | b'\r');
            let ends_pair = self.last_byte == b'\r' && byte == b'\n';
            if is_first && !ends_pair {
                self.current = self.current.saturating_add(1);
                if !matches!(byte, COMMENT | b'\n' | b'\r') {
                    self.numbers.push(self.current);
                }
            }
            self.last_byte = byte;
        }
    }

    /// Line of a record, the header counted as 0.
    fn of_record(&self, index: usize) -> u64 {
        self.numbers
            .get(index)
            .copied()
            .unwrap_or(self.current)
            .into()
    }
}

impl Read for TableInput {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.file.read(buffer)?;
        let ReadingProgress {
            since_record,
            lines,
        } = &self.progress;
        lines.borrow_mut().add(&buffer[..read]);
        self.bytes += read as u64;
        since_record.set(since_record.get() + read);
        let too_long = |what: &str, most: u64| {
            let reason = format!("{what} is longer than {most} bytes");
            Err(Error::new(ErrorKind::InvalidData, reason))
        };
        if self.bytes > TABLE_BYTES_MAX {
            return too_long("the table", TABLE_BYTES_MAX);
        }
        if since_record.get() > RECORD_BYTES_MAX {
            return too_long("a record", RECORD_BYTES_MAX as u64);
        }
        Ok(read)
    }
}
