//! Which topics does a log have, with which schemas? Only this module, `sink` and `live_topics` use foxglove's SDK.
//!
//! Each message is logged once. All sinks of the context (a file, viewers) receive it.

pub(crate) mod convert;
pub(crate) mod file;
pub(crate) mod image_annotations;
pub(crate) mod robot_model;
pub(crate) mod scene;
mod sink;
pub mod wire;
mod wire_detections;
mod wire_geometry;
mod wire_world;

use std::sync::Arc;

use anyhow::{Context as _, Result};
pub(crate) use foxglove::messages::log::Level;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransforms, ImageAnnotations, Log, PointCloud,
    PoseInFrame, PosesInFrame, SceneUpdate, Timestamp,
};
use foxglove::prost_types::FileDescriptorSet;
use foxglove::{Channel, Encode, PartialMetadata, RawChannel, Schema};
pub use foxglove::{Context, SinkId};
use localize::Stamp;
use prost::Message;

pub(crate) use sink::Sink;

use super::encoded_image::{EncodedImage, ImageCompression};

/// Format of our own topics and records. Other formats are rejected.
pub(crate) const FORMAT_VERSION: u32 = 2;
/// Name of the metadata record that marks an MCAP file as a log of Mirrorball.
pub const PROJECT_NAME: &str = "mirrorball";
/// Topic of `wire::Cycle`, which has all data that replay needs.
pub const CYCLE_TOPIC: &str = "/cycle";
/// Topic of `wire::About`, the first message of a live stream.
pub const ABOUT_TOPIC: &str = "/about";
/// Topics of the field's markings, which a viewer gets when it subscribes.
pub const FIELD_LINES_TOPIC: &str = "/field/lines";
/// The markings as lines, and all objects.
pub const FIELD_SCENE_TOPIC: &str = "/field/scene";
/// Topic of the camera's intrinsics.
pub const CALIBRATION_TOPIC: &str = "/camera/calibration";
/// Topic of the images.
pub const IMAGE_TOPIC: &str = "/camera/image";

/// Name of the camera frame in viewers: x to the image's right, y down, z along the view.
const CAMERA_FRAME: &str = "camera";

/// The channels of a run. Their messages go to all sinks of the context.
pub struct Topics {
    image: FoxgloveChannel<CompressedImage>,
    pub(crate) calibration: FoxgloveChannel<CameraCalibration>,
    pub(crate) annotations: FoxgloveChannel<ImageAnnotations>,
    pub(crate) line_points: FoxgloveChannel<PointCloud>,
    pub(crate) ball: CustomChannel<wire::Ball>,
    pub(crate) robots: CustomChannel<wire::Robots>,
    pub(crate) sensors: CustomChannel<wire::Sensors>,
    pub(crate) odometry: CustomChannel<wire::Odometry>,
    pub(crate) imu: CustomChannel<wire::Imu>,
    pub(crate) compass: CustomChannel<wire::Compass>,
    pub(crate) command: CustomChannel<wire::Command>,
    pub(crate) team: CustomChannel<wire::TeamView>,
    pub(crate) pose: FoxgloveChannel<PoseInFrame>,
    pub(crate) map_correction: CustomChannel<wire::MapCorrection>,
    pub(crate) particles: FoxgloveChannel<PosesInFrame>,
    pub(crate) truth: FoxgloveChannel<PoseInFrame>,
    pub(crate) pose_error: CustomChannel<wire::PoseError>,
    pub(crate) transforms: FoxgloveChannel<FrameTransforms>,
    pub(crate) field_lines: FoxgloveChannel<PointCloud>,
    pub(crate) scene: FoxgloveChannel<SceneUpdate>,
    pub(crate) cycle: CustomChannel<wire::Cycle>,
    log: FoxgloveChannel<Log>,
}

