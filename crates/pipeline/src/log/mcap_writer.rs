//! How does a log of any length take bounded memory? Chunks go to the file, and their index waits in an unnamed file.
//!
//! The writers of the crates mcap and foxglove store the index of all chunks in memory, about a kilobyte for each flush.

use std::collections::BTreeMap;
use std::io::{Result, Write};
use std::path::Path;

use mcap::records::op;
use zstd::bulk::Compressor;

use super::held_messages::HeldMessages;
use super::mcap_encoding::{RecordEncoder, append_message};
use super::mcap_files::{CountedFile, IndexFile};
use super::schema::file::LogFile;

/// Name of the compression in the format.
const COMPRESSION: &str = "zstd";
/// Fast: images, most of a log, are compressed already.
const COMPRESSION_LEVEL: i32 = 1;
/// Size of the last message of a chunk, usually at most, bytes: an image of 480 × 480 pixels as JPEG has 80 kB.
const LAST_MESSAGE_BYTES: usize = 256 * 1024;
/// Schema of a channel: its name, encoding and content.
pub(super) type Schema<'a> = (&'a str, &'a str, &'a [u8]);

/// Writes an MCAP file without seeking, so that what a kill leaves is read up to its last chunk.
pub(super) struct McapWriter {
    out: CountedFile,
    chunk: Chunk,
    /// Size at which a chunk is closed, bytes before compression.
    chunk_bytes: usize,
    compressor: Compressor<'static>,
    compressed: Vec<u8>,
    /// Contents of the schemas without their numbers, which are their places from 1 on.
    schemas: Vec<Vec<u8>>,
    /// Records of the channels. Their numbers are their places from 1 on.
    channels: Vec<Vec<u8>>,
    /// Topics of the channels.
    topics: Vec<String>,
    message_counts: Vec<u64>,
    /// The messages of the chunks that are in the file.
    held: HeldMessages,
    /// First and last time of all messages.
    times: Option<(u64, u64)>,
    chunk_index: IndexFile,
    attachments: RecordGroup,
    metadata: RecordGroup,
}

impl McapWriter {
    /// Starts a file. `path` tells where the index can wait.
    pub(super) fn create(
        path: &Path,
        file: LogFile,
        (profile, library): (&str, &str),
        chunk_bytes: usize,
    ) -> Result<Self> {
        let mut out = CountedFile::new(file);
        out.write_all(mcap::MAGIC)?;
        let header = RecordEncoder::new(op::HEADER).text(profile).text(library);
        out.write_all(&header.finish(0))?;
        let buffer_bytes = chunk_bytes + LAST_MESSAGE_BYTES;
        let chunk = Chunk {
            records: written_buffer(buffer_bytes),
            ..Chunk::default()
        };
        Ok(McapWriter {
            out,
            chunk,
            chunk_bytes,
            compressor: Compressor::new(COMPRESSION_LEVEL)?,
            compressed: written_buffer(zstd::zstd_safe::compress_bound(buffer_bytes)),
            schemas: Vec::new(),
            channels: Vec::new(),
            topics: Vec::new(),
            message_counts: Vec::new(),
            held: HeldMessages::default(),
            times: None,
            chunk_index: IndexFile::create(path)?,
            attachments: RecordGroup::default(),
            metadata: RecordGroup::default(),
        })
    }

    /// The messages that the file holds, also after a failure.
    pub(super) fn held(&self) -> HeldMessages {
        self.held.clone()
    }

    /// Adds a channel. Returns its number.
    pub(super) fn add_channel(
        &mut self,
        schema: Option<Schema<'_>>,
        (topic, encoding): (&str, &str),
        metadata: &BTreeMap<String, String>,
    ) -> u16 {
        let schema_id = schema.map_or(0, |schema| self.add_schema(schema));
        let id = self.channels.len() as u16 + 1;
        let record = RecordEncoder::new(op::CHANNEL)
            .u16(id)
            .u16(schema_id)
            .text(topic)
            .text(encoding)
            .text_map(metadata)
            .finish(0);
        self.chunk.records.extend(&record);
        self.channels.push(record);
        self.topics.push(topic.to_owned());
        self.message_counts.push(0);
        self.chunk.entries.push(Vec::new());
        id
    }

    fn add_schema(&mut self, (name, encoding, data): Schema<'_>) -> u16 {
        let encoder = RecordEncoder::new(op::SCHEMA);
        let content = encoder.text(name).text(encoding).bytes(data);
        let content = content.content();
        if let Some(place) = self.schemas.iter().position(|known| known == content) {
            return place as u16 + 1;
        }
        self.schemas.push(content.to_vec());
        let id = self.schemas.len() as u16;
        self.chunk.records.extend(schema_record(id, content));
        id
    }

