//! Where in a log is which moment? Its chunks by time, found without reading them, each loaded when it is wanted.
//!
//! [`super::Log`] reads from front to back; whoever jumps about in a log of any length (the view) asks here. A file
//! with a summary opens by it alone; one that was cut is walked once, from chunk to chunk by their lengths.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, bail, ensure};
use localize::Stamp;
use mcap::records::{Record, op};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use prost::Message;

use super::header::Header;
use super::old::Stock;
use super::picture::Encoded;
use super::read::Logged;
use super::schema::{ABOUT, CYCLE_TOPIC, IMAGE_TOPIC, convert, picture_from_bytes, wire};
use super::stream::{End, LONGEST_RECORD_BYTES, PREFIX_BYTES, Stream, unpack};

/// A cut file's topics are sought in so many of its first chunks; ours are all in the first.
const CHUNKS_WITH_TOPICS: usize = 16;
/// Before a chunk's compressed records: times, size, checksum, length of the compression's name.
const CHUNK_TIMES_BYTES: usize = 16;

/// A chunk of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    offset: u64,
    length: u64,
    /// Of its first message.
    pub start: Stamp,
    /// Of its last message.
    pub stop: Stamp,
}

/// A log of which any moment can be loaded.
pub struct Index {
    path: PathBuf,
    header: Header,
    parts: Vec<Part>,
    topics: Mutex<HashMap<u16, String>>,
    end: End,
    missing: Vec<String>,
    /// Its cycles can be read; else what its other topics say stands in.
    own: bool,
}

impl Index {
    /// Opens a log of any version; what it lacks is told by [`Index::missing`].
    ///
    /// What is no MCAP file is refused, and one without a single whole chunk.
    pub fn open(path: &Path) -> Result<Self> {
        let mut missing = Vec::new();
        let header = header(path, &mut missing)?;
        let mut topics = HashMap::new();
        let (parts, end) = match summary(path) {
            Ok(Some(summary)) => {
                let channels = summary.channels.iter();
                topics.extend(channels.map(|(id, channel)| (*id, channel.topic.clone())));
                let part = |chunk: &mcap::records::ChunkIndex| Part {
                    offset: chunk.chunk_start_offset,
                    length: chunk.chunk_length,
                    start: stamp(chunk.message_start_time),
                    stop: stamp(chunk.message_end_time),
                };
                let mut parts: Vec<Part> = summary.chunk_indexes.iter().map(part).collect();
                parts.sort_by_key(|part| part.offset);
                (parts, End::Whole)
            }
            _ => {
                missing.push(
                    "the log is cut: it has no summary, and ends with its last whole chunk"
                        .to_owned(),
                );
                (walk(path)?, End::Cut)
            }
        };
        ensure!(
            !parts.is_empty(),
            "{} holds no whole chunk of messages",
            path.display()
        );
        let index = Index {
            path: path.to_owned(),
            header,
            parts,
            topics: Mutex::new(topics),
            end,
            missing,
            own: true,
        };
        let first = index.parts.len().min(CHUNKS_WITH_TOPICS);
        let own = (0..first).any(|part| index.cycles_can_be_read(part));
        Ok(Index { own, ..index }.with_topics_missing())
    }

    /// True if a chunk holds a cycle in our form; a broken chunk is told when somebody wants what is in it.
    fn cycles_can_be_read(&self, part: usize) -> bool {
        let records = self.records(part).unwrap_or_default();
        records
            .iter()
            .any(|(topic, _, data)| topic == CYCLE_TOPIC && wire::Cycle::decode(&data[..]).is_ok())
    }

    fn with_topics_missing(mut self) -> Self {
        if !self.has_topic(CYCLE_TOPIC) {
            self.missing.push(format!(
                "no topic {CYCLE_TOPIC}: images and poses alone are shown"
            ));
        }
        if !self.has_topic(IMAGE_TOPIC) {
            self.missing
                .push("no images: the camera panel stays empty".to_owned());
        }
        if !self.has_topic("/truth/pose") {
            self.missing
                .push("no truth: errors are not shown".to_owned());
        }
        self
    }

    /// What the log says of its run; empty where it is not one of ours.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the file ends.
    pub fn end(&self) -> End {
        self.end
    }

    /// What cannot be shown of this log, and why; a line each.
    pub fn missing(&self) -> &[String] {
        &self.missing
    }

    /// The chunks, in the order of the file.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// From the first to the last message.
    pub fn span(&self) -> (Stamp, Stamp) {
        let start = self.parts.iter().map(|part| part.start).min();
        let stop = self.parts.iter().map(|part| part.stop).max();
        (start.unwrap_or_default(), stop.unwrap_or_default())
    }

    /// The chunk in which a moment lies, or the last one before it.
    pub fn part_at(&self, at: Stamp) -> usize {
        let behind = self.parts.partition_point(|part| part.start <= at);
        behind.saturating_sub(1)
    }

