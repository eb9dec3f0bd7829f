//! Where in a log is a given time? An index of its chunks by time; a chunk is loaded on demand.
//!
//! [`super::LogReader`] reads sequentially. The view needs random access, so it uses this index. A complete file is
//! opened by its summary. A truncated file is scanned once, from chunk to chunk by their lengths.

use std::collections::HashMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, bail, ensure};
use localize::Stamp;
use localize::input_file;
use mcap::records::{Record, op};
use prost::Message;

use super::encoded_image::EncodedImage;
use super::fallback::FallbackReader;
use super::header::{Header, translate_files};
use super::header_records::HeaderRecords;
use super::limits::{FieldBudget, check_message};
use super::mcap_encoding::RECORD_HEADER_BYTES;
use super::mcap_records::{LogCompleteness, MAX_RECORD_BYTES, RECOVER_HINT, decode_needed_chunk};
use super::read::LoggedCycle;
use super::record_scan::{ChunkInfo, scan_chunks, stamp_from_log_time};
use super::schema::{CYCLE_TOPIC, IMAGE_TOPIC, convert, decode_compressed_image, wire};
use super::summary::{WithoutChunks, read_summary};
use crate::config::PIPELINE_FILE;

/// Poses for viewers.
const POSE_TOPIC: &str = "/pose";
/// Number of chunks from which the topics of a truncated file are read. The first has all topics of Mirrorball.
const TOPIC_SEARCH_CHUNKS: usize = 16;

/// A log with random access.
pub struct LogIndex {
    path: PathBuf,
    header: Header,
    chunks: Vec<ChunkInfo>,
    topics: Mutex<HashMap<u16, String>>,
    end: LogCompleteness,
    warnings: Vec<String>,
    /// False if only the topics for viewers can be read.
    cycles_readable: bool,
}

impl LogIndex {
    /// Opens a log of any version. [`LogIndex::warnings`] lists what is missing.
    ///
    /// Rejects files that are not MCAP and files without a complete chunk.
    pub fn open(path: &Path) -> Result<Self> {
        let mut missing = Vec::new();
        let header = read_header(path, &mut missing)?;
        let mut topics = HashMap::new();
        let (mut parts, end) = match read_summary(path) {
            Ok(Some(summary)) => {
                let channels = summary.channels.iter();
                topics.extend(channels.map(|(id, channel)| (*id, channel.topic.clone())));
                let part = |chunk: &mcap::records::ChunkIndex| ChunkInfo {
                    offset: chunk.chunk_start_offset,
                    length: chunk.chunk_length,
                    start: stamp_from_log_time(chunk.message_start_time),
                    end: stamp_from_log_time(chunk.message_end_time),
                };
                let mut parts: Vec<ChunkInfo> = summary.chunk_indexes.iter().map(part).collect();
                parts.sort_by_key(|part| part.offset);
                (parts, LogCompleteness::Complete)
            }
            Err(error) if error.is::<WithoutChunks>() => return Err(error),
            _ => {
                missing.push(
                    "the log is cut: it has no summary, and ends with its last whole chunk"
                        .to_owned(),
                );
                (scan_chunks(path)?, LogCompleteness::Truncated)
            }
        };
        ensure!(
            !parts.is_empty(),
            "{} holds no whole chunk of messages",
            path.display()
        );
        // Chunks have the times of their messages, cycles have stamps.
        for part in &mut parts {
            for time in [&mut part.start, &mut part.end] {
                *time = Stamp(time.0.saturating_sub(header.clock_offset_ns));
            }
        }
        let index = LogIndex {
            path: path.to_owned(),
            header,
            chunks: parts,
            topics: Mutex::new(topics),
            end,
            warnings: missing,
            cycles_readable: true,
        };
        let first = index.chunks.len().min(TOPIC_SEARCH_CHUNKS);
        let cycles_readable = (0..first).any(|part| index.chunk_has_readable_cycle(part));
        Ok(LogIndex {
            cycles_readable,
            ..index
        }
        .with_topic_warnings())
    }