    /// Writes a message of a channel; `time`: nanoseconds.
    pub(super) fn write_message(&mut self, channel: u16, time: u64, data: &[u8]) -> Result<()> {
        let place = usize::from(channel) - 1;
        self.message_counts[place] += 1;
        let sequence = self.message_counts[place] as u32;
        widen(&mut self.times, time);
        self.chunk.add_message(channel, sequence, time, data);
        if self.chunk.records.len() >= self.chunk_bytes {
            self.finish_chunk()?;
        }
        Ok(())
    }

    /// Writes a metadata record.
    pub(super) fn write_metadata(
        &mut self,
        name: &str,
        values: &BTreeMap<String, String>,
    ) -> Result<()> {
        self.finish_chunk()?;
        let record = RecordEncoder::new(op::METADATA).text(name).text_map(values);
        let (start, length) = self.out.write_record(&record.finish(0))?;
        let index = RecordEncoder::new(op::METADATA_INDEX)
            .u64(start)
            .u64(length)
            .text(name);
        self.metadata.add(&index.finish(0));
        Ok(())
    }

    /// Writes an attachment without times.
    pub(super) fn write_attachment(
        &mut self,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> Result<()> {
        self.finish_chunk()?;
        let record = RecordEncoder::new(op::ATTACHMENT)
            .u64(0)
            .u64(0)
            .text(name)
            .text(media_type)
            .u64(data.len() as u64)
            .raw(data);
        let checksum = crc32fast::hash(record.content());
        let record = record.u32(checksum).finish(0);
        let (start, length) = self.out.write_record(&record)?;
        let index = RecordEncoder::new(op::ATTACHMENT_INDEX)
            .u64(start)
            .u64(length)
            .u64(0)
            .u64(0)
            .u64(data.len() as u64)
            .text(name)
            .text(media_type);
        self.attachments.add(&index.finish(0));
        Ok(())
    }

    /// Ends the chunk and passes all data to the operating system.
    pub(super) fn flush(&mut self) -> Result<()> {
        self.finish_chunk()?;
        self.out.file.flush()
    }

    /// Compresses and writes the chunk with its index.
    fn finish_chunk(&mut self) -> Result<()> {
        let records = &self.chunk.records;
        if records.is_empty() {
            return Ok(());
        }
        self.compressed.clear();
        self.compressed
            .reserve(zstd::zstd_safe::compress_bound(records.len()));
        self.compressor
            .compress_to_buffer(records, &mut self.compressed)?;
        let (from, until) = self.chunk.times.unwrap_or((0, 0));
        let head = RecordEncoder::new(op::CHUNK)
            .u64(from)
            .u64(until)
            .u64(records.len() as u64)
            .u32(crc32fast::hash(records))
            .text(COMPRESSION)
            .u64(self.compressed.len() as u64)
            .finish(self.compressed.len());
        let (start, head_length) = self.out.write_record(&head)?;
        self.out.write_all(&self.compressed)?;
        // A reader finds the chunk from here on, with or without its index.
        self.out.file.flush()?;
        self.held.set(self.topics.iter().zip(&self.message_counts));
        let indexes_start = self.out.position;
        let mut offsets = Vec::with_capacity(self.chunk.entries.len());
        for (channel, entries) in (1..).zip(&self.chunk.entries) {
            if !entries.is_empty() {
                offsets.push((channel, self.out.position));
                let index = RecordEncoder::new(op::MESSAGE_INDEX)
                    .u16(channel)
                    .bytes(entries);
                self.out.write_all(&index.finish(0))?;
            }
        }
        let index = RecordEncoder::new(op::CHUNK_INDEX)
            .u64(from)
            .u64(until)
            .u64(start)
            .u64(head_length + self.compressed.len() as u64)
            .channel_map(&offsets)
            .u64(self.out.position - indexes_start)
            .text(COMPRESSION)
            .u64(self.compressed.len() as u64)
            .u64(records.len() as u64);
        self.chunk_index.add(&index.finish(0))?;
        self.chunk.clear();
        Ok(())
    }

    /// Writes index and summary. Returns the file.
    pub(super) fn finish(mut self) -> Result<LogFile> {
        self.finish_chunk()?;
        let checksum = self.out.take_checksum();
        let end = RecordEncoder::new(op::DATA_END).u32(checksum);
        self.out.write_all(&end.finish(0))?;
        self.out.take_checksum();
        let summary_start = self.out.position;
        let schemas: Vec<u8> = (1..)
            .zip(&self.schemas)
            .flat_map(|(id, content)| schema_record(id, content))
            .collect();
        let statistics = self.statistics();
        let mut offsets = Vec::new();
        let out = &mut self.out;
        for (opcode, records) in [
            (op::SCHEMA, schemas),
            (op::CHANNEL, self.channels.concat()),
            (op::STATISTICS, statistics),
        ] {
            offsets.extend(out.write_group(opcode, |out| out.write_all(&records))?);
        }
        let chunk_index = self.chunk_index;
        offsets.extend(out.write_group(op::CHUNK_INDEX, |out| chunk_index.copy_to(out))?);
        for (opcode, group) in [
            (op::ATTACHMENT_INDEX, self.attachments),
            (op::METADATA_INDEX, self.metadata),
        ] {
            offsets.extend(out.write_group(opcode, |out| out.write_all(&group.records))?);
        }
        let offsets_start = out.position;
        out.write_all(&offsets)?;
        let footer = RecordEncoder::new(op::FOOTER)
            .u64(summary_start)
            .u64(offsets_start)
            .finish(size_of::<u32>());
        out.write_all(&footer)?;
        let checksum = out.take_checksum();
        out.write_all(&checksum.to_le_bytes())?;
        out.write_all(mcap::MAGIC)?;
        out.file.flush()?;
        Ok(self.out.file)
    }

    fn statistics(&self) -> Vec<u8> {
        let (from, until) = self.times.unwrap_or((0, 0));
        let counts: Vec<(u16, u64)> = (1..).zip(self.message_counts.iter().copied()).collect();
        let encoder = RecordEncoder::new(op::STATISTICS)
            .u64(self.message_counts.iter().sum())
            .u16(self.schemas.len() as u16)
            .u32(self.channels.len() as u32)
            .u32(self.attachments.count)
            .u32(self.metadata.count)
            .u32(self.chunk_index.count)
            .u64(from)
            .u64(until)
            .channel_map(&counts);
        encoder.finish(0)
    }
}

/// An empty buffer whose pages are in memory, so that a full chunk after hours takes no more than the first.
fn written_buffer(capacity: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(capacity);
    bytes.resize(capacity, u8::MAX);
    bytes.clear();
    bytes
}

fn schema_record(id: u16, content: &[u8]) -> Vec<u8> {
    RecordEncoder::new(op::SCHEMA)
        .u16(id)
        .raw(content)
        .finish(0)
}

fn widen(times: &mut Option<(u64, u64)>, time: u64) {
    let (from, until) = times.unwrap_or((time, time));
    *times = Some((from.min(time), until.max(time)));
}

/// Records that are written together. Its buffers are used again for the next chunk.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    /// First and last time of its messages.
    times: Option<(u64, u64)>,
    /// For each channel time and offset of its messages, encoded.
    entries: Vec<Vec<u8>>,
}

