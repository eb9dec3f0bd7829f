//! In which order does the cycle meet what the devices say? One bounded queue for all: newest frame, every sample.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use localize::sample::{Compass, Imu, Odometry, VelocityCommand};

use crate::base::{KickerReport, PowerReport, SwitchReport};
use crate::camera::CameraFrame;
use crate::health::Health;

/// What a device delivers.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A frame of the camera.
    Frame(CameraFrame),
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
    Health(Health),
}

/// How much was dropped because nobody took it in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// Frames that a newer one replaced.
    pub frames: u64,
    /// Samples that gave way to newer ones.
    pub samples: u64,
}

/// The queue between the devices' threads and the one that takes; clones are the same queue.
#[derive(Debug, Clone)]
pub struct Inbox {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

#[derive(Debug)]
struct Queue {
    samples: VecDeque<Event>,
    samples_max: usize,
    frame: Option<CameraFrame>,
    dropped: Dropped,
}

impl Inbox {
    /// A queue of one frame and at most `samples_max` samples; the oldest give way.
    ///
    /// 1024 samples are more than a second of every device that is spoken to here.
    pub fn new(samples_max: usize) -> Self {
        let queue = Queue {
            samples: VecDeque::with_capacity(samples_max),
            samples_max: samples_max.max(1),
            frame: None,
            dropped: Dropped::default(),
        };
        let shared = Shared {
            queue: Mutex::new(queue),
            filled: Condvar::new(),
        };
        Inbox {
            shared: Arc::new(shared),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.shared
            .queue
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts something in; never waits for whoever takes it out.
    pub fn put(&self, event: Event) {
        let mut queue = self.lock();
        if let Event::Frame(frame) = event {
            let replaced = queue.frame.replace(frame);
            queue.dropped.frames += u64::from(replaced.is_some());
        } else {
            if queue.samples.len() == queue.samples_max {
                queue.samples.pop_front();
                queue.dropped.samples += 1;
            }
            queue.samples.push_back(event);
        }
        drop(queue);
        self.shared.filled.notify_one();
    }

    /// Takes the oldest sample, or the frame when no sample is left; waits for either so long at most.
    ///
    /// Samples go first: a frame's exposure lies before the samples that arrived while it was read out.
    pub fn take(&self, patience: Duration) -> Option<Event> {
        let empty = |queue: &mut Queue| queue.samples.is_empty() && queue.frame.is_none();
        let (mut queue, _) = self
            .shared
            .filled
            .wait_timeout_while(self.lock(), patience, empty)
            .unwrap_or_else(PoisonError::into_inner);
        let sample = queue.samples.pop_front();
        sample.or_else(|| queue.frame.take().map(Event::Frame))
    }

    /// How much was dropped so far.
    pub fn dropped(&self) -> Dropped {
        self.lock().dropped
    }
}
