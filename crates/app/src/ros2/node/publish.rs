//! What does the node publish? Each cycle's messages, in a thread of its own that never holds up the run.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use anyhow::{Result, anyhow};
use hw::{HealthReport, HealthState};
use localize::{Field, Stamp};
use pipeline::Cycle;
use pipeline::feed::{RecvError, Subscription};
use pipeline::log::{EncodedImage, ImageCompression};
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{MessageTypeName, Name, Node, Publisher, QosProfile};
use serde::Serialize;

use super::super::config::Ros2Config;
use super::super::convert::{MessageConverter, Outgoing};
use super::super::frames::Frames;
use super::super::markers::field_markers;
use super::super::messages::{
    Byte, Bytes, Clock, CompressedImage, Detection3DArray, DiagnosticArray, DiagnosticStatus,
    Image, Imu, KeyValue, MarkerArray, Odometry, PointCloud2, PoseWithCovarianceStamped, RosType,
    TFMessage,
};
use super::super::odometry_frame::PlanarPose;
use super::super::primitives::{header, planar_transform, time};
use super::shared::Shared;
use crate::run::status::state_name;

/// Latency of a stop.
const POLL_PERIOD: Duration = Duration::from_millis(50);
/// Messages that a slow reader may be behind.
const DEPTH: usize = 10;

/// The publishers of the configured topics.
pub(super) struct Publishers {
    odometry: Option<Publisher<Odometry>>,
    pose: Option<Publisher<PoseWithCovarianceStamped>>,
    tf: Option<Publisher<TFMessage>>,
    tf_static: Option<Publisher<TFMessage>>,
    imu: Option<Publisher<Imu>>,
    image: Option<Publisher<Image>>,
    compressed_image: Option<Publisher<CompressedImage>>,
    line_points: Option<Publisher<PointCloud2>>,
    markers: Option<Publisher<MarkerArray>>,
    field: Option<Publisher<MarkerArray>>,
    detections: Option<Publisher<Detection3DArray>>,
    diagnostics: Option<Publisher<DiagnosticArray>>,
    clock: Option<Publisher<Clock>>,
}

/// Name of a message type.
pub(super) fn type_name<M: RosType>() -> MessageTypeName {
    let name = M::type_name();
    let (package, name) = name.split_once('/').unwrap_or(("", &name));
    MessageTypeName::new(package, name)
}

/// Name of a topic.
pub(super) fn topic_name(config: &Ros2Config, topic: &str) -> Result<Name> {
    Name::parse(&config.absolute(topic))
        .map_err(|error| anyhow!("[ros2] invalid name {topic:?}: {error:?}"))
}

fn publisher<M: RosType + Serialize>(
    node: &mut Node,
    config: &Ros2Config,
    topic: &str,
    durability: Durability,
) -> Result<Option<Publisher<M>>> {
    if topic.is_empty() {
        return Ok(None);
    }
    // Reliable, because readers of either kind accept it. A reader that takes nothing is not waited for.
    let depth = match durability {
        Durability::Volatile => DEPTH,
        Durability::TransientLocal => 1,
    };
    let qos = QosProfile::publisher_default()
        .reliability(Reliability::Reliable {
            when_full: WhenFull::Fail,
        })
        .durability(durability)
        .history(History::KeepLast { depth });
    let created = topic_name(config, topic)?;
    node.create_topic(&created, type_name::<M>(), &qos)
        .and_then(|created| node.create_publisher(&created, None))
        .map(Some)
        .map_err(|error| anyhow!("[ros2] cannot publish {topic}: {error}"))
}