impl Chunk {
    fn add_message(&mut self, channel: u16, sequence: u32, time: u64, data: &[u8]) {
        let entries = &mut self.entries[usize::from(channel) - 1];
        entries.extend(time.to_le_bytes());
        entries.extend((self.records.len() as u64).to_le_bytes());
        append_message(&mut self.records, channel, sequence, time, data);
        widen(&mut self.times, time);
    }

    fn clear(&mut self) {
        self.records.clear();
        self.times = None;
        self.entries.iter_mut().for_each(Vec::clear);
    }
}

/// Index records of the few attachments or metadata.
#[derive(Default)]
struct RecordGroup {
    records: Vec<u8>,
    count: u32,
}

impl RecordGroup {
    fn add(&mut self, record: &[u8]) {
        self.records.extend(record);
        self.count += 1;
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::sync::Arc;

    use super::*;

    /// Bytes that the writer holds, without the buffer of the waiting index, which has a fixed size.
    fn memory(writer: &McapWriter) -> usize {
        let entries = writer.chunk.entries.iter().map(Vec::capacity);
        writer.chunk.records.capacity()
            + writer.compressed.capacity()
            + entries.sum::<usize>()
            + writer.attachments.records.capacity()
            + writer.metadata.records.capacity()
    }

    #[test]
    fn log_of_any_length_takes_bounded_memory_and_is_indexed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.mcap");
        let file = File::create(&path).expect("a file");
        let file = LogFile::new(&path, file, Arc::default());
        let mut writer = McapWriter::create(&path, file, ("", ""), 1 << 16).expect("a writer");
        let none = BTreeMap::new();
        let channel = writer.add_channel(None, ("/a", "x"), &none);
        let write_chunks = |writer: &mut McapWriter, times: std::ops::Range<u64>| {
            for time in times {
                writer
                    .write_message(channel, time, &[7; 1000])
                    .expect("written");
                writer.flush().expect("flushed");
            }
            memory(writer)
        };
        let early = write_chunks(&mut writer, 0..10);
        assert_eq!(write_chunks(&mut writer, 10..3000), early);
        let names = std::fs::read_dir(folder.path()).expect("a folder").count();
        assert_eq!(names, 1, "the waiting index has no name");
        writer.finish().expect("finished");
        let bytes = std::fs::read(&path).expect("bytes");
        let summary = mcap::Summary::read(&bytes).expect("readable");
        let chunks = summary.expect("a summary").chunk_indexes;
        assert_eq!(chunks.len(), 3000);
        assert_eq!(chunks[2999].message_end_time, 2999);
    }
}
