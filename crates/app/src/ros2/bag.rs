//! How does a log become a ROS 2 bag? An MCAP file whose messages are CDR, with the definition of each type.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use anyhow::{Context, Result, ensure};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use pipeline::csv_table::format_seconds;
use pipeline::log::{EncodedImage, ImageCompression, LogCompleteness, LogReader, UnpackedSetup};
use serde::Serialize;
use vision::output_file::OutputFile;

use super::cdr;
use super::convert::{MessageConverter, Outgoing};
use super::frames::Frames;
use super::markers::field_markers;
use super::messages::{Bytes, Clock, CompressedImage, RosType, TFMessage, schema_text};
use super::odometry_frame::PlanarPose;
use super::primitives::{header, planar_transform, time};

/// QoS of topics whose last message a late subscriber still gets, as rosbag2 stores it.
const LATCHED_QOS: &str = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false\n";

/// What an export wrote.
#[derive(Debug, Default, Serialize)]
pub(crate) struct BagSummary {
    /// Numbers of messages by topic.
    pub(crate) messages: BTreeMap<String, u64>,
    /// False for a truncated log.
    pub(crate) whole: bool,
}

/// Writes a log as a bag, which gets its name only when it is complete.
pub(crate) fn export(mut log: LogReader, path: &Path) -> Result<BagSummary> {
    let setup = UnpackedSetup::load(log.header())?;
    let config = setup.config()?;
    let clock_offset_ns = log.header().clock_offset_ns;
    let is_simulation = clock_offset_ns == 0;
    let frames = Frames::default();
    let mut converter =
        MessageConverter::new(frames.clone(), clock_offset_ns, &config.localize.filter);
    let context = || format!("cannot write {}", path.display());
    let mut bag = BagWriter::create(path).with_context(context)?;
    let camera_height = setup
        .setup
        .robot
        .camera
        .as_ref()
        .and_then(|camera| camera.height);
    let mut last_index = None;
    for (index, logged) in log.by_ref().enumerate() {
        let logged = logged?;
        // The frame `odom` adds up the motion of cycle after cycle.
        ensure!(
            last_index.replace(logged.index) <= Some(logged.index),
            "the log's messages are out of order: the cycle at {} s stands behind a later one. \
             Export it as a recording folder (--format recording)",
            format_seconds(logged.cycle.stamp)
        );
        let stamp_ns = converter.time_ns(logged.cycle.stamp);
        if index == 0 {
            let on_field = header(stamp_ns, &frames.map);
            let markings = field_markers(&setup.setup.field, on_field);
            bag.write("/field", stamp_ns, &markings)
                .with_context(context)?;
            if let Some(height) = camera_height {
                let names = [&*frames.base, &*frames.camera];
                let camera =
                    planar_transform(stamp_ns, names, PlanarPose::default(), height.into());
                let transforms = vec![camera];
                bag.write("/tf_static", stamp_ns, &TFMessage { transforms })
                    .with_context(context)?;
            }
        }
        for (message_ns, message) in converter.messages(&logged.cycle) {
            bag.write_outgoing(message_ns, &message)
                .with_context(context)?;
        }
        if let Some(image) = logged.image {
            let message = compressed_image(image, stamp_ns, &frames.camera);
            bag.write("/image/compressed", stamp_ns, &message)
                .with_context(context)?;
        }
        if is_simulation {
            let clock = time(stamp_ns);
            bag.write("/clock", stamp_ns, &Clock { clock })
                .with_context(context)?;
        }
    }
    let mut summary = bag.finish().with_context(context)?;
    summary.whole = log.end() == Some(LogCompleteness::Complete);
    Ok(summary)
}

fn compressed_image(image: EncodedImage, stamp_ns: i64, frame: &str) -> CompressedImage {
    let format = if image.compression == ImageCompression::Jpeg {
        "jpeg"
    } else {
        "png"
    };
    CompressedImage {
        header: header(stamp_ns, frame),
        format: format.to_owned(),
        data: Bytes(image.bytes),
    }
}

/// An MCAP file of the profile `ros2`.
struct BagWriter {
    mcap: Writer<OutputFile>,
    channels: HashMap<&'static str, Channel>,
}

struct Channel {
    id: u16,
    messages: u32,
}

impl BagWriter {
    fn create(path: &Path) -> Result<Self> {
        let file = OutputFile::create(path)?;
        let library = concat!("mirrorball ", env!("CARGO_PKG_VERSION"));
        let options = WriteOptions::new().profile("ros2").library(library);
        Ok(BagWriter {
            mcap: options.create(file)?,
            channels: HashMap::new(),
        })
    }

    fn write_outgoing(&mut self, stamp_ns: i64, message: &Outgoing) -> Result<()> {
        match message {
            Outgoing::Odometry(message) => self.write("/odom", stamp_ns, &**message),
            Outgoing::Pose(message) => self.write("/pose", stamp_ns, message),
            Outgoing::Transforms(message) => self.write("/tf", stamp_ns, message),
            Outgoing::Imu(message) => self.write("/imu", stamp_ns, message),
            Outgoing::Compass(message) => self.write("/compass", stamp_ns, message),
            Outgoing::MagneticField(message) => self.write("/magnetic_field", stamp_ns, message),
            Outgoing::LinePoints(message) => self.write("/line_points", stamp_ns, message),
            Outgoing::Markers(message) => self.write("/markers", stamp_ns, message),
            Outgoing::Detections(message) => self.write("/detections", stamp_ns, message),
            Outgoing::Diagnostics(message) => self.write("/diagnostics", stamp_ns, message),
            Outgoing::Truth(message) => self.write("/truth/pose", stamp_ns, message),
        }
    }

    fn write<M: RosType + Serialize>(
        &mut self,
        topic: &'static str,
        stamp_ns: i64,
        message: &M,
    ) -> Result<()> {
        let channel = match self.channels.entry(topic) {
            std::collections::hash_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::hash_map::Entry::Vacant(entry) => {
                let id = add_channel::<_, M>(&mut self.mcap, topic)?;
                entry.insert(Channel { id, messages: 0 })
            }
        };
        // A bag has no times before 1970.
        let time_ns = stamp_ns.max(0) as u64;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.messages,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.mcap
            .write_to_known_channel(&header, &cdr::encode(message)?)?;
        channel.messages += 1;
        Ok(())
    }

    fn finish(mut self) -> Result<BagSummary> {
        self.mcap.finish()?;
        let count = |(topic, channel): (&&str, &Channel)| {
            ((*topic).to_owned(), u64::from(channel.messages))
        };
        let messages: BTreeMap<String, u64> = self.channels.iter().map(count).collect();
        self.mcap.into_inner().finish()?;
        Ok(BagSummary {
            messages,
            whole: true,
        })
    }
}

fn add_channel<W: std::io::Write + std::io::Seek, M: RosType>(
    mcap: &mut Writer<W>,
    topic: &str,
) -> Result<u16> {
    let name = M::type_name().replacen('/', "/msg/", 1);
    let schema = mcap.add_schema(&name, "ros2msg", schema_text::<M>().as_bytes())?;
    let is_latched = matches!(topic, "/tf_static" | "/field");
    let qos = if is_latched { LATCHED_QOS } else { "" };
    let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), qos.to_owned())]);
    Ok(mcap.add_channel(schema, topic, "cdr", &metadata)?)
}
