//! What does a log contain, as columns of numbers? Topics of any version and program, by the schemas in the file.
//!
//! [`super::LogReader`] reads the cycles of a run for replay. [`TopicReader`] reads any topic for analysis, with one
//! chunk at a time in memory. A truncated file is read to its last complete chunk.

mod field;
mod field_names;
mod layout;
mod plan;
mod protobuf;
mod rows;
#[cfg(test)]
mod tests;
mod topic;
mod value;

use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use localize::input_file;
use mcap::records::{Record, op};

use super::header_records::HeaderRecords;
use super::mcap_encoding::RECORD_HEADER_BYTES;
use super::mcap_records::{LogCompleteness, MAX_RECORD_BYTES, RECOVER_HINT, decode_needed_chunk};
use super::record_scan::scan_chunks;
use super::summary::{WithoutChunks, read_summary};
pub use field::{Field, FieldValue};
use layout::Schema;
use plan::ColumnTable;
pub use plan::{Column, ColumnData};
use rows::RowTable;
pub use topic::{RawMessage, Topic};
pub use value::{Fields, Value};

/// Half-open range of log times, nanoseconds.
pub type TimeRange = Range<u64>;

/// The topics of a log, by column or message by message.
pub struct TopicReader {
    path: PathBuf,
    metadata: BTreeMap<String, String>,
    chunks: Vec<Chunk>,
    channels: HashMap<u16, String>,
    topics: BTreeMap<String, Topic>,
    end: LogCompleteness,
}

struct Chunk {
    offset: u64,
    length: u64,
    /// Log times of its first and last message.
    times: (u64, u64),
    /// Channels with messages in this chunk; `None` if the file does not list them.
    channels: Option<Vec<u16>>,
}

impl TopicReader {
    /// Opens a log of any version. Rejects files of other programs.
    pub fn open(path: &Path) -> Result<Self> {
        let metadata = HeaderRecords::read(path)?.metadata.with_context(|| {
            format!(
                "{} is an MCAP file, but no log of mirrorball",
                path.display()
            )
        })?;
        TopicReader::open_with(path, metadata)
    }

    /// Opens a log of any program.
    pub fn open_any(path: &Path) -> Result<Self> {
        let metadata = HeaderRecords::read(path)?.metadata.unwrap_or_default();
        TopicReader::open_with(path, metadata)
    }

    fn open_with(path: &Path, metadata: BTreeMap<String, String>) -> Result<Self> {
        let mut reader = TopicReader {
            path: path.to_owned(),
            metadata,
            chunks: Vec::new(),
            channels: HashMap::new(),
            topics: BTreeMap::new(),
            end: LogCompleteness::Complete,
        };
        match read_summary(path) {
            Ok(Some(summary)) => reader.use_summary(&summary),
            Err(error) if error.is::<WithoutChunks>() => return Err(error),
            _ => reader.scan_truncated()?,
        }
        Ok(reader)
    }

    fn use_summary(&mut self, summary: &mcap::Summary) {
        let counts = summary.stats.as_ref();
        let channels: BTreeMap<_, _> = summary.channels.iter().collect();
        for (id, channel) in channels {
            let count = counts.and_then(|stats| stats.channel_message_counts.get(id));
            let schema = channel.schema.as_ref();
            let (name, data) =
                schema.map_or(("", &[][..]), |schema| (&schema.name, &schema.data[..]));
            let topic = Topic::new(name, data, &channel.message_encoding);
            self.add_channel(*id, &channel.topic, topic);
            self.count_messages(&channel.topic, count.copied().unwrap_or(0));
        }
        self.chunks = summary
            .chunk_indexes
            .iter()
            .map(|chunk| Chunk {
                offset: chunk.chunk_start_offset,
                length: chunk.chunk_length,
                times: (chunk.message_start_time, chunk.message_end_time),
                channels: Some(chunk.message_index_offsets.keys().copied().collect()),
            })
            .collect();
        self.chunks.sort_by_key(|chunk| chunk.offset);
    }

