//! What did a log record? Its header, then cycle after cycle in the order of their writing, one in memory at a time.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use localize::Stamp;
use mcap::records::Record;
use prost::Message;

use super::header::Header;
use super::picture::{Encoded, ImageMode};
use super::schema::{ABOUT, CYCLE_TOPIC, IMAGE_TOPIC, convert, picture_from_bytes, wire};
use super::stream::{End, Stream};
use crate::cycle::Cycle;
use crate::sample::{Content, Frame, Sample};

/// A log that is being read; iterate for its cycles.
pub struct Log {
    path: PathBuf,
    header: Header,
    stream: Stream,
    /// What the reader met first behind the header.
    first: Option<Record<'static>>,
    topics: HashMap<u16, Topic>,
    assembler: Assembler,
    until: Option<Stamp>,
    failed: bool,
}

/// What the messages of a topic are to a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic {
    /// Everything of a cycle but its image.
    Cycle,
    /// The image of the cycle that follows.
    Image,
    /// For viewers: the cycle says it too.
    Other,
}

impl Topic {
    /// What a topic of that name is.
    pub fn named(name: &str) -> Self {
        match name {
            CYCLE_TOPIC => Topic::Cycle,
            IMAGE_TOPIC => Topic::Image,
            _ => Topic::Other,
        }
    }
}

/// Puts cycles together from messages, those of a log and those of a live stream alike.
#[derive(Default)]
pub struct Assembler {
    image: Option<(u64, Encoded)>,
}

impl Assembler {
    /// Takes a message; a cycle's is the last of its cycle.
    pub fn message(&mut self, topic: Topic, log_time: u64, data: &[u8]) -> Result<Option<Logged>> {
        match topic {
            Topic::Image => self.image = Some((log_time, picture_from_bytes(data)?)),
            Topic::Cycle => return self.cycle(log_time, data).map(Some),
            Topic::Other => {}
        }
        Ok(None)
    }

    fn cycle(&mut self, log_time: u64, data: &[u8]) -> Result<Logged> {
        let message = wire::Cycle::decode(data)?;
        let index = message.index;
        // A recovered log may have lost an image with the chunk before its cycle's, a slow viewer either.
        let image = self
            .image
            .take()
            .filter(|(time, _)| *time == log_time)
            .map(|(_, image)| image);
        let cycle = convert::cycle_from_wire(message)?;
        Ok(Logged {
            index,
            cycle,
            image,
        })
    }
}

/// A cycle as it was recorded.
#[derive(Debug, Clone)]
pub struct Logged {
    /// Counts from 0; a gap is a cycle that was dropped.
    pub index: u64,
    /// The cycle; its image is beside it, still packed.
    pub cycle: Cycle,
    /// The image as the log holds it.
    pub image: Option<Encoded>,
}

impl Log {
    /// Opens a log and reads its header.
    ///
    /// What is no MCAP file, no log of ours, or a log of another form is refused.
    pub fn open(path: &Path) -> Result<Self> {
        let mut stream = Stream::open(path)?;
        let mut about = None;
        let mut files = std::collections::BTreeMap::new();
        let first = loop {
            let next = stream.next().map_err(|damage| damage.in_file(path))?;
            match next {
                Some(Record::Metadata(metadata)) if metadata.name == ABOUT => {
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
        Ok(Log {
            path: path.to_owned(),
            header: Header { files, ..header },
            stream,
            first,
            topics: HashMap::new(),
            assembler: Assembler::default(),
            until: None,
            failed: false,
        })
    }

    /// What the log says of its run.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How the log ended; none while there is more to read.
    pub fn end(&self) -> Option<End> {
        self.stream.end()
    }

    fn advance(&mut self) -> Result<Option<Logged>> {
        loop {
            let record = match self.first.take() {
                Some(record) => record,
                None => match self
                    .stream
                    .next()
                    .map_err(|damage| damage.in_file(&self.path))?
                {
                    Some(record) => record,
                    None => return Ok(None),
                },
            };
            match record {
                Record::Channel(channel) => {
                    self.topics.insert(channel.id, Topic::named(&channel.topic));
                }
                Record::Message { header, data } => {
                    let Some(topic) = self.topics.get(&header.channel_id) else {
                        bail!("a message without a channel");
                    };
                    let logged = self.assembler.message(*topic, header.log_time, &data)?;
                    if let Some(logged) = logged {
                        self.until = Some(logged.cycle.stamp);
                        return Ok(Some(logged));
                    }
                }
                _ => {}
            }
        }
    }
}

impl Iterator for Log {
    type Item = Result<Logged>;

    /// The next cycle; after an error there is none.
    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.advance().with_context(|| match self.until {
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

impl Logged {
    /// The samples that led to the cycle, the frame last.
    ///
    /// With `sight` the frame is the image if the log holds it exactly; else, and without, what was found in it stands in.
    pub fn samples(&self, sight: bool) -> Result<Vec<Sample>> {
        let mut samples = self.cycle.inputs.in_order();
        let exact = self
            .image
            .as_ref()
            .filter(|image| sight && image.mode == ImageMode::Png);
        let content = match (exact, &self.cycle.fault) {
            (Some(image), _) => Content::Image(image.decode()?.into()),
            (None, Some(fault)) => Content::Unreadable(fault.clone()),
            (None, None) => match &self.cycle.seen {
                Some(seen) => Content::Seen(Box::new(seen.clone())),
                None => Content::Found {
                    points: self.cycle.points.clone(),
                    goals: Vec::new(),
                },
            },
        };
        samples.push(Sample::Frame(Frame {
            stamp: self.cycle.stamp,
            content,
        }));
        Ok(samples)
    }
}
