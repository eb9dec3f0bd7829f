//! What can be recovered from a killed or damaged log? Every complete record, in a file with index and summary.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use anyhow::{Context, Result, ensure};
use localize::Stamp;
use mcap::records::{MessageHeader, Record};
use mcap::{Attachment, WriteOptions, Writer};
use vision::output_file::OutputFile;

use super::mcap_records::{DamagedRange, LogCompleteness, RecordReader};
use super::summary::intact_summary;
use crate::config::PIPELINE_FILE;
use crate::message_text::printable_line;

/// Result of a recovery.
#[derive(Debug, Clone, PartialEq)]
pub struct RecoverySummary {
    /// Recovered messages of all topics.
    pub messages: u64,
    /// Time of the latest message. None if there is no message.
    pub until: Option<Stamp>,
    /// Unreadable parts of the log, each with its reason, and files of the run's set-up, each with what needs it.
    pub lost: Vec<String>,
    /// True if the log was complete and undamaged.
    pub was_whole: bool,
}

/// Copies all readable records of the log `from` to a log `to`, which gets its name only when it is complete.
pub fn recover(from: &Path, to: &Path) -> Result<RecoverySummary> {
    let same = from
        .canonicalize()
        .ok()
        .is_some_and(|from| to.canonicalize().is_ok_and(|to| from == to));
    ensure!(
        !same,
        "{} cannot be recovered into itself: name another file with --out",
        from.display()
    );
    let mut stream = RecordReader::open(from)?;
    let summary = intact_summary(from).unwrap_or_default();
    let chunks = summary.chunk_indexes.iter();
    stream.set_chunk_starts(chunks.map(|chunk| chunk.chunk_start_offset));
    OutputFile::create(to)
        .map_err(anyhow::Error::from)
        .and_then(|file| copy_records(&mut stream, summary, file))
        .with_context(|| format!("cannot write {}", to.display()))
}

fn copy_records(
    stream: &mut RecordReader,
    summary: mcap::Summary,
    file: OutputFile,
) -> Result<RecoverySummary> {
    let mut recovered = RecoverySummary {
        messages: 0,
        until: None,
        lost: Vec::new(),
        was_whole: false,
    };
    let mut lost = |damage: DamagedRange| {
        recovered
            .lost
            .push(format!("at byte {}: {}", damage.offset, damage.reason))
    };
    let mut options = WriteOptions::new().compression_threads(0);
    let first = loop {
        match stream.next_record() {
            Err(damage) => lost(damage),
            Ok(first) => break first,
        }
    };
    let mut next = first;
    if let Some(Record::Header(header)) = &next {
        options = options.profile(&header.profile).library(&header.library);
    }
    let mut copy = LogCopier {
        writer: options.create(file)?,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        files: BTreeSet::new(),
        summary,
    };
    let mut strays = 0_u64;
    while let Some(record) = next {
        match copy.copy_record(record)? {
            CopiedRecord::Message(log_time) => {
                recovered.messages += 1;
                let stamp = Stamp(i64::try_from(log_time).unwrap_or(i64::MAX));
                recovered.until = recovered.until.max(Some(stamp));
            }
            CopiedRecord::Orphan => strays += 1,
            CopiedRecord::Other => {}
        }
        next = loop {
            match stream.next_record() {
                Err(damage) => lost(damage),
                Ok(next) => break next,
            }
        };
    }
    if strays > 0 {
        recovered
            .lost
            .push(format!("{strays} records whose channel was in a lost part"));
    }
    recovered.lost.extend(copy.lost_files());
    recovered.was_whole =
        stream.end() == Some(LogCompleteness::Complete) && recovered.lost.is_empty();
    copy.writer.write_metadata(&mcap::records::Metadata {
        name: "recovery".to_owned(),
        metadata: BTreeMap::from([
            ("messages".to_owned(), recovered.messages.to_string()),
            (
                "until_s".to_owned(),
                recovered
                    .until
                    .map_or_else(String::new, |stamp| stamp.seconds().to_string()),
            ),
            ("lost".to_owned(), recovered.lost.join("\n")),
        ]),
    })?;
    copy.writer.finish()?;
    copy.writer.into_inner().finish()?;
    Ok(recovered)
}