impl Publishers {
    pub(super) fn create(node: &mut Node, config: &Ros2Config) -> Result<Self> {
        let topics = &config.outputs;
        let (now, late) = (Durability::Volatile, Durability::TransientLocal);
        let odometry = match config.inputs.odometry.as_str() {
            "" => topics.odometry.as_str(),
            _ => "",
        };
        Ok(Publishers {
            odometry: publisher(node, config, odometry, now)?,
            pose: publisher(node, config, &topics.pose, now)?,
            tf: publisher(node, config, &topics.tf, now)?,
            tf_static: publisher(node, config, &topics.tf_static, late)?,
            imu: publisher(node, config, &topics.imu, now)?,
            image: publisher(node, config, &topics.image, now)?,
            compressed_image: publisher(node, config, &topics.compressed_image, now)?,
            line_points: publisher(node, config, &topics.line_points, now)?,
            markers: publisher(node, config, &topics.markers, now)?,
            field: publisher(node, config, &topics.field, late)?,
            detections: publisher(node, config, &topics.detections, now)?,
            diagnostics: publisher(node, config, &topics.diagnostics, now)?,
            clock: publisher(node, config, &topics.clock, now)?,
        })
    }
}

/// The publishing thread.
pub(super) struct PublishLoop {
    pub(super) cycles: Subscription,
    pub(super) converter: MessageConverter,
    /// Those of a domain that was joined, again after an outage.
    pub(super) renewed: Receiver<Publishers>,
    pub(super) field: Field,
    /// Of the pinhole above the ground, metres.
    pub(super) camera_height: Option<f32>,
    pub(super) shared: Arc<Shared>,
    pub(super) jpeg_quality: u8,
    pub(super) frames: Frames,
    pub(super) has_external_odometry: bool,
}

impl PublishLoop {
    /// Publishes what does not change.
    fn publish_static(&self, publishers: &Publishers) {
        let now_ns = self.converter.time_ns(hw::now());
        let markings = field_markers(&self.field, header(now_ns, &self.frames.map));
        self.publish(&publishers.field, markings);
        if let Some(height) = self.camera_height {
            let names = [&*self.frames.base, &*self.frames.camera];
            let camera = planar_transform(now_ns, names, PlanarPose::default(), height.into());
            let transforms = vec![camera];
            self.publish(&publishers.tf_static, TFMessage { transforms });
        }
    }

    /// Publishes cycles until the feed ends or the node stops.
    pub(super) fn run(mut self) {
        hw::realtime::lower_priority();
        // The domain was joined before this thread was started.
        let Ok(mut publishers) = self.renewed.recv() else {
            return;
        };
        self.publish_static(&publishers);
        while !self.shared.stop_requested.load(Ordering::Relaxed) {
            if let Some(renewed) = self.renewed.try_iter().last() {
                publishers = renewed;
                self.publish_static(&publishers);
            }
            let (cycle, dropped) = match self.cycles.recv_indexed(POLL_PERIOD) {
                Ok(((_, cycle), dropped)) => (cycle, dropped.cycles),
                Err(RecvError::Timeout) => continue,
                Err(RecvError::Closed) => return,
            };
            self.shared.cycles_dropped.store(dropped, Ordering::Relaxed);
            self.publish_cycle(&publishers, &cycle);
        }
    }

    fn publish_cycle(&mut self, publishers: &Publishers, cycle: &Cycle) {
        // The wall clock is slewed while the robot runs.
        self.converter.set_clock_offset_ns(hw::realtime_offset_ns());
        let external = self
            .has_external_odometry
            .then(|| external_pose(&self.shared, cycle.stamp))
            .flatten();
        self.converter
            .set_external_odometry(self.has_external_odometry, external);
        for (_, message) in self.converter.messages(cycle) {
            match message {
                Outgoing::Odometry(message) => self.publish(&publishers.odometry, *message),
                Outgoing::Pose(message) => self.publish(&publishers.pose, message),
                Outgoing::Transforms(message) => self.publish(&publishers.tf, message),
                Outgoing::Imu(message) => self.publish(&publishers.imu, message),
                Outgoing::LinePoints(message) => self.publish(&publishers.line_points, message),
                Outgoing::Markers(message) => self.publish(&publishers.markers, message),
                Outgoing::Detections(message) => self.publish(&publishers.detections, message),
                Outgoing::Diagnostics(mut message) => {
                    let state = self.shared.lock();
                    message
                        .status
                        .extend(state.devices.values().map(device_status));
                    drop(state);
                    self.publish(&publishers.diagnostics, message);
                }
                // Bags hold them for `import`; the node has no topics for them.
                Outgoing::Compass(_) | Outgoing::MagneticField(_) => {}
                // A robot does not know the truth.
                Outgoing::Truth(_) => {}
            }
        }
        let stamp_ns = self.converter.time_ns(cycle.stamp);
        self.publish_images(publishers, cycle, stamp_ns);
        let clock = time(stamp_ns);
        self.publish(&publishers.clock, Clock { clock });
    }

