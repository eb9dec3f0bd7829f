//! A node of ROS 2, by a DDS implementation in Rust: publishes cycles, and passes what others send to the run.

mod command_guard;
mod given_pose;
mod inputs;
mod membership;
mod outage;
mod parameters;
mod publish;
mod shared;
mod subscriptions;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::Result;
use hw::{EventQueue, HealthReport};
use localize::Field;
use localize::filter::FilterConfig;
use pipeline::feed::Feed;

use super::config::Ros2Config;
use super::convert::MessageConverter;
use membership::{MembershipKeeper, Topics};
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
    threads: Vec<JoinHandle<()>>,
}

impl RosNode {
    /// Joins the domain and starts the threads.
    pub(crate) fn start(
        config: &Ros2Config,
        feed: &Feed,
        context: &NodeContext<'_>,
        drive: Box<Drive>,
    ) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let (to_publisher, renewed) = sync_channel(1);
        let (to_receiver, subscriptions) = sync_channel(1);
        let topics = Topics {
            publishers: to_publisher,
            subscriptions: to_receiver,
        };
        let tuning = context.tuning.clone();
        let keeper = MembershipKeeper::start(config.clone(), tuning, topics, shared.clone())?;
        let (poses, given_poses): (SyncSender<GivenPose>, _) = sync_channel(1);
        let publisher = publish::PublishLoop {
            cycles: feed.subscribe(CYCLE_QUEUE_CAPACITY),
            converter: MessageConverter::new(
                config.frames.clone(),
                hw::realtime_offset_ns(),
                context.filter,
            ),
            renewed,
            field: context.field.clone(),
            camera_height: context.camera_height,
            shared: shared.clone(),
            jpeg_quality: config.jpeg_quality,
            frames: config.frames.clone(),
            has_external_odometry: !config.inputs.odometry.is_empty(),
        };
        let handler = inputs::InputHandler::new(config, shared.clone(), poses, drive);
        let mut started = RosNode {
            shared,
            given_poses,
            threads: vec![keeper],
        };
        started.spawn("ros2 publish", move || publisher.run())?;
        started.spawn("ros2 receive", move || {
            subscriptions::receive_all(&subscriptions, handler);
        })?;
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
        for thread in &self.threads {
            thread.thread().unpark();
        }
        for thread in self.threads.drain(..) {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
    }
}
