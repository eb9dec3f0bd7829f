//! Who keeps a device going? A thread each: open, serve, and after any failure open again, until told to stop.

use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use localize::Stamp;
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};

use crate::clock;
use crate::error::HwError;
use crate::health::{Monitor, State};

/// Pauses between attempts to open a device, seconds: it is back well within a second of being plugged in again.
const PAUSE_FIRST: f64 = 0.02;
const PAUSE_LONGEST: f64 = 0.25;

/// Wakes a device's thread, and tells it to stop.
#[derive(Debug)]
pub(crate) struct Bell {
    stop: AtomicBool,
    fd: OwnedFd,
}

impl Bell {
    /// Wakes the thread.
    pub(crate) fn ring(&self) {
        // The count can only be full of unheard rings, and then the thread is awake.
        let _full = rustix::io::write(&self.fd, &1u64.to_ne_bytes());
    }

    pub(crate) fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits until `fd` can be read (or has failed), the bell rings, or the deadline comes; true if `fd` can be read.
    pub(crate) fn wait(&self, fd: Option<BorrowedFd<'_>>, deadline: Stamp) -> bool {
        let mut fds = vec![PollFd::new(&self.fd, PollFlags::IN)];
        fds.extend(fd.map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)));
        let woken = poll(&mut fds, Some(&clock::until(deadline)));
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
    bell: Arc<Bell>,
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
        mut serve: impl FnMut(&mut D, &Bell) -> Result<(), HwError> + Send + 'static,
    ) -> Result<Self, HwError> {
        let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
        let fd =
            eventfd(0, flags).map_err(|source| HwError::system(name, "make a bell for", source))?;
        let bell = Arc::new(Bell {
            stop: AtomicBool::new(false),
            fd,
        });
        let (monitor, heard) = (monitor.clone(), Arc::clone(&bell));
        let run = move || {
            let mut pause = PAUSE_FIRST;
            while !heard.stopped() {
                let served = open().and_then(|mut device| {
                    monitor.opened();
                    pause = PAUSE_FIRST;
                    serve(&mut device, &heard)
                });
                let Err(error) = served else { continue };
                let state = match error {
                    HwError::Stalled { .. } => State::Stalled,
                    HwError::Garbage { .. } => State::Garbage,
                    _ => State::Absent,
                };
                monitor.state(state, Some(error.to_string()));
                let again = clock::now() + pause;
                while !heard.stopped() && clock::now() < again {
                    heard.wait(None, again);
                }
                pause = (2.0 * pause).min(PAUSE_LONGEST);
            }
        };
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(run)
            .map_err(|source| HwError::Unfit {
                device: name.to_owned(),
                reason: format!("no thread for it: {source}"),
            })?;
        Ok(Worker {
            bell,
            thread: Some(thread),
        })
    }

    pub(crate) fn bell(&self) -> Arc<Bell> {
        Arc::clone(&self.bell)
    }

    pub(crate) fn ring(&self) {
        self.bell.ring();
    }

    /// Tells the thread to stop and waits for its end.
    pub(crate) fn stop(&mut self) {
        self.bell.stop.store(true, Ordering::Relaxed);
        self.bell.ring();
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
pub(crate) struct Watch {
    device: String,
    since: Stamp,
    garbage_bytes: u64,
    limit: f64,
}

impl Watch {
    /// Begins now; a device silent for `limit` seconds is stalled.
    pub(crate) fn new(device: &str, limit: f32) -> Self {
        Watch {
            device: device.to_owned(),
            since: clock::now(),
            garbage_bytes: 0,
            limit: f64::from(limit),
        }
    }

    /// A whole message came.
    pub(crate) fn message(&mut self, stamp: Stamp, garbage_bytes: u64) {
        self.since = stamp;
        self.garbage_bytes = garbage_bytes;
    }

    /// Refuses a silence that is too long: as garbage if bytes came all the same, as a stall if none.
    pub(crate) fn check(&self, now: Stamp, garbage_bytes: u64) -> Result<(), HwError> {
        if now - self.since <= self.limit {
            return Ok(());
        }
        let device = self.device.clone();
        if garbage_bytes > self.garbage_bytes {
            return Err(HwError::Garbage { device });
        }
        let reason = format!("silent for {:.1} s", self.limit);
        Err(HwError::Stalled { device, reason })
    }
}
