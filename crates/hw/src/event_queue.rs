//! In which order does the cycle meet what the devices say? One bounded queue for all: newest frame, every sample.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use localize::sample::{Compass, Imu, Odometry, VelocityCommand};

use crate::base::{KickerReport, PowerReport, SwitchReport};
use crate::camera::CapturedImage;
use crate::health::HealthReport;

/// What a device delivers.
#[derive(Debug, Clone, PartialEq)]
pub enum DeviceEvent {
    /// A frame of the camera.
    Image(CapturedImage),
    /// Motion by the wheels.
    Odometry(Odometry),
    /// What the wheels were told.
    Command(VelocityCommand),
    /// The inertial unit.
    Imu(Imu),
    /// The compass.
    Compass(Compass),
    /// Battery and motors.
    Power(PowerReport),
    /// The kicker.
    Kicker(KickerReport),
    /// Bumpers and emergency stop.
    Switches(SwitchReport),
    /// A device changed its state.
    Health(HealthReport),
}

/// How much was dropped because nobody took it in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DroppedInputs {
    /// Frames that a newer one replaced.
    pub images: u64,
    /// Samples that gave way to newer ones.
    pub samples: u64,
}

/// The queue between the devices' threads and the one that takes; clones are the same queue.
#[derive(Debug, Clone)]
pub struct EventQueue {
    shared: Arc<SharedQueue>,
}

#[derive(Debug)]
struct SharedQueue {
    state: Mutex<PendingInputs>,
    not_empty: Condvar,
}

#[derive(Debug)]
struct PendingInputs {
    samples: VecDeque<DeviceEvent>,
    samples_max: usize,
    image: Option<CapturedImage>,
    dropped: DroppedInputs,
}

impl EventQueue {
    /// A queue of one frame and at most `samples_max` samples; the oldest give way.
    ///
    /// 1024 samples are more than a second of every device that is spoken to here.
    pub fn new(samples_max: usize) -> Self {
        let queue = PendingInputs {
            samples: VecDeque::with_capacity(samples_max),
            samples_max: samples_max.max(1),
            image: None,
            dropped: DroppedInputs::default(),
        };
        let shared = SharedQueue {
            state: Mutex::new(queue),
            not_empty: Condvar::new(),
        };
        EventQueue {
            shared: Arc::new(shared),
        }
    }

    fn lock(&self) -> MutexGuard<'_, PendingInputs> {
        self.shared
            .state
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts something in; never waits for whoever takes it out.
    pub fn push(&self, event: DeviceEvent) {
        let mut queue = self.lock();
        if let DeviceEvent::Image(frame) = event {
            let replaced = queue.image.replace(frame);
            queue.dropped.images += u64::from(replaced.is_some());
        } else {
            if queue.samples.len() == queue.samples_max {
                queue.samples.pop_front();
                queue.dropped.samples += 1;
            }
            queue.samples.push_back(event);
        }
        drop(queue);
        self.shared.not_empty.notify_one();
    }

    /// Takes the oldest sample, or the frame when no sample is left; waits for either so long at most.
    ///
    /// Samples go first: a frame's exposure lies before the samples that arrived while it was read out.
    pub fn pop_timeout(&self, patience: Duration) -> Option<DeviceEvent> {
        let empty = |queue: &mut PendingInputs| queue.samples.is_empty() && queue.image.is_none();
        let (mut queue, _) = self
            .shared
            .not_empty
            .wait_timeout_while(self.lock(), patience, empty)
            .unwrap_or_else(PoisonError::into_inner);
        let sample = queue.samples.pop_front();
        sample.or_else(|| queue.image.take().map(DeviceEvent::Image))
    }

    /// How much was dropped so far.
    pub fn drop_counts(&self) -> DroppedInputs {
        self.lock().dropped
    }
}
