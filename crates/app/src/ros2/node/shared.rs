//! What do the node's threads share with the run?

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::sync::{Mutex, MutexGuard, PoisonError};

use hw::{EventQueue, HealthReport};
use localize::omni::Twist;
use localize::{Pose, Stamp};
use nalgebra::Matrix3;
use serde::Serialize;

use super::super::odometry_frame::PlanarPose;
use super::command_guard::Refusal;

/// A pose that another program has given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GivenPose {
    pub(crate) pose: Pose,
    pub(crate) covariance: Matrix3<f32>,
}

/// Executes a velocity command until a time; false if it is overruled.
pub(super) type Drive = dyn FnMut(Twist, Stamp) -> bool + Send;

/// What a run reports of its node.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct Ros2Counts {
    /// Messages given to DDS.
    pub(crate) published: u64,
    /// Messages that DDS did not take.
    pub(crate) failed: u64,
    /// Cycles that were dropped because publishing was too slow.
    pub(crate) cycles_dropped: u64,
    /// Samples received for the pipeline: images, wheels, inertial unit.
    pub(crate) samples: u64,
    /// Commands passed to the base.
    pub(crate) accepted: u64,
    /// Valid commands that were not executed: a higher priority, or no base.
    pub(crate) overruled: u64,
    /// Rejected commands by reason.
    pub(crate) refused: BTreeMap<Refusal, u64>,
}

/// What the node's threads share with the run.
#[derive(Default)]
pub(super) struct Shared {
    pub(super) stop_requested: AtomicBool,
    pub(super) published: AtomicU64,
    pub(super) failed: AtomicU64,
    pub(super) cycles_dropped: AtomicU64,
    pub(super) samples: AtomicU64,
    pub(super) state: Mutex<SharedState>,
}

#[derive(Default)]
pub(super) struct SharedState {
    pub(super) events: Option<EventQueue>,
    pub(super) notices: Vec<String>,
    pub(super) accepted: u64,
    pub(super) overruled: u64,
    pub(super) refused: BTreeMap<Refusal, u64>,
    pub(super) devices: BTreeMap<String, HealthReport>,
    /// The latest poses of another base in its frame `odom`, by the clock of samples.
    pub(super) external_odometry: VecDeque<(Stamp, PlanarPose)>,
}

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, SharedState> {
        // Plain values: valid even if a thread panicked with the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn notice(&self, text: String) {
        let mut state = self.lock();
        if !state.notices.contains(&text) && state.notices.len() < 64 {
            state.notices.push(text);
        }
    }
}
