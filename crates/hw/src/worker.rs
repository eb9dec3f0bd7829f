//! How is a device kept running? One thread per device opens it, runs it, and reopens it after a failure.

use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use localize::Stamp;
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};

use crate::clock;
use crate::error::HwError;
use crate::health::HealthState;
use crate::monitor::Monitor;

/// Longest wait of a device's thread before it checks for a stall, seconds.
pub(crate) const POLL_PERIOD: f64 = 0.05;
/// Delays between attempts to open a device, seconds: a replugged device runs again within a second.
const RETRY_DELAY_MIN: f64 = 0.02;
const RETRY_DELAY_MAX: f64 = 0.25;

/// Wakes a device's thread, or stops it.
#[derive(Debug)]
pub(crate) struct Waker {
    stop: AtomicBool,
    fd: OwnedFd,
}

impl Waker {
    /// Wakes the thread.
    pub(crate) fn wake(&self) {
        // The counter is full only if wake-ups are pending; then the thread will run anyway.
        let _full = rustix::io::write(&self.fd, &1u64.to_ne_bytes());
    }

    pub(crate) fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits until `fd` is readable (or failed), `wake` is called, or the deadline passes; true if `fd` is readable.
    pub(crate) fn wait(&self, fd: Option<BorrowedFd<'_>>, deadline: Stamp) -> bool {
        let mut fds = vec![PollFd::new(&self.fd, PollFlags::IN)];
        fds.extend(fd.map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)));
        let woken = poll(&mut fds, Some(&clock::time_until(deadline)));
        if woken.is_ok() && !fds[0].revents().is_empty() {
            let mut wakes = [0; 8];
            let _none = rustix::io::read(&self.fd, &mut wakes[..]);
        }
        woken.is_ok() && fds.get(1).is_some_and(|fd| !fd.revents().is_empty())
    }
}

/// A device's thread; dropping it stops the device and joins the thread.
#[derive(Debug)]
pub(crate) struct Worker {
    waker: Arc<Waker>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts a thread that repeats: open the device, `serve` it until that fails.
    ///
    /// `open` and `serve` must return soon after the waker was stopped; `serve` then returns `Ok`.
    pub(crate) fn start<D>(
        name: &str,
        monitor: &Monitor,
        mut open: impl FnMut() -> Result<D, HwError> + Send + 'static,
        mut serve: impl FnMut(&mut D, &Waker) -> Result<(), HwError> + Send + 'static,
    ) -> Result<Self, HwError> {
        let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
        let fd = eventfd(0, flags)
            .map_err(|source| HwError::from_errno(name, "create an eventfd for", source))?;
        let waker = Arc::new(Waker {
            stop: AtomicBool::new(false),
            fd,
        });
        let (monitor, thread_waker) = (monitor.clone(), Arc::clone(&waker));
        let run = move || {
            let mut retry_delay = RETRY_DELAY_MIN;
            while !thread_waker.stop_requested() {
                let result = open().and_then(|mut device| {
                    monitor.on_opened();
                    retry_delay = RETRY_DELAY_MIN;
                    serve(&mut device, &thread_waker)
                });
                let Err(error) = result else { continue };
                let state = match error {
                    HwError::Stalled { .. } => HealthState::Stalled,
                    HwError::Garbage { .. } => HealthState::Garbage,
                    _ => HealthState::Absent,
                };
                monitor.set_state(state, Some(error.to_string()));
                let retry = clock::now() + retry_delay;
                while !thread_waker.stop_requested() && clock::now() < retry {
                    thread_waker.wait(None, retry);
                }
                retry_delay = (2.0 * retry_delay).min(RETRY_DELAY_MAX);
            }
        };
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(run)
            .map_err(|source| HwError::Unsupported {
                device: name.to_owned(),
                reason: format!("cannot start its thread: {source}"),
            })?;
        Ok(Worker {
            waker,
            thread: Some(thread),
        })
    }

    pub(crate) fn waker(&self) -> Arc<Waker> {
        Arc::clone(&self.waker)
    }

    pub(crate) fn wake(&self) {
        self.waker.wake();
    }

    /// Stops the thread and joins it.
    pub(crate) fn stop(&mut self) {
        self.waker.stop.store(true, Ordering::Relaxed);
        self.waker.wake();
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has ended too, and has printed why to standard error.
            let _ended = thread.join();
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A thread that did not run for longer was paused, seconds: a busy machine delays it by less.
const PAUSE_MIN: f64 = 0.25;

/// Detects that the thread was paused (SIGSTOP, a debugger). The clock of a suspended machine stands still, so that a suspension is none.
///
/// What waits in a device's buffers after a pause has an unknown age, because serial lines carry no receive stamps.
#[derive(Debug)]
pub(crate) struct PauseDetector {
    last_run: Stamp,
}

impl PauseDetector {
    /// Starts at `now`.
    pub(crate) fn new(now: Stamp) -> Self {
        PauseDetector { last_run: now }
    }

    /// To be called at least each [`POLL_PERIOD`]: seconds of the pause, if there was one since the last call.
    pub(crate) fn check(&mut self, now: Stamp) -> Option<f64> {
        let pause = now - std::mem::replace(&mut self.last_run, now);
        (pause > PAUSE_MIN).then_some(pause)
    }
}

/// What a device reports after a pause.
pub(crate) fn pause_reason(pause: f64) -> String {
    format!("this program was paused for {pause:.1} s: the input of that time is discarded")
}

/// Detects a device that sends no message for too long.
#[derive(Debug)]
pub(crate) struct StallDetector {
    device: String,
    last_message: Stamp,
    garbage_bytes: u64,
    timeout: f64,
}

impl StallDetector {
    /// Starts now; a device that is silent for `timeout` seconds is stalled.
    pub(crate) fn new(device: &str, timeout: f32) -> Self {
        StallDetector {
            device: device.to_owned(),
            last_message: clock::now(),
            garbage_bytes: 0,
            timeout: f64::from(timeout),
        }
    }

    /// Restarts the timeout at a complete message.
    pub(crate) fn on_message(&mut self, stamp: Stamp, garbage_bytes: u64) {
        self.last_message = stamp;
        self.garbage_bytes = garbage_bytes;
    }

    /// An error after the timeout: garbage if bytes arrived since the last message, a stall if none did.
    pub(crate) fn check(&self, now: Stamp, garbage_bytes: u64) -> Result<(), HwError> {
        if now - self.last_message <= self.timeout {
            return Ok(());
        }
        let device = self.device.clone();
        if garbage_bytes > self.garbage_bytes {
            return Err(HwError::Garbage { device });
        }
        let reason = format!("silent for {:.1} s", self.timeout);
        Err(HwError::Stalled { device, reason })
    }
}