    /// The cycles that a chunk holds, images still packed.
    pub fn load(&self, part: usize) -> Result<Vec<Logged>> {
        let mut images: HashMap<u64, Encoded> = HashMap::new();
        let mut cycles = Vec::new();
        let mut stock = Stock::default();
        for (topic, time, data) in self.records(part)? {
            match topic.as_str() {
                IMAGE_TOPIC => drop(images.insert(time, picture_from_bytes(&data)?)),
                CYCLE_TOPIC => match wire::Cycle::decode(&data[..]) {
                    Ok(message) => cycles.push((time, message)),
                    // Another version's: what its other topics say is shown.
                    Err(_) => stock.frame(time),
                },
                _ if self.own => {}
                topic => stock.take(topic, time, &data),
            }
        }
        if !cycles.is_empty() {
            self.earlier_image(part, &cycles, &mut images);
        }
        let logged = cycles.into_iter().map(|(time, message)| {
            Ok(Logged {
                index: message.index,
                cycle: convert::cycle_from_wire(message)?,
                image: images.remove(&time),
            })
        });
        let logged: Vec<Logged> = logged
            .collect::<Result<_>>()
            .with_context(|| self.path.display().to_string())?;
        if self.own {
            Ok(logged)
        } else {
            stock.cycles(images)
        }
    }

    /// An image that stands in the chunk before its cycle's.
    fn earlier_image(
        &self,
        part: usize,
        cycles: &[(u64, wire::Cycle)],
        images: &mut HashMap<u64, Encoded>,
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
        let records = self.records(before).unwrap_or_default();
        for (topic, at, data) in records {
            if at == *time && topic == IMAGE_TOPIC {
                images.extend(picture_from_bytes(&data).ok().map(|image| (at, image)));
            }
        }
    }

    fn has_topic(&self, topic: &str) -> bool {
        self.topics().values().any(|known| known == topic)
    }

    // Names stay true whatever happened to whoever held them.
    fn topics(&self) -> std::sync::MutexGuard<'_, HashMap<u16, String>> {
        self.topics
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Topic, time and bytes of a chunk's messages.
    fn records(&self, part: usize) -> Result<Vec<(String, u64, Vec<u8>)>> {
        let part = self.parts.get(part).context("no such chunk")?;
        let broken = || format!("{}: the chunk at byte {}", self.path.display(), part.offset);
        let mut file = File::open(&self.path)
            .with_context(|| format!("cannot read {}", self.path.display()))?;
        file.seek(SeekFrom::Start(part.offset))
            .with_context(broken)?;
        ensure!(
            (PREFIX_BYTES as u64..LONGEST_RECORD_BYTES).contains(&part.length),
            "{}: of {} bytes, which none has",
            broken(),
            part.length
        );
        let mut body = vec![0; part.length as usize];
        file.read_exact(&mut body).with_context(broken)?;
        if body.first() != Some(&op::CHUNK) {
            bail!("{}: is none", broken());
        }
        let records = unpack(&body[PREFIX_BYTES..]).with_context(broken)?;
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

fn stamp(log_time: u64) -> Stamp {
    Stamp(i64::try_from(log_time).unwrap_or(i64::MAX))
}

/// What stands before the first chunk; of another version, or of another program, as much as can be understood.
fn header(path: &Path, missing: &mut Vec<String>) -> Result<Header> {
    let mut stream = Stream::open(path)?;
    let mut about = None;
    let mut files = std::collections::BTreeMap::new();
    while let Ok(Some(record)) = stream.next() {
        match record {
            Record::Metadata(metadata) if metadata.name == ABOUT => about = Some(metadata.metadata),
            Record::Attachment { header, data, .. } => {
                files.insert(header.name, data.into_owned());
            }
            Record::Header(_) | Record::Metadata(_) => {}
            _ => break,
        }
    }
    let header = match about.map(|values| (Header::from_metadata(&values, path), values)) {
        Some((Ok(header), _)) => {
            missing.extend(header.other_version());
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
    for file in ["robot.toml", "field.toml", "spine.toml"] {
        if !files.contains_key(file) {
            missing.push(format!("no {file} in the log"));
        }
    }
    Ok(Header { files, ..header })
}

/// The summary at the end of a file that was closed.
fn summary(path: &Path) -> Result<Option<mcap::Summary>> {
    let mut file = BufReader::new(File::open(path)?);
    let size = file.get_ref().metadata()?.len();
    let options = SummaryReaderOptions::default()
        .with_file_size(size)
        .with_record_length_limit(LONGEST_RECORD_BYTES as usize);
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
    Ok(reader
        .finish()
        .filter(|summary| !summary.chunk_indexes.is_empty()))
}

/// The whole chunks of a file without a summary: record after record by their lengths, contents passed over.
fn walk(path: &Path) -> Result<Vec<Part>> {
    let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    let size = file.metadata()?.len();
    let mut file = BufReader::new(file);
    let mut offset = mcap::MAGIC.len() as u64;
    file.seek(SeekFrom::Start(offset))?;
    let mut parts = Vec::new();
    loop {
        let mut prefix = [0; PREFIX_BYTES];
        if file.read_exact(&mut prefix).is_err() {
            return Ok(parts);
        }
        let [opcode, length @ ..] = prefix;
        let length = u64::from_le_bytes(length);
        let whole = (PREFIX_BYTES as u64).saturating_add(length);
        if length > LONGEST_RECORD_BYTES || offset + whole > size {
            return Ok(parts);
        }
        let mut passed = 0;
        if opcode == op::CHUNK && length >= CHUNK_TIMES_BYTES as u64 {
            let mut times = [0; CHUNK_TIMES_BYTES];
            file.read_exact(&mut times)?;
            passed = CHUNK_TIMES_BYTES as u64;
            let time = |at: usize| {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(&times[at..at + 8]);
                stamp(u64::from_le_bytes(bytes))
            };
            parts.push(Part {
                offset,
                length: whole,
                start: time(0),
                stop: time(8),
            });
        }
        file.seek_relative((length - passed) as i64)?;
        offset += whole;
    }
}
