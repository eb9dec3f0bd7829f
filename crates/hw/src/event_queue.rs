//! In which order are device events processed? One bounded queue for all: every sample, and the newest image.

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
    /// An image of the camera.
    Image(CapturedImage),
    /// Motion measured by the wheels.
    Odometry(Odometry),
    /// The velocity that was commanded.
    Command(VelocityCommand),
    /// Readings of the inertial unit.
    Imu(Imu),
    /// Heading of the compass.
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

/// Events that were dropped because the queue was full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DroppedInputs {
    /// Images that a newer one replaced, or that waited while this program was paused.
    pub images: u64,
    /// Samples that were dropped for newer ones.
    pub samples: u64,
}

/// The queue between the devices' threads and the consumer; clones share it.
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
    /// A queue of one image and at most `samples_max` samples; it drops the oldest.
    ///
    /// 1024 samples are more than a second of all supported devices together.
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

    /// Adds an event; never waits for the consumer.
    pub fn push(&self, event: DeviceEvent) {
        let mut queue = self.lock();
        if let DeviceEvent::Image(image) = event {
            let replaced = queue.image.replace(image);
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

    /// Removes the oldest sample, or the image if no sample is left; waits at most `timeout` for either.
    ///
    /// Samples go first: an image arrives after its exposure, and the samples of that time must be processed before it.
    pub fn pop_timeout(&self, timeout: Duration) -> Option<DeviceEvent> {
        let empty = |queue: &mut PendingInputs| queue.samples.is_empty() && queue.image.is_none();
        let (mut queue, _) = self
            .shared
            .not_empty
            .wait_timeout_while(self.lock(), timeout, empty)
            .unwrap_or_else(PoisonError::into_inner);
        let sample = queue.samples.pop_front();
        sample.or_else(|| queue.image.take().map(DeviceEvent::Image))
    }

    /// Removes the image, which was captured before this program was paused.
    pub(crate) fn discard_image(&self) {
        let mut queue = self.lock();
        let discarded = queue.image.take();
        queue.dropped.images += u64::from(discarded.is_some());
    }

    /// Events dropped so far.
    pub fn drop_counts(&self) -> DroppedInputs {
        self.lock().dropped
    }
}