    /// True if a chunk holds a cycle in our format. A damaged chunk is reported when it is loaded.
    fn chunk_has_readable_cycle(&self, part: usize) -> bool {
        let records = self.read_chunk_messages(part).unwrap_or_default();
        records
            .iter()
            .any(|(topic, _, data)| topic == CYCLE_TOPIC && is_readable_cycle(data))
    }

    fn with_topic_warnings(mut self) -> Self {
        if !self.has_topic(CYCLE_TOPIC) {
            let shown = if self.has_topic(POSE_TOPIC) {
                "images and poses alone are shown"
            } else {
                "images alone are shown"
            };
            self.warnings
                .push(format!("no topic {CYCLE_TOPIC}: {shown}"));
        }
        if !self.has_topic(IMAGE_TOPIC) {
            self.warnings
                .push("no images: the camera panel stays empty".to_owned());
        }
        if !self.has_topic("/truth/pose") {
            self.warnings
                .push("no truth: errors are not shown".to_owned());
        }
        self
    }

    /// The log's metadata and files. Empty if Mirrorball did not write the log.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the file ends.
    pub fn end(&self) -> LogCompleteness {
        self.end
    }

    /// Data that cannot be shown, each with its reason, one per line.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The chunks, in the order of the file.
    pub fn chunks(&self) -> &[ChunkInfo] {
        &self.chunks
    }

    /// False if neither cycles nor poses can be read: the modes of its cycles mean nothing.
    pub fn holds_poses(&self) -> bool {
        self.cycles_readable || self.has_topic(POSE_TOPIC)
    }

    /// Times of the first and of the last message.
    pub fn span(&self) -> (Stamp, Stamp) {
        let start = self.chunks.iter().map(|part| part.start).min();
        let stop = self.chunks.iter().map(|part| part.end).max();
        (start.unwrap_or_default(), stop.unwrap_or_default())
    }

    /// Index of the chunk that contains a time, or of the last one before it.
    pub fn chunk_at(&self, at: Stamp) -> usize {
        let behind = self.chunks.partition_point(|part| part.start <= at);
        behind.saturating_sub(1)
    }

    /// Reads the cycles of a chunk. Their images stay encoded.
    pub fn load(&self, part: usize) -> Result<Vec<LoggedCycle>> {
        let mut images: HashMap<u64, EncodedImage> = HashMap::new();
        let mut cycles = Vec::new();
        let mut fallback = FallbackReader::default();
        let mut budget = FieldBudget::default();
        let mut last_cycle: Option<(u64, Vec<u8>)> = None;
        for (topic, time, data) in self.read_chunk_messages(part)? {
            budget
                .add_message(&data)
                .with_context(|| self.path.display().to_string())?;
            match topic.as_str() {
                IMAGE_TOPIC => drop(images.insert(time, decode_compressed_image(&data)?)),
                // As in `LogReader`: a message that stands twice is one cycle.
                CYCLE_TOPIC
                    if last_cycle
                        .as_ref()
                        .is_some_and(|(at, last)| *at == time && *last == data) => {}
                CYCLE_TOPIC => {
                    match wire::Cycle::decode(&data[..]) {
                        Ok(message) => cycles.push((time, message)),
                        // Another version wrote it, so its other topics are shown.
                        Err(_) => fallback.add_cycle(time),
                    }
                    last_cycle = Some((time, data));
                }
                _ if self.cycles_readable => {}
                topic => fallback.add_message(topic, time, &data),
            }
        }
        if !cycles.is_empty() {
            self.load_image_from_previous_chunk(part, &cycles, &mut images);
        }
        let logged = cycles.into_iter().map(|(time, message)| {
            Ok(LoggedCycle {
                index: message.index,
                cycle: convert::cycle_from_wire(message)?,
                image: images.remove(&time),
            })
        });
        let logged: Vec<LoggedCycle> = logged
            .collect::<Result<_>>()
            .with_context(|| self.path.display().to_string())?;
        if self.cycles_readable {
            Ok(logged)
        } else {
            fallback.into_cycles(images)
        }
    }

