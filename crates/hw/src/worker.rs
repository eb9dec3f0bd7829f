//! Who keeps a device going? A thread each: open, serve, and after any failure open again, until told to stop.

use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use localize::Stamp;
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};

use crate::clock;
use crate::error::HwError;
use crate::health::{HealthState, Monitor};

/// Pauses between attempts to open a device, seconds: it is back well within a second of being plugged in again.
const RETRY_DELAY_MIN: f64 = 0.02;
const RETRY_DELAY_MAX: f64 = 0.25;

/// Wakes a device's thread, and tells it to stop.
#[derive(Debug)]
pub(crate) struct Waker {
    stop: AtomicBool,
    fd: OwnedFd,
}

impl Waker {
    /// Wakes the thread.
    pub(crate) fn wake(&self) {
        // The count can only be full of unheard rings, and then the thread is awake.
        let _full = rustix::io::write(&self.fd, &1u64.to_ne_bytes());
    }

    pub(crate) fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits until `fd` can be read (or has failed), the bell rings, or the deadline comes; true if `fd` can be read.
    pub(crate) fn wait(&self, fd: Option<BorrowedFd<'_>>, deadline: Stamp) -> bool {
        let mut fds = vec![PollFd::new(&self.fd, PollFlags::IN)];
        fds.extend(fd.map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)));
        let woken = poll(&mut fds, Some(&clock::time_until(deadline)));
        if woken.is_ok() && !fds[0].revents().is_empty() {
            let mut rings = [0; 8];
            let _none = rustix::io::read(&self.fd, &mut rings[..]);
        }
        woken.is_ok() && fds.get(1).is_some_and(|fd| !fd.revents().is_empty())
    }
}

/// A device's thread; dropping it stops the device and waits for the thread's end.
#[derive(Debug)]
pub(crate) struct Worker {
    waker: Arc<Waker>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts a thread that opens the device and serves it until `serve` fails, and so on.
    ///
    /// `open` and `serve` must come back soon after the bell was rung and stopped; `serve` returns `Ok` then.
    pub(crate) fn start<D>(
        name: &str,
        monitor: &Monitor,
        mut open: impl FnMut() -> Result<D, HwError> + Send + 'static,
        mut serve: impl FnMut(&mut D, &Waker) -> Result<(), HwError> + Send + 'static,
    ) -> Result<Self, HwError> {
        let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
        let fd = eventfd(0, flags)
            .map_err(|source| HwError::from_errno(name, "make a bell for", source))?;
        let bell = Arc::new(Waker {
            stop: AtomicBool::new(false),
            fd,
        });
        let (monitor, heard) = (monitor.clone(), Arc::clone(&bell));
        let run = move || {
            let mut pause = RETRY_DELAY_MIN;
            while !heard.stop_requested() {
                let served = open().and_then(|mut device| {
                    monitor.on_opened();
                    pause = RETRY_DELAY_MIN;
                    serve(&mut device, &heard)
                });
                let Err(error) = served else { continue };
                let state = match error {
                    HwError::Stalled { .. } => HealthState::Stalled,
                    HwError::Garbage { .. } => HealthState::Garbage,
                    _ => HealthState::Absent,
                };
                monitor.set_state(state, Some(error.to_string()));
                let again = clock::now() + pause;
                while !heard.stop_requested() && clock::now() < again {
                    heard.wait(None, again);
                }
                pause = (2.0 * pause).min(RETRY_DELAY_MAX);
            }
        };
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(run)
            .map_err(|source| HwError::Unsupported {
                device: name.to_owned(),
                reason: format!("no thread for it: {source}"),
            })?;
        Ok(Worker {
            waker: bell,
            thread: Some(thread),
        })
    }

    pub(crate) fn waker(&self) -> Arc<Waker> {
        Arc::clone(&self.waker)
    }

    pub(crate) fn wake(&self) {
        self.waker.wake();
    }

    /// Tells the thread to stop and waits for its end.
    pub(crate) fn stop(&mut self) {
        self.waker.stop.store(true, Ordering::Relaxed);
        self.waker.wake();
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has ended too, and has said why on standard error.
            let _ended = thread.join();
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.stop();
    }
}

/// How long has a device been silent, and what came instead of messages?
#[derive(Debug)]
pub(crate) struct StallDetector {
    device: String,
    last_message: Stamp,
    garbage_bytes: u64,
    timeout: f64,
}

impl StallDetector {
    /// Begins now; a device silent for `limit` seconds is stalled.
    pub(crate) fn new(device: &str, limit: f32) -> Self {
        StallDetector {
            device: device.to_owned(),
            last_message: clock::now(),
            garbage_bytes: 0,
            timeout: f64::from(limit),
        }
    }

    /// A whole message came.
    pub(crate) fn on_message(&mut self, stamp: Stamp, garbage_bytes: u64) {
        self.last_message = stamp;
        self.garbage_bytes = garbage_bytes;
    }

    /// Refuses a silence that is too long: as garbage if bytes came all the same, as a stall if none.
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
