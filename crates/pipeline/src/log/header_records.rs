//! Which records describe the run? The metadata and the attachments: the first records in logs of Mirrorball, anywhere
//! in files that other programs have written again.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use anyhow::Result;
use mcap::read::parse_record;
use mcap::records::{Record, op};

use super::mcap_records::{DamagedRange, RecordReader, is_complete_attachment};
use super::record_scan::scan_records;
use super::schema::PROJECT_NAME;

/// Metadata and attachments of a log.
#[derive(Default)]
pub(super) struct HeaderRecords {
    /// Values of the metadata record of Mirrorball. None in files of other programs.
    pub(super) metadata: Option<BTreeMap<String, String>>,
    /// Attachments by name.
    pub(super) files: BTreeMap<String, Vec<u8>>,
}

impl HeaderRecords {
    /// Reads the first records of a stream. Returns the first other record as well, None at the end of the stream.
    pub(super) fn read_first(
        stream: &mut RecordReader,
    ) -> (Self, Result<Option<Record<'static>>, DamagedRange>) {
        let mut records = HeaderRecords::default();
        loop {
            match stream.next_record() {
                Ok(Some(Record::Header(_))) => {}
                Ok(Some(record @ (Record::Metadata(_) | Record::Attachment { .. }))) => {
                    records.add(record);
                }
                other => return (records, other),
            }
        }
    }

    /// Reads the records of the file at `path`, up to a damaged part.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let (mut records, _) = HeaderRecords::read_first(&mut RecordReader::open(path)?);
        records.add_later(path)?;
        Ok(records)
    }

    /// Adds the records that stand after schemas or messages, if the metadata or the robot is not among the first ones.
    pub(super) fn add_later(&mut self, path: &Path) -> Result<()> {
        if self.metadata.is_some() && self.files.contains_key("robot.toml") {
            return Ok(());
        }
        scan_records(path, |place, file| {
            if ![op::METADATA, op::ATTACHMENT].contains(&place.opcode) {
                return Ok(0);
            }
            let mut body = Vec::new();
            file.take(place.length).read_to_end(&mut body)?;
            let is_whole = place.opcode == op::METADATA || is_complete_attachment(&body);
            if let Some(record) = parse_record(place.opcode, &body).ok().filter(|_| is_whole) {
                self.add(record.into_owned());
            }
            Ok(body.len() as u64)
        })
    }

    fn add(&mut self, record: Record<'static>) {
        match record {
            Record::Metadata(metadata) if metadata.name == PROJECT_NAME => {
                self.metadata = Some(metadata.metadata);
            }
            Record::Attachment { header, data, .. } => {
                self.files.insert(header.name, data.into_owned());
            }
            _ => {}
        }
    }
}
