//! What did a log record? A header, then cycles in the order of writing, one at a time in memory.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use localize::Stamp;
use mcap::records::Record;
use prost::Message;

use super::encoded_image::{EncodedImage, ImageCompression};
use super::header::{Header, translate_files};
use super::header_records::HeaderRecords;
use super::limits::check_message;
use super::mcap_records::{LogCompleteness, RecordReader};
use super::schema::{CYCLE_TOPIC, IMAGE_TOPIC, convert, decode_compressed_image, wire};
use crate::csv_table::format_seconds;
use crate::cycle::Cycle;
use crate::sample::{CameraImage, ImageContent, Sample, SettingsChange};

/// An open log as an iterator of its cycles.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use std::path::Path;
/// use std::sync::Arc;
///
/// use pipeline::log::{LogConfig, LogReader, start_log};
/// use pipeline::recording::Recording;
/// use pipeline::setup::Setup;
/// use pipeline::{Pipeline, PipelineConfig};
///
/// let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
/// let (setup, config) = (Setup::load(&folder.join("robot.toml"), None)?, PipelineConfig::default());
/// let out = tempfile::tempdir()?;
/// let path = out.path().join("run.mcap");
/// let mut recorder = start_log(&path, "example", None, (&setup, &config), &LogConfig::default())?;
/// let mut pipeline = Pipeline::new(&setup, &config)?;
/// for cycle in Recording::open(&folder, 0.04)?.filter_map(|sample| pipeline.process_sample(sample)) {
///     recorder.record_cycle(Arc::new(cycle))?;
/// }
/// assert_eq!(recorder.finish()?.cycles, 20);
///
/// let log = LogReader::open(&path)?;
/// assert!(log.header().files.contains_key("pipeline.toml"));
/// for logged in log {
///     println!("{:?}", logged?.cycle.estimate.pose);
/// }
/// # Ok(())
/// # }
/// ```
pub struct LogReader {
    path: PathBuf,
    header: Header,
    stream: RecordReader,
    /// The first record after the header.
    pending_record: Option<Record<'static>>,
    topics: HashMap<u16, TopicKind>,
    assembler: CycleAssembler,
    /// Time and content of the last cycle's message.
    last_message: Option<(u64, Cow<'static, [u8]>)>,
    last_stamp: Option<Stamp>,
    failed: bool,
}

/// Content of a topic's messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TopicKind {
    /// A cycle without its image.
    Cycle,
    /// The image of the cycle that follows.
    Image,
    /// Data for viewers, which the cycle contains as well.
    Other,
}

impl TopicKind {
    /// The kind of a topic by its name.
    pub fn from_name(name: &str) -> Self {
        match name {
            CYCLE_TOPIC => TopicKind::Cycle,
            IMAGE_TOPIC => TopicKind::Image,
            _ => TopicKind::Other,
        }
    }
}

/// Assembles cycles from the messages of a log or a live stream.
#[derive(Default)]
pub struct CycleAssembler {
    image: Option<(u64, EncodedImage)>,
    /// An image was not followed by its cycle.
    lost_image: bool,
}

impl CycleAssembler {
    /// Adds a message. The message of the cycle itself is the last one of each cycle.
    pub fn push_message(
        &mut self,
        topic: TopicKind,
        log_time: u64,
        data: &[u8],
    ) -> Result<Option<LoggedCycle>> {
        match topic {
            TopicKind::Image => {
                let image = decode_compressed_image(data)?;
                self.lost_image |= self.image.replace((log_time, image)).is_some();
            }
            TopicKind::Cycle => return self.assemble_cycle(log_time, data).map(Some),
            TopicKind::Other => {}
        }
        Ok(None)
    }

    fn assemble_cycle(&mut self, log_time: u64, data: &[u8]) -> Result<LoggedCycle> {
        check_message(data)?;
        let message = wire::Cycle::decode(data)?;
        let index = message.index;
        // A recovered log may lack the image's chunk, and a slow viewer the image.
        let last = self.image.take();
        let image = last.filter(|(time, _)| {
            self.lost_image |= *time != log_time;
            *time == log_time
        });
        let image = image.map(|(_, image)| image);
        let cycle = convert::cycle_from_wire(message)?;
        Ok(LoggedCycle {
            index,
            cycle,
            image,
        })
    }
}

