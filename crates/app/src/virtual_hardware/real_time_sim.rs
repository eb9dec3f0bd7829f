//! How does simulated time follow real time? The simulation runs slightly ahead, so that each image is rendered by the
//! time of its stamp.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Result;
use localize::Stamp;
use localize::omni::Twist;
use localize::robot::ExposureSetting;
use sim::image_sensor::ImageSensorConfig;
use sim::{SimSample, Simulator};

use super::board::ReceivedKick;
use super::timing::sleep_until;

/// Lead of the simulation, seconds: longer than the rendering of an image. It delays the wheel commands by the same time.
const LEAD_TIME: f64 = 0.03;
/// Time until the first sample, seconds: readers can open the devices meanwhile.
const START_DELAY: f64 = 0.2;
/// Capacity of the queue of samples: more than in the lead time.
const SAMPLE_CHANNEL_CAPACITY: usize = 64;

/// A sample and its delivery time.
pub(super) struct ScheduledSample {
    /// CLOCK_MONOTONIC.
    pub(super) stamp: Stamp,
    pub(super) sample: SimSample,
    /// Angle of each wheel since the start, radians; for odometry only.
    pub(super) wheel_angles: Vec<f64>,
    /// With which exposure and gain an image was taken, unit of the simulator.
    pub(super) setting: ExposureSetting,
}

/// The simulation in its own thread.
pub(super) struct RealTimeSim {
    start: Stamp,
    samples: Option<Receiver<ScheduledSample>>,
    shared: Arc<RealTimeSimState>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct RealTimeSimState {
    commanded_twist: Mutex<Twist>,
    commanded_setting: Mutex<Option<ExposureSetting>>,
    commanded_kick: Mutex<Option<ReceivedKick>>,
    lag: Mutex<f64>,
    stop_requested: AtomicBool,
}

impl RealTimeSim {
    /// Starts the thread; with `own_path` the scenario's path moves the robot.
    pub(super) fn start(sim: Simulator, own_path: bool) -> Result<Self> {
        let (deliver, due) = sync_channel(SAMPLE_CHANNEL_CAPACITY);
        let shared = Arc::new(RealTimeSimState::default());
        let start = hw::now() + START_DELAY;
        let state = Arc::clone(&shared);
        let mut sim = sim;
        let play = move || {
            let mut zero = start;
            while !state.stop_requested.load(Ordering::Relaxed) {
                if !own_path {
                    sim.set_command(Some(*lock(&state.commanded_twist)));
                }
                if let Some(kick) = lock(&state.commanded_kick).take() {
                    // Out of the kicker's reach nothing happens.
                    let _kicked = sim.kick(kick.speed, kick.lofted);
                }
                let sample = sim.next_sample();
                let mut at = zero + sample.stamp().seconds();
                let late = hw::now() - at;
                if late > 0.0 {
                    // The machine is too slow: simulated time pauses, so that stamps are never in the past.
                    zero = zero + late;
                    at = at + late;
                    *lock(&state.lag) += late;
                }
                let wheel_angles = match &sample {
                    SimSample::Odometry(_) => sim.wheel_angles().collect(),
                    _ => Vec::new(),
                };
                let sensor = sim.image_sensor();
                let setting = ExposureSetting {
                    exposure: sensor.exposure,
                    gain: sensor.gain,
                };
                // The image was rendered with this setting. No other image is waiting, so a new one counts from the next.
                if matches!(sample, SimSample::Image(_)) {
                    apply_command(&mut sim, lock(&state.commanded_setting).take());
                }
                if deliver
                    .send(ScheduledSample {
                        setting,
                        stamp: at,
                        sample,
                        wheel_angles,
                    })
                    .is_err()
                {
                    return;
                }
                sleep_until(at + -LEAD_TIME);
            }
        };
        let thread = std::thread::Builder::new()
            .name("sim".to_owned())
            .spawn(play)?;
        Ok(RealTimeSim {
            start,
            samples: Some(due),
            shared,
            thread: Some(thread),
        })
    }

    /// Time of the simulation's start.
    pub(super) fn start_stamp(&self) -> Stamp {
        self.start
    }

    /// Time for which simulated time paused, seconds.
    pub(super) fn lag(&self) -> f64 {
        *lock(&self.shared.lag)
    }

    /// Sets exposure and gain of the following images, unit of the simulator.
    pub(super) fn command_camera(&self, setting: ExposureSetting) {
        *lock(&self.shared.commanded_setting) = Some(setting);
    }

    /// Kicks the ball at the next time step, if it lies before the robot.
    pub(super) fn kick(&self, kick: ReceivedKick) {
        *lock(&self.shared.commanded_kick) = Some(kick);
    }

    /// The next sample. None if the simulation has ended. `commanded` returns the velocity of the wheels.
    pub(super) fn next_sample(
        &mut self,
        commanded: impl FnOnce(Stamp) -> Twist,
    ) -> Result<Option<ScheduledSample>> {
        *lock(&self.shared.commanded_twist) = commanded(hw::now());
        let Some(due) = &self.samples else {
            return Ok(None);
        };
        // There are about 100 samples a second.
        match due.recv_timeout(Duration::from_secs(10)) {
            Ok(due) => Ok(Some(due)),
            Err(RecvTimeoutError::Timeout) => anyhow::bail!("the simulation delivers no samples"),
            Err(RecvTimeoutError::Disconnected) => Ok(None),
        }
    }
}

/// Sets exposure and gain of the simulated camera.
fn apply_command(sim: &mut Simulator, command: Option<ExposureSetting>) {
    if let Some(ExposureSetting { exposure, gain }) = command {
        let sensor = ImageSensorConfig {
            exposure,
            gain,
            ..*sim.image_sensor()
        };
        sim.set_image_sensor(sensor);
    }
}

impl Drop for RealTimeSim {
    fn drop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        self.samples = None;
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ended = thread.join();
        }
    }
}

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // Plain values: valid even if a thread panicked with the lock.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