impl Topics {
    /// Opens all channels of a run in a context.
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        Ok(Topics {
            image: FoxgloveChannel::new(context, IMAGE_TOPIC),
            calibration: FoxgloveChannel::new(context, CALIBRATION_TOPIC),
            annotations: FoxgloveChannel::new(context, "/camera/annotations"),
            line_points: FoxgloveChannel::new(context, "/vision/line_points"),
            ball: CustomChannel::new(context, "/vision/ball")?,
            robots: CustomChannel::new(context, "/vision/robots")?,
            sensors: CustomChannel::new(context, "/vision/sensors")?,
            odometry: CustomChannel::new(context, "/odometry")?,
            imu: CustomChannel::new(context, "/imu")?,
            compass: CustomChannel::new(context, "/compass")?,
            command: CustomChannel::new(context, "/command")?,
            team: CustomChannel::new(context, "/team")?,
            pose: FoxgloveChannel::new(context, "/pose"),
            map_correction: CustomChannel::new(context, "/map/correction")?,
            particles: FoxgloveChannel::new(context, "/pose/particles"),
            truth: FoxgloveChannel::new(context, "/truth/pose"),
            pose_error: CustomChannel::new(context, "/truth/error")?,
            transforms: FoxgloveChannel::new(context, "/tf"),
            field_lines: FoxgloveChannel::new(context, FIELD_LINES_TOPIC),
            scene: FoxgloveChannel::new(context, FIELD_SCENE_TOPIC),
            cycle: CustomChannel::new(context, CYCLE_TOPIC)?,
            log: FoxgloveChannel::new(context, "/log"),
        })
    }

    /// True if a sink receives images. Encoding images takes most of the time, so it is skipped without one.
    pub(crate) fn has_image_sinks(&self) -> bool {
        self.image.0.has_sinks()
    }

    /// Logs an encoded image.
    pub(crate) fn publish_image(&self, image: EncodedImage, stamp: Stamp) {
        let message = CompressedImage {
            timestamp: timestamp(stamp),
            frame_id: CAMERA_FRAME.to_owned(),
            format: image.compression.name().to_owned(),
            data: image.bytes.into(),
        };
        self.image.log_at(&message, stamp);
    }

    /// Logs a line of text.
    pub(crate) fn log_message(&self, stamp: Stamp, level: Level, message: String) {
        let line = Log {
            timestamp: timestamp(stamp),
            level: level as i32,
            message,
            name: PROJECT_NAME.to_owned(),
            ..Log::default()
        };
        self.log.log_at(&line, stamp);
    }
}

/// A channel of one of foxglove's messages, which viewers support.
pub(crate) struct FoxgloveChannel<M: Encode>(Channel<M>);

impl<M: Encode> FoxgloveChannel<M> {
    fn new(context: &Arc<Context>, topic: &str) -> Self {
        FoxgloveChannel(context.channel_builder(topic).build())
    }

    /// Logs a message.
    pub(crate) fn log_at(&self, message: &M, stamp: Stamp) {
        self.log_to(message, stamp, None);
    }

    /// Logs a message for one subscriber, or for all if there is none.
    pub(crate) fn log_to(&self, message: &M, stamp: Stamp, subscriber: Option<SinkId>) {
        let meta = PartialMetadata::with_log_time(log_time(stamp));
        self.0.log_with_meta_to_sink(message, meta, subscriber);
    }
}

/// A channel of one of our own messages.
pub struct CustomChannel<M> {
    channel: Arc<RawChannel>,
    message: std::marker::PhantomData<M>,
}

impl<M: Message + Encode> CustomChannel<M> {
    /// Opens the channel of a topic.
    pub fn new(context: &Arc<Context>, topic: &str) -> Result<Self> {
        let channel = context
            .channel_builder(topic)
            .message_encoding("protobuf")
            .schema(custom_schema::<M>()?)
            .build_raw()?;
        Ok(CustomChannel {
            channel,
            message: std::marker::PhantomData,
        })
    }

    /// Logs a message.
    pub fn log_at(&self, message: &M, stamp: Stamp) {
        self.log_to(message, stamp, None);
    }

    /// Logs a message for one subscriber, or for all if there is none.
    pub fn log_to(&self, message: &M, stamp: Stamp, subscriber: Option<SinkId>) {
        let meta = PartialMetadata::with_log_time(log_time(stamp));
        self.channel
            .log_with_meta_to_sink(&Message::encode_to_vec(message), meta, subscriber);
    }
}

/// Derived schema with our own package name: `mirrorball.Cycle` instead of `cycle.Cycle`.
fn custom_schema<M: Encode>() -> Result<Schema> {
    let derived = M::get_schema().context("a message of ours has no schema")?;
    let mut files = FileDescriptorSet::decode(&derived.data[..])?;
    for file in &mut files.file {
        file.package = Some(PROJECT_NAME.to_owned());
    }
    let message = derived.name.rsplit('.').next().unwrap_or(&derived.name);
    Ok(Schema::new(
        format!("{PROJECT_NAME}.{message}"),
        "protobuf",
        files.encode_to_vec(),
    ))
}

/// Stamp as MCAP log time. Stamps before the epoch become 0.
pub(crate) fn log_time(stamp: Stamp) -> u64 {
    stamp.0.max(0).unsigned_abs()
}

/// Stamp as a timestamp of foxglove's messages.
pub(crate) fn timestamp(stamp: Stamp) -> Option<Timestamp> {
    let (seconds, rest) = (
        log_time(stamp) / 1_000_000_000,
        log_time(stamp) % 1_000_000_000,
    );
    Timestamp::new_checked(u32::try_from(seconds).ok()?, rest as u32)
}

/// Decodes a message of [`IMAGE_TOPIC`].
pub(crate) fn decode_compressed_image(message: &[u8]) -> Result<EncodedImage> {
    let message = CompressedImage::decode(message)?;
    let mode = ImageCompression::from_name(&message.format)
        .with_context(|| format!("an image of the unknown format {:?}", message.format))?;
    Ok(EncodedImage {
        compression: mode,
        bytes: message.data.into(),
    })
}