/// A recorded cycle.
#[derive(Debug, Clone)]
pub struct LoggedCycle {
    /// Number from 0. A gap is a dropped cycle.
    pub index: u64,
    /// The cycle, without its image.
    pub cycle: Cycle,
    /// The image, still encoded.
    pub image: Option<EncodedImage>,
}

impl LogReader {
    /// Opens a log and reads its header.
    ///
    /// Rejects files that are not MCAP, not a log of Mirrorball, or of another log format.
    pub fn open(path: &Path) -> Result<Self> {
        let mut stream = RecordReader::open(path)?;
        let (mut records, first) = HeaderRecords::read_first(&mut stream);
        let first = first.map_err(|damage| damage.to_error(path))?;
        if stream.is_cut_within_attachment() {
            bail!(
                "{} is truncated within the files of its set-up, before its first image: nothing can be read of it. \
                 Copy the log again",
                path.display()
            );
        }
        records.add_later(path)?;
        let Some(metadata) = records.metadata else {
            bail!(
                "{} is an MCAP file, but no log of mirrorball",
                path.display()
            );
        };
        Ok(LogReader {
            path: path.to_owned(),
            header: Header {
                files: translate_files(records.files),
                ..Header::from_metadata(&metadata, path)?
            },
            stream,
            pending_record: first,
            topics: HashMap::new(),
            assembler: CycleAssembler::default(),
            last_message: None,
            last_stamp: None,
            failed: false,
        })
    }

    /// The log's metadata and files.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How the log ended. None before the end is read.
    pub fn end(&self) -> Option<LogCompleteness> {
        self.stream.end()
    }

    /// True if some of the images that were read up to now do not stand in front of their cycles.
    pub(super) fn has_displaced_images(&self) -> bool {
        self.assembler.lost_image || self.assembler.image.is_some()
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
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
                    let message = (header.log_time, data);
                    // Programs that join logs may write a message twice.
                    if *topic == TopicKind::Cycle && self.last_message.as_ref() == Some(&message) {
                        continue;
                    }
                    let logged =
                        self.assembler
                            .push_message(*topic, header.log_time, &message.1)?;
                    if let Some(logged) = logged {
                        self.last_stamp = Some(logged.cycle.stamp);
                        self.last_message = Some(message);
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

    /// The next cycle. An error ends the iteration.
    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.read_next().with_context(|| match self.last_stamp {
            Some(until) => format!(
                "{}: after the cycle at {} s",
                self.path.display(),
                format_seconds(until)
            ),
            None => format!("{}: before its first cycle", self.path.display()),
        });
        self.failed = next.is_err();
        next.transpose()
    }
}

impl LoggedCycle {
    /// True if the cycle holds the state that it needs: a replay can start here.
    pub fn starts_replay(&self) -> bool {
        let inputs = &self.cycle.inputs;
        inputs.changed_config_toml.is_some() && inputs.warm_start.is_some()
    }

    /// The samples of the cycle: first changed settings, last the image.
    ///
    /// With `pixels`, the image holds its pixels if the log stored them losslessly. Otherwise it holds the detections.
    pub fn samples(&self, pixels: bool) -> Result<Vec<Sample>> {
        let inputs = &self.cycle.inputs;
        let change = inputs
            .changed_config_toml
            .as_ref()
            .map(|config_toml| SettingsChange {
                config_toml: config_toml.clone(),
                warm_start: inputs.warm_start.clone(),
            });
        let mut samples: Vec<Sample> = change.map(Sample::Settings).into_iter().collect();
        samples.extend(inputs.setup_doubt.map(Sample::SetupDoubt));
        samples.extend(inputs.map_fit.clone().map(Sample::MapFit));
        samples.extend(self.cycle.inputs.sorted_samples());
        let exact = self
            .image
            .as_ref()
            .filter(|image| pixels && image.compression == ImageCompression::Png);
        let content = match (exact, &self.cycle.image_fault) {
            (Some(image), _) => ImageContent::Pixels(image.decode()?.into()),
            (None, Some(fault)) => ImageContent::Unreadable(fault.clone()),
            (None, None) => match &self.cycle.detections {
                Some(detections) => ImageContent::Detections(Box::new(detections.clone())),
                None => ImageContent::Features {
                    points: self.cycle.line_points.clone(),
                    goals: Vec::new(),
                },
            },
        };
        samples.push(Sample::Image(CameraImage {
            stamp: self.cycle.stamp,
            setting: self.cycle.inputs.exposure_setting,
            content,
        }));
        Ok(samples)
    }
}