    fn publish_images(&self, publishers: &Publishers, cycle: &Cycle, stamp_ns: i64) {
        if publishers.image.is_none() && publishers.compressed_image.is_none() {
            return;
        }
        let Some(rgb) = cycle.inputs.image.as_ref().and_then(|image| image.to_rgb()) else {
            return;
        };
        let header = header(stamp_ns, &self.frames.camera);
        if publishers.compressed_image.is_some() {
            // An image that does not become JPEG is left out.
            let encoded = EncodedImage::new(&rgb, ImageCompression::Jpeg, self.jpeg_quality);
            if let Ok(Some(encoded)) = encoded {
                let message = CompressedImage {
                    header: header.clone(),
                    format: "jpeg".to_owned(),
                    data: Bytes(encoded.bytes),
                };
                self.publish(&publishers.compressed_image, message);
            }
        }
        if publishers.image.is_some() {
            let message = Image {
                header,
                height: rgb.height_px as u32,
                width: rgb.width_px as u32,
                encoding: "rgb8".to_owned(),
                is_bigendian: 0,
                step: 3 * rgb.width_px as u32,
                data: Bytes(rgb.rgb.clone()),
            };
            self.publish(&publishers.image, message);
        }
    }

    fn publish<M: Serialize>(&self, publisher: &Option<Publisher<M>>, message: M) {
        let Some(publisher) = publisher else { return };
        let count = match publisher.publish(message) {
            Ok(()) => &self.shared.published,
            Err(_full) => &self.shared.failed,
        };
        count.fetch_add(1, Ordering::Relaxed);
    }
}

/// The pose of another program's base at a time, between or shortly after its messages.
fn external_pose(shared: &Shared, stamp: Stamp) -> Option<PlanarPose> {
    let state = shared.lock();
    let poses = &state.external_odometry;
    let after = poses.iter().position(|(at, _)| *at >= stamp);
    let (first, second) = match after {
        Some(0) => return poses.front().map(|(_, pose)| *pose),
        Some(index) => (poses[index - 1], poses[index]),
        None if poses.len() >= 2 => (poses[poses.len() - 2], poses[poses.len() - 1]),
        None => return poses.back().map(|(_, pose)| *pose),
    };
    let ((from, start), (to, end)) = (first, second);
    // Half a second beyond the last message at most.
    let part =
        ((stamp - from) / (to - from).max(1e-6)).clamp(0.0, 1.0 + 0.5 / (to - from).max(1e-3));
    Some(PlanarPose {
        x: start.x + part * (end.x - start.x),
        y: start.y + part * (end.y - start.y),
        theta: start.theta + part * (end.theta - start.theta),
    })
}

fn device_status(health: &HealthReport) -> DiagnosticStatus {
    let value = |key: &str, value: String| KeyValue {
        key: key.to_owned(),
        value,
    };
    DiagnosticStatus {
        level: Byte(if health.state == HealthState::Running {
            0
        } else {
            2
        }),
        name: format!("mirrorball: {}", health.device),
        message: health
            .reason
            .clone()
            .unwrap_or_else(|| state_name(health.state).to_owned()),
        hardware_id: health.device.clone(),
        values: vec![
            value("rate_hz", health.rate_hz.to_string()),
            value("messages", health.messages.to_string()),
            value("damaged", health.damaged.to_string()),
            value("reopened", health.reopened.to_string()),
        ],
    }
}