/// A writer, with the maps from the old file's schema and channel numbers to its own.
struct LogCopier {
    writer: Writer<OutputFile>,
    schemas: HashMap<u16, u16>,
    channels: HashMap<u16, u16>,
    /// Names of the attachments that were copied.
    files: BTreeSet<String>,
    /// Schemas and channels whose records in the data are lost, and the names of all attachments.
    summary: mcap::Summary,
}

enum CopiedRecord {
    Message(u64),
    Other,
    Orphan,
}

impl LogCopier {
    fn copy_record(&mut self, record: Record<'static>) -> Result<CopiedRecord> {
        match record {
            Record::Schema { header, data } => {
                let id = self
                    .writer
                    .add_schema(&header.name, &header.encoding, &data)?;
                self.schemas.insert(header.id, id);
            }
            Record::Channel(channel) => {
                // Schema 0 means no schema.
                let schema = match channel.schema_id {
                    0 => Some(0),
                    id => self.schema_id(id)?,
                };
                let Some(schema) = schema else {
                    return Ok(CopiedRecord::Orphan);
                };
                let (topic, encoding) = (&channel.topic, &channel.message_encoding);
                let id = self
                    .writer
                    .add_channel(schema, topic, encoding, &channel.metadata)?;
                self.channels.insert(channel.id, id);
            }
            Record::Message { header, data } => {
                let Some(channel_id) = self.channel_id(header.channel_id)? else {
                    return Ok(CopiedRecord::Orphan);
                };
                let log_time = header.log_time;
                self.writer.write_to_known_channel(
                    &MessageHeader {
                        channel_id,
                        ..header
                    },
                    &data,
                )?;
                return Ok(CopiedRecord::Message(log_time));
            }
            Record::Attachment { header, data, .. } => {
                self.files.insert(header.name.clone());
                self.writer.attach(&Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                })?;
            }
            Record::Metadata(metadata) => self.writer.write_metadata(&metadata)?,
            _ => {}
        }
        Ok(CopiedRecord::Other)
    }

    /// The attachments that the summary lists and the data no longer hold, each with what needs it.
    fn lost_files(&self) -> Vec<String> {
        let all = self.summary.attachment_indexes.iter();
        let names: BTreeSet<&String> = all.map(|attachment| &attachment.name).collect();
        let lost = names.into_iter().filter(|name| !self.files.contains(*name));
        lost.map(|name| {
            let effect = if name == PIPELINE_FILE {
                "replay takes the default settings, by which estimates may differ"
            } else {
                "replay, doctor and calibrate cannot use the log without it, and the view shows no field"
            };
            format!("{}, a file of the set-up: {effect}", printable_line(name))
        })
        .collect()
    }

    /// The copy's number of a schema. None if its record is lost, and the summary does not have it.
    fn schema_id(&mut self, id: u16) -> Result<Option<u16>> {
        if let (None, Some(schema)) = (self.schemas.get(&id), self.summary.schemas.get(&id)) {
            let (name, encoding) = (&schema.name, &schema.encoding);
            let copied = self.writer.add_schema(name, encoding, &schema.data)?;
            self.schemas.insert(id, copied);
        }
        Ok(self.schemas.get(&id).copied())
    }

    /// The copy's number of a channel. None if its record is lost, and the summary does not have it.
    fn channel_id(&mut self, id: u16) -> Result<Option<u16>> {
        if let (None, Some(channel)) = (self.channels.get(&id), self.summary.channels.get(&id)) {
            let channel = channel.clone();
            let schema = match &channel.schema {
                Some(schema) => self.schema_id(schema.id)?.unwrap_or(0),
                None => 0,
            };
            let (topic, encoding) = (&channel.topic, &channel.message_encoding);
            let metadata = &channel.metadata;
            let copied = self.writer.add_channel(schema, topic, encoding, metadata)?;
            self.channels.insert(id, copied);
        }
        Ok(self.channels.get(&id).copied())
    }
}
