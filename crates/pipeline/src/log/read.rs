//! What did a log record? Its header, then cycle after cycle in the order of their writing, one in memory at a time.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use localize::Stamp;
use mcap::records::Record;
use prost::Message;

use super::encoded_image::{EncodedImage, ImageCompression};
use super::header::{Header, translate_files};
use super::mcap_records::{LogEnd, RecordReader};
use super::schema::{
    CYCLE_TOPIC, IMAGE_TOPIC, PROJECT_NAME, convert, decode_compressed_image, wire,
};
use crate::cycle::Cycle;
use crate::sample::{CameraImage, ImageContent, Sample};

/// A log that is being read; iterate for its cycles.
pub struct LogReader {
    path: PathBuf,
    header: Header,
    stream: RecordReader,
    /// What the reader met first behind the header.
    pending_record: Option<Record<'static>>,
    topics: HashMap<u16, TopicKind>,
    assembler: CycleAssembler,
    last_stamp: Option<Stamp>,
    failed: bool,
}

/// What the messages of a topic are to a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TopicKind {
    /// Everything of a cycle but its image.
    Cycle,
    /// The image of the cycle that follows.
    Image,
    /// For viewers: the cycle says it too.
    Other,
}

impl TopicKind {
    /// What a topic of that name is.
    pub fn from_name(name: &str) -> Self {
        match name {
            CYCLE_TOPIC => TopicKind::Cycle,
            IMAGE_TOPIC => TopicKind::Image,
            _ => TopicKind::Other,
        }
    }
}

/// Puts cycles together from messages, those of a log and those of a live stream alike.
#[derive(Default)]
pub struct CycleAssembler {
    image: Option<(u64, EncodedImage)>,
}

impl CycleAssembler {
    /// Takes a message; a cycle's is the last of its cycle.
    pub fn push_message(
        &mut self,
        topic: TopicKind,
        log_time: u64,
        data: &[u8],
    ) -> Result<Option<LoggedCycle>> {
        match topic {
            TopicKind::Image => self.image = Some((log_time, decode_compressed_image(data)?)),
            TopicKind::Cycle => return self.assemble_cycle(log_time, data).map(Some),
            TopicKind::Other => {}
        }
        Ok(None)
    }

    fn assemble_cycle(&mut self, log_time: u64, data: &[u8]) -> Result<LoggedCycle> {
        let message = wire::Cycle::decode(data)?;
        let index = message.index;
        // A recovered log may have lost an image with the chunk before its cycle's, a slow viewer either.
        let image = self
            .image
            .take()
            .filter(|(time, _)| *time == log_time)
            .map(|(_, image)| image);
        let cycle = convert::cycle_from_wire(message)?;
        Ok(LoggedCycle {
            index,
            cycle,
            image,
        })
    }
}

/// A cycle as it was recorded.
#[derive(Debug, Clone)]
pub struct LoggedCycle {
    /// Counts from 0; a gap is a cycle that was dropped.
    pub index: u64,
    /// The cycle; its image is beside it, still packed.
    pub cycle: Cycle,
    /// The image as the log holds it.
    pub image: Option<EncodedImage>,
}

impl LogReader {
    /// Opens a log and reads its header.
    ///
    /// What is no MCAP file, no log of ours, or a log of another form is refused.
    pub fn open(path: &Path) -> Result<Self> {
        let mut stream = RecordReader::open(path)?;
        let mut about = None;
        let mut files = std::collections::BTreeMap::new();
        let first = loop {
            let next = stream
                .next_record()
                .map_err(|damage| damage.to_error(path))?;
            match next {
                Some(Record::Metadata(metadata)) if metadata.name == PROJECT_NAME => {
                    about = Some(Header::from_metadata(&metadata.metadata, path)?);
                }
                Some(Record::Attachment { header, data, .. }) => {
                    files.insert(header.name, data.into_owned());
                }
                Some(Record::Header(_) | Record::Metadata(_)) => {}
                other => break other,
            }
        };
        let Some(header) = about else {
            bail!(
                "{} is an MCAP file, but no log of mirrorball",
                path.display()
            );
        };
        Ok(LogReader {
            path: path.to_owned(),
            header: Header {
                files: translate_files(files),
                ..header
            },
            stream,
            pending_record: first,
            topics: HashMap::new(),
            assembler: CycleAssembler::default(),
            last_stamp: None,
            failed: false,
        })
    }

    /// What the log says of its run.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How the log ended; none while there is more to read.
    pub fn end(&self) -> Option<LogEnd> {
        self.stream.end()
    }

    fn read_next(&mut self) -> Result<Option<LoggedCycle>> {
        loop {
            let record = match self.pending_record.take() {
                Some(record) => record,
                None => match self
                    .stream
                    .next_record()
                    .map_err(|damage| damage.to_error(&self.path))?
                {
                    Some(record) => record,
                    None => return Ok(None),
                },
            };
            match record {
                Record::Channel(channel) => {
                    self.topics
                        .insert(channel.id, TopicKind::from_name(&channel.topic));
                }
                Record::Message { header, data } => {
                    let Some(topic) = self.topics.get(&header.channel_id) else {
                        bail!("a message without a channel");
                    };
                    let logged = self
                        .assembler
                        .push_message(*topic, header.log_time, &data)?;
                    if let Some(logged) = logged {
                        self.last_stamp = Some(logged.cycle.stamp);
                        return Ok(Some(logged));
                    }
                }
                _ => {}
            }
        }
    }
}

impl Iterator for LogReader {
    type Item = Result<LoggedCycle>;

    /// The next cycle; after an error there is none.
    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.read_next().with_context(|| match self.last_stamp {
            Some(until) => format!(
                "{}: behind the cycle at {} s",
                self.path.display(),
                until.seconds()
            ),
            None => format!("{}: before its first cycle", self.path.display()),
        });
        self.failed = next.is_err();
        next.transpose()
    }
}

impl LoggedCycle {
    /// The samples that led to the cycle, the frame last.
    ///
    /// With `sight` the frame is the image if the log holds it exactly; else, and without, what was found in it stands in.
    pub fn samples(&self, sight: bool) -> Result<Vec<Sample>> {
        let mut samples = self.cycle.inputs.sorted_samples();
        let exact = self
            .image
            .as_ref()
            .filter(|image| sight && image.compression == ImageCompression::Png);
        let content = match (exact, &self.cycle.fault) {
            (Some(image), _) => ImageContent::Pixels(image.decode()?.into()),
            (None, Some(fault)) => ImageContent::Unreadable(fault.clone()),
            (None, None) => match &self.cycle.detections {
                Some(seen) => ImageContent::Detections(Box::new(seen.clone())),
                None => ImageContent::Features {
                    points: self.cycle.line_points.clone(),
                    goals: Vec::new(),
                },
            },
        };
        samples.push(Sample::Image(CameraImage {
            stamp: self.cycle.stamp,
            content,
        }));
        Ok(samples)
    }
}