    /// Loads an image that is in the chunk before that of its cycle.
    fn load_image_from_previous_chunk(
        &self,
        part: usize,
        cycles: &[(u64, wire::Cycle)],
        images: &mut HashMap<u64, EncodedImage>,
    ) {
        let wanted = |(time, cycle): &&(u64, wire::Cycle)| {
            cycle.image != "none" && !cycle.image.is_empty() && !images.contains_key(time)
        };
        let Some((time, _)) = cycles.iter().find(wanted) else {
            return;
        };
        let Some(before) = part.checked_sub(1) else {
            return;
        };
        let records = self.read_chunk_messages(before).unwrap_or_default();
        for (topic, at, data) in records {
            if at == *time && topic == IMAGE_TOPIC {
                images.extend(decode_compressed_image(&data).ok().map(|image| (at, image)));
            }
        }
    }

    fn has_topic(&self, topic: &str) -> bool {
        self.topics().values().any(|known| known == topic)
    }

    // The names are still valid after a panic of another thread.
    fn topics(&self) -> std::sync::MutexGuard<'_, HashMap<u16, String>> {
        self.topics
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Topic, time and bytes of a chunk's messages.
    fn read_chunk_messages(&self, part: usize) -> Result<Vec<(String, u64, Vec<u8>)>> {
        let part = self.chunks.get(part).context("no such chunk")?;
        let broken = || format!("{}: the chunk at byte {}", self.path.display(), part.offset);
        let mut file = input_file::open(&self.path)
            .with_context(|| format!("cannot read {}", self.path.display()))?;
        file.seek(SeekFrom::Start(part.offset))
            .with_context(broken)?;
        ensure!(
            (RECORD_HEADER_BYTES as u64..MAX_RECORD_BYTES).contains(&part.length),
            "{}: of {} bytes, which none has; {RECOVER_HINT}",
            broken(),
            part.length
        );
        let mut body = vec![0; part.length as usize];
        file.read_exact(&mut body).with_context(broken)?;
        if body.first() != Some(&op::CHUNK) {
            bail!("{}: is none; {RECOVER_HINT}", broken());
        }
        let records = decode_needed_chunk(&body[RECORD_HEADER_BYTES..]).with_context(broken)?;
        let mut topics = self.topics();
        let mut messages = Vec::new();
        for record in records {
            match record {
                Record::Channel(channel) => drop(topics.insert(channel.id, channel.topic)),
                Record::Message { header, data } => {
                    if let Some(topic) = topics.get(&header.channel_id) {
                        messages.push((topic.clone(), header.log_time, data.into_owned()));
                    }
                }
                _ => {}
            }
        }
        Ok(messages)
    }
}

fn is_readable_cycle(message: &[u8]) -> bool {
    check_message(message).is_ok() && wire::Cycle::decode(message).is_ok()
}

/// Reads metadata and files. For other versions or programs, reads as much as can be decoded.
fn read_header(path: &Path, missing: &mut Vec<String>) -> Result<Header> {
    let HeaderRecords { metadata, files } = HeaderRecords::read(path)?;
    let header = match metadata.map(|values| (Header::from_metadata(&values, path), values)) {
        Some((Ok(header), _)) => {
            missing.extend(header.version_mismatch());
            header
        }
        Some((Err(error), values)) => {
            missing.push(format!("{error:#}: what is understood of it is shown"));
            let version = values.get("version").cloned().unwrap_or_default();
            Header {
                version,
                ..Header::new(values.get("source").map_or("", String::as_str), None)
            }
        }
        None => {
            missing.push("no log of mirrorball: what is understood of it is shown".to_owned());
            Header {
                version: String::new(),
                ..Header::new("", None)
            }
        }
    };
    let files = translate_files(files);
    for file in ["robot.toml", "field.toml", PIPELINE_FILE] {
        if !files.contains_key(file) {
            missing.push(format!("no {file} in the log"));
        }
    }
    Ok(Header { files, ..header })
}
