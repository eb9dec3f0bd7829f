//! A node of ROS 2, by a DDS implementation in Rust: publishes cycles, and passes what others send to the run.

mod command_guard;
mod inputs;
mod parameters;
mod publish;
mod shared;

use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context as _, Result, anyhow};
use futures::channel::oneshot;
use futures::executor::block_on;
use hw::{EventQueue, HealthReport};
use localize::Field;
use localize::filter::FilterConfig;
use pipeline::feed::Feed;
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::{Context, Node, NodeName};

use super::config::Ros2Config;
use super::convert::MessageConverter;
use shared::{Drive, Shared};
pub(crate) use shared::{GivenPose, Ros2Counts};

use crate::run::tuning::TuningHandle;

/// Cycles that wait for the publisher; the oldest are dropped, images first.
const CYCLE_QUEUE_CAPACITY: usize = 16;

/// What a node needs to know of the robot.
pub(crate) struct NodeContext<'a> {
    pub(crate) field: &'a Field,
    pub(crate) filter: &'a FilterConfig,
    /// Of the pinhole above the ground, metres.
    pub(crate) camera_height: Option<f32>,
    /// Changes settings, if others may.
    pub(crate) tuning: Option<TuningHandle>,
}

/// A running node. Dropping it ends its threads and leaves the domain.
pub(crate) struct RosNode {
    shared: Arc<Shared>,
    given_poses: Receiver<GivenPose>,
    stop_receiving: Option<oneshot::Sender<()>>,
    threads: Vec<JoinHandle<()>>,
    /// Its services end with it.
    _node: Node,
}

impl RosNode {
    /// Joins the domain and starts the threads.
    pub(crate) fn start(
        config: &Ros2Config,
        feed: &Feed,
        context: &NodeContext<'_>,
        drive: Box<Drive>,
    ) -> Result<Self> {
        let participant = DomainParticipantBuilder::new(config.domain)
            .with_only_networks([IpAddr::V4(config.interface)])
            .build()
            .map_err(|error| anyhow!("{error}"))
            .with_context(|| format!("[ros2] cannot join domain {}", config.domain))?;
        let ros = Context::from_domain_participant(participant)
            .map_err(|error| anyhow!("[ros2] {error}"))?;
        let name = NodeName::new(&config.namespace, &config.node)
            .map_err(|error| anyhow!("[ros2] invalid node: {error:?}"))?;
        let is_started = Arc::new(AtomicBool::new(false));
        let options = parameters::options(config, context.tuning.as_ref(), is_started.clone());
        let mut node = ros
            .new_node(name, options)
            .map_err(|error| anyhow!("[ros2] {error}"))?;
        is_started.store(true, Ordering::Relaxed);
        let publishers = publish::Publishers::create(&mut node, config)?;
        let subscriptions = inputs::Subscriptions::create(&mut node, config)?;
        let spinner = node.spinner().map_err(|error| anyhow!("[ros2] {error}"))?;
        let shared = Arc::new(Shared::default());
        let (poses, given_poses): (SyncSender<GivenPose>, _) = sync_channel(1);
        let (stop_receiving, stopped) = oneshot::channel();
        let converter = MessageConverter::new(
            config.frames.clone(),
            hw::realtime_offset_ns(),
            context.filter,
        );
        let publisher = publish::PublishLoop {
            cycles: feed.subscribe(CYCLE_QUEUE_CAPACITY),
            converter,
            publishers,
            shared: shared.clone(),
            jpeg_quality: config.jpeg_quality,
            frames: config.frames.clone(),
            has_external_odometry: !config.inputs.odometry.is_empty(),
        };
        publisher.publish_static(context.field, context.camera_height);
        let handler = inputs::InputHandler::new(config, shared.clone(), poses, drive);
        let mut started = RosNode {
            shared,
            given_poses,
            stop_receiving: Some(stop_receiving),
            threads: Vec::new(),
            _node: node,
        };
        started.spawn("ros2 publish", move || publisher.run())?;
        started.spawn("ros2 receive", move || {
            inputs::receive(&subscriptions, handler, stopped);
        })?;
        // Ends when the node is dropped.
        std::thread::Builder::new()
            .name("ros2 services".to_owned())
            .spawn(move || drop(block_on(spinner.spin())))?;
        Ok(started)
    }

    fn spawn(&mut self, name: &str, run: impl FnOnce() + Send + 'static) -> Result<()> {
        let builder = std::thread::Builder::new().name(name.to_owned());
        self.threads.push(builder.spawn(run)?);
        Ok(())
    }

    /// Where samples of other programs go.
    pub(crate) fn attach_events(&self, events: &EventQueue) {
        self.shared.lock().events = Some(events.clone());
    }

    /// A device has changed its state.
    pub(crate) fn report_device(&self, health: &HealthReport) {
        let mut state = self.shared.lock();
        state.devices.insert(health.device.clone(), health.clone());
    }

    /// The last pose given since the last call.
    pub(crate) fn take_given_pose(&self) -> Option<GivenPose> {
        self.given_poses.try_iter().last()
    }

    /// Messages for the operator since the last call.
    pub(crate) fn take_notices(&self) -> Vec<String> {
        std::mem::take(&mut self.shared.lock().notices)
    }

    /// Counts since the start.
    pub(crate) fn counts(&self) -> Ros2Counts {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let state = self.shared.lock();
        Ros2Counts {
            published: load(&self.shared.published),
            failed: load(&self.shared.failed),
            cycles_dropped: load(&self.shared.cycles_dropped),
            samples: load(&self.shared.samples),
            accepted: state.accepted,
            overruled: state.overruled,
            refused: state.refused.clone(),
        }
    }
}

impl Drop for RosNode {
    fn drop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        if let Some(stop) = self.stop_receiving.take() {
            // The thread may have ended by itself.
            let _ended = stop.send(());
        }
        for thread in self.threads.drain(..) {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
    }
}
