//! Where do the bytes of a log and its index go while it is written? Into its file, counted, and into an unnamed one.

use std::fs::File;
use std::io::{BufWriter, Read, Result, Seek, SeekFrom, Write};
use std::path::Path;

use mcap::records::op;

use super::mcap_encoding::RecordEncoder;
use super::schema::file::LogFile;

/// Bytes that are copied at once from the index to the log.
const COPY_BYTES: usize = 1 << 16;

/// Index records of the chunks, in a file without a name that vanishes with the process.
pub(super) struct IndexFile {
    file: BufWriter<File>,
    /// Number of chunks.
    pub(super) count: u32,
}

impl IndexFile {
    /// Beside the log, or in the folder for temporary files if the log is a pipe or device.
    pub(super) fn create(path: &Path) -> Result<Self> {
        let folder = path.parent().filter(|_| path.is_file());
        let file = match folder {
            Some(folder) if folder.as_os_str().is_empty() => tempfile::tempfile_in("."),
            Some(folder) => tempfile::tempfile_in(folder),
            None => tempfile::tempfile(),
        };
        Ok(IndexFile {
            file: BufWriter::new(file?),
            count: 0,
        })
    }

    pub(super) fn add(&mut self, record: &[u8]) -> Result<()> {
        self.count += 1;
        self.file.write_all(record)
    }

    /// Appends the records to the log.
    pub(super) fn copy_to(self, out: &mut CountedFile) -> Result<()> {
        let mut file = self.file.into_inner()?;
        file.seek(SeekFrom::Start(0))?;
        let mut block = vec![0; COPY_BYTES];
        loop {
            let length = file.read(&mut block)?;
            if length == 0 {
                return Ok(());
            }
            out.write_all(&block[..length])?;
        }
    }
}

/// A file with the number of its bytes, and the checksum of those since the last [`CountedFile::take_checksum`].
pub(super) struct CountedFile {
    pub(super) file: LogFile,
    pub(super) position: u64,
    checksum: crc32fast::Hasher,
}

impl CountedFile {
    pub(super) fn new(file: LogFile) -> Self {
        CountedFile {
            file,
            position: 0,
            checksum: crc32fast::Hasher::new(),
        }
    }

    pub(super) fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes)?;
        self.position += bytes.len() as u64;
        self.checksum.update(bytes);
        Ok(())
    }

    /// Returns the record's start and length.
    pub(super) fn write_record(&mut self, record: &[u8]) -> Result<(u64, u64)> {
        let start = self.position;
        self.write_all(record)?;
        Ok((start, record.len() as u64))
    }

    /// Writes a group of the summary. Returns the record that tells where it is; nothing for an empty one.
    pub(super) fn write_group(
        &mut self,
        opcode: u8,
        write: impl FnOnce(&mut Self) -> Result<()>,
    ) -> Result<Vec<u8>> {
        let start = self.position;
        write(self)?;
        let length = self.position - start;
        let offset = RecordEncoder::new(op::SUMMARY_OFFSET)
            .raw(&[opcode])
            .u64(start)
            .u64(length);
        Ok(if length == 0 {
            Vec::new()
        } else {
            offset.finish(0)
        })
    }

    pub(super) fn take_checksum(&mut self) -> u32 {
        std::mem::take(&mut self.checksum).finalize()
    }
}