    /// Reads every complete chunk once, to find topics and to count messages.
    fn scan_truncated(&mut self) -> Result<()> {
        self.end = LogCompleteness::Truncated;
        let chunks = scan_chunks(&self.path)?.into_iter().map(|chunk| Chunk {
            offset: chunk.offset,
            length: chunk.length,
            times: (
                super::schema::log_time(chunk.start),
                super::schema::log_time(chunk.end),
            ),
            channels: None,
        });
        self.chunks = chunks.collect();
        let mut schemas: HashMap<u16, (String, Vec<u8>)> = HashMap::new();
        for index in 0..self.chunks.len() {
            for record in self.read_chunk(&self.chunks[index])? {
                match record {
                    Record::Schema { header, data } => {
                        schemas.insert(header.id, (header.name, data.into_owned()));
                    }
                    Record::Channel(channel) => {
                        let schema = schemas.get(&channel.schema_id);
                        let (name, data) =
                            schema.map_or(("", &[][..]), |(name, data)| (name, &data[..]));
                        let topic = Topic::new(name, data, &channel.message_encoding);
                        self.add_channel(channel.id, &channel.topic, topic);
                    }
                    Record::Message { header, .. } => {
                        if let Some(topic) = self.channels.get(&header.channel_id).cloned() {
                            self.count_messages(&topic, 1);
                        }
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    fn add_channel(&mut self, id: u16, name: &str, topic: Topic) {
        self.channels.insert(id, name.to_owned());
        self.topics.entry(name.to_owned()).or_insert(topic);
    }

    fn count_messages(&mut self, topic: &str, count: u64) {
        if let Some(topic) = self.topics.get_mut(topic) {
            topic.messages += count;
        }
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the file ends.
    pub fn end(&self) -> LogCompleteness {
        self.end
    }

    /// Metadata of the run: format, version, source, seed, images.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Every topic by its name.
    pub fn topics(&self) -> &BTreeMap<String, Topic> {
        &self.topics
    }

    /// Input files of the run by name: robot.toml, field.toml, …
    pub fn files(&self) -> Result<BTreeMap<String, Vec<u8>>> {
        Ok(HeaderRecords::read(&self.path)?.files)
    }

    /// Number of chunks; `chunk_messages` takes their indices.
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Columns of a topic, and the log time of each row. See `plan` for the columns of a message.
    ///
    /// `elements`: further columns of single list elements, as `estimate.covariance[0]` in `estimate_covariance_0`.
    /// `between_chunks` is called after each chunk. An error of it ends the reading.
    pub fn columns(
        &self,
        topic: &str,
        elements: &[String],
        range: &TimeRange,
        between_chunks: impl FnMut() -> Result<()>,
    ) -> Result<(Vec<u64>, Vec<Column>)> {
        let schema = self.schema(topic)?;
        let mut table = ColumnTable::new(schema, schema.root(), elements)
            .with_context(|| format!("topic {topic}"))?;
        let mut times = Vec::new();
        self.visit(topic, range, between_chunks, |log_time, data| {
            times.push(log_time);
            table.push(data).map_err(|error| self.damage(topic, error))
        })?;
        Ok(sort_by_time(times, table.finish()))
    }

    /// Entries of a list in a topic's messages, one row per entry, with the log times of the messages.
    ///
    /// `field` is a repeated message, or a message of parallel lists, by its dotted name.
    pub fn rows(
        &self,
        topic: &str,
        field: &str,
        range: &TimeRange,
        between_chunks: impl FnMut() -> Result<()>,
    ) -> Result<(Vec<u64>, Vec<Column>)> {
        let schema = self.schema(topic)?;
        let mut table = RowTable::new(schema, schema.root(), field)
            .with_context(|| format!("topic {topic}"))?;
        self.visit(topic, range, between_chunks, |log_time, data| {
            table
                .push(data, log_time)
                .map_err(|error| self.damage(topic, error))
        })?;
        let (times, columns) = table.finish();
        Ok(sort_by_time(times, columns))
    }

    /// Log times of a topic's messages, ascending.
    pub fn log_times(&self, topic: &str) -> Result<Vec<u64>> {
        let mut times = Vec::new();
        let everything = 0..u64::MAX;
        self.visit(
            topic,
            &everything,
            || Ok(()),
            |log_time, _| {
                times.push(log_time);
                Ok(())
            },
        )?;
        times.sort_unstable();
        Ok(times)
    }

    /// Messages of a chunk by log time. Without named topics, those of all topics.
    pub fn chunk_messages(
        &self,
        chunk: usize,
        topics: &[String],
        range: &TimeRange,
    ) -> Result<Vec<RawMessage>> {
        let chunk = self.chunks.get(chunk).context("no such chunk")?;
        let wanted = |topic: &String| topics.is_empty() || topics.contains(topic);
        let holds = |id: &u16| self.channels.get(id).is_some_and(wanted);
        if !chunk.overlaps(range)
            || chunk
                .channels
                .as_ref()
                .is_some_and(|ids| !ids.iter().any(holds))
        {
            return Ok(Vec::new());
        }
        let mut messages = Vec::new();
        for record in self.read_chunk(chunk)? {
            if let Record::Message { header, data } = record
                && let Some(topic) = self.channels.get(&header.channel_id)
                && wanted(topic)
                && range.contains(&header.log_time)
            {
                messages.push(RawMessage {
                    topic: topic.clone(),
                    log_time: header.log_time,
                    data: data.into_owned(),
                });
            }
        }
        messages.sort_by_key(|message| message.log_time);
        Ok(messages)
    }

    /// Paths of all numbers and texts, for [`Field::find`]: those of topics without messages last.
    pub fn field_paths(&self) -> Vec<String> {
        let mut paths = Vec::new();
        let mut topics: Vec<(&String, &Topic)> = self.topics.iter().collect();
        topics.sort_by_key(|(_, topic)| topic.messages == 0);
        for (name, topic) in topics {
            let sample = topic.is_json.then(|| self.first_message(name)).flatten();
            let names = topic.field_names(sample.as_ref());
            paths.extend(names.into_iter().map(|field| format!("{name}.{field}")));
        }
        paths
    }

    /// The first message of a topic.
    fn first_message(&self, topic: &str) -> Option<RawMessage> {
        let wanted = [topic.to_owned()];
        (0..self.chunks.len()).find_map(|chunk| {
            let messages = self.chunk_messages(chunk, &wanted, &(0..u64::MAX)).ok()?;
            messages.into_iter().next()
        })
    }

    /// Fields and values of a message.
    pub fn decode(&self, message: &RawMessage) -> Result<Fields> {
        let schema = self.schema(&message.topic)?;
        value::decode(schema, schema.root(), &message.data)
            .map_err(|error| self.damage(&message.topic, error))
    }

    fn schema(&self, topic: &str) -> Result<&Schema> {
        let found = self.topics.get(topic);
        let found =
            found.with_context(|| format!("{} has no topic {topic}", self.path.display()))?;
        let layout = found.layout.as_ref();
        layout.map_err(|reason| anyhow!("{}: topic {topic}: {reason}", self.path.display()))
    }

    fn damage(&self, topic: &str, error: protobuf::ProtobufError) -> anyhow::Error {
        anyhow!("{}: a message of {topic}: {error}", self.path.display())
    }

    fn visit(
        &self,
        topic: &str,
        range: &TimeRange,
        mut between_chunks: impl FnMut() -> Result<()>,
        mut visit: impl FnMut(u64, &[u8]) -> Result<()>,
    ) -> Result<()> {
        let is_topic = |id: &u16| self.channels.get(id).is_some_and(|name| name == topic);
        for chunk in self.chunks.iter().filter(|chunk| chunk.overlaps(range)) {
            if chunk
                .channels
                .as_ref()
                .is_some_and(|ids| !ids.iter().any(is_topic))
            {
                continue;
            }
            for record in self.read_chunk(chunk)? {
                if let Record::Message { header, data } = record
                    && is_topic(&header.channel_id)
                    && range.contains(&header.log_time)
                {
                    visit(header.log_time, &data)?;
                }
            }
            between_chunks()?;
        }
        Ok(())
    }

    fn read_chunk(&self, chunk: &Chunk) -> Result<impl Iterator<Item = Record<'static>> + use<>> {
        let place = || format!("{}: chunk at byte {}", self.path.display(), chunk.offset);
        ensure!(
            (RECORD_HEADER_BYTES as u64..MAX_RECORD_BYTES).contains(&chunk.length),
            "{}: invalid length: {} bytes; {RECOVER_HINT}",
            place(),
            chunk.length
        );
        let mut file = input_file::open(&self.path)
            .with_context(|| format!("cannot read {}", self.path.display()))?;
        file.seek(SeekFrom::Start(chunk.offset))
            .with_context(place)?;
        let mut body = vec![0; chunk.length as usize];
        file.read_exact(&mut body).with_context(place)?;
        if body.first() != Some(&op::CHUNK) {
            bail!("{}: the record there is no chunk; {RECOVER_HINT}", place());
        }
        let records = decode_needed_chunk(&body[RECORD_HEADER_BYTES..]).with_context(place)?;
        Ok(records.into_iter())
    }
}

impl Chunk {
    fn overlaps(&self, range: &TimeRange) -> bool {
        self.times.0 < range.end && range.start <= self.times.1
    }
}

/// Sorts rows by log time. Rows of equal times keep their order in the file.
fn sort_by_time(times: Vec<u64>, columns: Vec<Column>) -> (Vec<u64>, Vec<Column>) {
    if times.is_sorted() {
        return (times, columns);
    }
    let mut order: Vec<usize> = (0..times.len()).collect();
    order.sort_by_key(|&row| times[row]);
    let columns = columns
        .into_iter()
        .map(|(name, data)| (name, data.permuted(&order)))
        .collect();
    (order.iter().map(|&row| times[row]).collect(), columns)
}

impl ColumnData {
    fn permuted(self, order: &[usize]) -> Self {
        fn pick<T: Copy>(values: &[T], order: &[usize]) -> Vec<T> {
            order.iter().map(|&row| values[row]).collect()
        }
        match self {
            ColumnData::F64(values) => ColumnData::F64(pick(&values, order)),
            ColumnData::I64(values) => ColumnData::I64(pick(&values, order)),
            ColumnData::Bool(values) => ColumnData::Bool(pick(&values, order)),
            ColumnData::Text { codes, texts } => ColumnData::Text {
                codes: pick(&codes, order),
                texts,
            },
        }
    }
}
