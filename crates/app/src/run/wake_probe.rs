//! How late does this machine wake a thread? One of the run's priority sleeps and measures, beside the run.
//!
//! An image needs several wake-ups on its way from the camera to the pose, so a latency says little without this one.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};

use super::latency::{LatencyHistogram, LatencySummary};

/// Time between two measurements, seconds: in a minute 1200 of them, which cost a thousandth of a processor.
const PERIOD: f64 = 0.05;

/// A thread that sleeps and measures how late it wakes.
pub(super) struct WakeProbe {
    lateness: Arc<Mutex<LatencyHistogram>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl WakeProbe {
    /// Starts the thread, which inherits the priority of the caller.
    pub(super) fn start() -> Result<Self> {
        let lateness = Arc::new(Mutex::new(LatencyHistogram::default()));
        let stop = Arc::new(AtomicBool::new(false));
        let (measured, stopped) = (lateness.clone(), stop.clone());
        let measure = move || {
            while !stopped.load(Ordering::Relaxed) {
                let due = hw::now() + PERIOD;
                std::thread::sleep(Duration::from_secs_f64(PERIOD));
                let late_ms = (hw::now() - due) * 1e3;
                let mut histogram = measured.lock().unwrap_or_else(PoisonError::into_inner);
                histogram.add(late_ms);
            }
        };
        let thread = std::thread::Builder::new()
            .name("wake-probe".to_owned())
            .spawn(measure)
            .context("cannot start the thread that measures wake-ups")?;
        Ok(WakeProbe {
            lateness,
            stop,
            thread: Some(thread),
        })
    }

    /// The delays so far.
    pub(super) fn summary(&self) -> LatencySummary {
        let lateness = self.lateness.lock();
        lateness.unwrap_or_else(PoisonError::into_inner).summary()
    }
}

impl Drop for WakeProbe {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic has been reported when it happened.
            let _ended = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wake_ups_are_never_early_and_are_counted() {
        let probe = WakeProbe::start().expect("a thread");
        while probe.summary().max == 0.0 {
            std::thread::sleep(Duration::from_millis(1));
        }
        let late = probe.summary();
        assert!(0.0 < late.median && late.median <= late.p99 && late.p99 <= late.max);
    }
}
