//! The queue between a thread that delivers cycles and the view.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::decoded_cycle::DecodedCycle;
use super::stop_guard::StopGuard;
use pipeline::feed::{RecvError, Subscription};

/// Cycles queued for the view; a further one drops the oldest.
const INBOX_CAPACITY: usize = 32;
/// Interval at which a forwarding thread checks its stop flag.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Queue between the delivering thread and the view; the sender never waits.
#[derive(Clone, Default)]
pub(crate) struct CycleInbox(Arc<Mutex<InboxState>>);

#[derive(Default)]
struct InboxState {
    cycles: VecDeque<DecodedCycle>,
    dropped: u64,
    status: Option<String>,
    on_cycle: Option<Box<dyn Fn() + Send>>,
}

impl CycleInbox {
    /// Adds a cycle; drops the oldest one if the queue is full.
    pub(crate) fn push(&self, shown: DecodedCycle) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if state.cycles.len() >= INBOX_CAPACITY {
            state.cycles.pop_front();
            state.dropped += 1;
        }
        state.cycles.push_back(shown);
        if let Some(wake) = &state.on_cycle {
            wake();
        }
    }

    /// Sets the source's problem; None if it works.
    pub(crate) fn set_status(&self, status: Option<String>) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.status = status;
        if let Some(wake) = &state.on_cycle {
            wake();
        }
    }

    /// Registers a callback for every new cycle.
    pub(crate) fn set_on_cycle(&self, wake: impl Fn() + Send + 'static) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.on_cycle = Some(Box::new(wake));
    }

    /// Takes the queued cycles, the number dropped since the last call, and the source's problem.
    pub(super) fn drain(&self) -> (VecDeque<DecodedCycle>, u64, Option<String>) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let dropped = std::mem::take(&mut state.dropped);
        let status = state.status.clone();
        (std::mem::take(&mut state.cycles), dropped, status)
    }
}

/// Forwards the cycles of a run in this process to the inbox until the run ends.
pub(crate) fn forward_feed(
    subscription: Subscription,
    inbox: CycleInbox,
) -> std::io::Result<StopGuard> {
    let (guard, stop) = StopGuard::new();
    std::thread::Builder::new()
        .name("watch".to_owned())
        .spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                match subscription.recv_timeout(POLL_INTERVAL) {
                    Ok(cycle) => inbox.push(DecodedCycle::new(cycle, Vec::new())),
                    Err(RecvError::Timeout) => {}
                    Err(RecvError::Closed) => {
                        inbox.set_status(Some("the run has ended".to_owned()));
                        return;
                    }
                }
            }
        })?;
    Ok(guard)
}
