//! How does simulated time keep up with real time? The world runs a little ahead, so that each image is rendered when the
//! moment comes that it shows.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Result;
use localize::Stamp;
use localize::omni::Twist;
use sim::{Sim, SimSample};

/// How far the world runs ahead, seconds: longer than an image takes to render. The wheels obey as much later.
const LEAD_TIME: f64 = 0.03;
/// Time until the first sample, seconds: the devices' readers may open them meanwhile.
const START_DELAY: f64 = 0.2;
/// Samples that may wait: more than come in the lead.
const SAMPLE_CHANNEL_CAPACITY: usize = 64;

/// A sample and when it is to be delivered.
pub(super) struct ScheduledSample {
    /// CLOCK_MONOTONIC.
    pub(super) stamp: Stamp,
    pub(super) sample: SimSample,
    /// How far each wheel had turned then, radians; of odometry.
    pub(super) wheel_angles: Vec<f64>,
}

/// The simulation in a thread of its own.
pub(super) struct RealTimeSim {
    began: Stamp,
    samples: Option<Receiver<ScheduledSample>>,
    shared: Arc<RealTimeSimState>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct RealTimeSimState {
    commanded_twist: Mutex<Twist>,
    lag: Mutex<f64>,
    stop_requested: AtomicBool,
}

impl RealTimeSim {
    /// Starts it; with `own_path` the scenario's path moves the robot.
    pub(super) fn start(sim: Sim, own_path: bool) -> Result<Self> {
        let (deliver, due) = sync_channel(SAMPLE_CHANNEL_CAPACITY);
        let shared = Arc::new(RealTimeSimState::default());
        let began = hw::now() + START_DELAY;
        let own = Arc::clone(&shared);
        let mut sim = sim;
        let play = move || {
            let mut zero = began;
            while !own.stop_requested.load(Ordering::Relaxed) {
                if !own_path {
                    sim.set_command(Some(*lock(&own.commanded_twist)));
                }
                let sample = sim.next_sample();
                let mut at = zero + sample.stamp().seconds();
                let late = hw::now() - at;
                if late > 0.0 {
                    // A machine too slow for this world: better a pause than stamps of the past.
                    zero = zero + late;
                    at = at + late;
                    *lock(&own.lag) += late;
                }
                let turned = match &sample {
                    SimSample::Odometry(_) => sim.wheel_angles().collect(),
                    _ => Vec::new(),
                };
                if deliver
                    .send(ScheduledSample {
                        stamp: at,
                        sample,
                        wheel_angles: turned,
                    })
                    .is_err()
                {
                    return;
                }
                super::sleep_until(at + -LEAD_TIME);
            }
        };
        let thread = std::thread::Builder::new()
            .name("world".to_owned())
            .spawn(play)?;
        Ok(RealTimeSim {
            began,
            samples: Some(due),
            shared,
            thread: Some(thread),
        })
    }

    /// When its time began.
    pub(super) fn start_stamp(&self) -> Stamp {
        self.began
    }

    /// How long the world had to stand still, seconds.
    pub(super) fn lag(&self) -> f64 {
        *lock(&self.shared.lag)
    }

    /// The next sample; none if the world broke off. `wanted` is asked what the wheels do meanwhile.
    pub(super) fn next_sample(
        &mut self,
        wanted: impl FnOnce(Stamp) -> Twist,
    ) -> Result<Option<ScheduledSample>> {
        *lock(&self.shared.commanded_twist) = wanted(hw::now());
        let Some(due) = &self.samples else {
            return Ok(None);
        };
        // Some sensor says something a hundred times a second.
        match due.recv_timeout(Duration::from_secs(10)) {
            Ok(due) => Ok(Some(due)),
            Err(RecvTimeoutError::Timeout) => anyhow::bail!("the simulation stands still"),
            Err(RecvTimeoutError::Disconnected) => Ok(None),
        }
    }
}

impl Drop for RealTimeSim {
    fn drop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        self.samples = None;
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has said why.
            let _ended = thread.join();
        }
    }
}

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // Plain values: true whatever happened to a thread that held them.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
