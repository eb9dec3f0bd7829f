//! How are cycles queued for a subscriber? In a bounded queue that drops the oldest entries or blocks the run.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::cycle::Cycle;

/// Behaviour when a consumer is slower than the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Drops the oldest entries, images first, because a robot must not wait.
    Live,
    /// Blocks the run, so that a simulation or a recording loses no data.
    Lockstep,
}

/// A cycle and its number since the start of the run. Dropped cycles are counted.
pub(crate) type IndexedCycle = (u64, Arc<Cycle>);

/// Dropped entries of a full queue.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DropCounts {
    /// Images whose cycles were kept.
    pub images: u64,
    /// Whole cycles.
    pub cycles: u64,
}

impl DropCounts {
    /// True if nothing was dropped.
    pub fn is_zero(self) -> bool {
        self == DropCounts::default()
    }
}

/// Why there is no cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RecvError {
    /// No cycle arrived in time.
    #[error("no cycle yet")]
    Timeout,
    /// The run has ended.
    #[error("the run has ended")]
    Closed,
}

#[derive(Default)]
struct QueueState {
    entries: VecDeque<IndexedCycle>,
    images: usize,
    dropped: DropCounts,
    closed: bool,
}

/// A bounded queue with one producer and one consumer.
pub(crate) struct CycleQueue {
    state: Mutex<QueueState>,
    changed: Condvar,
    pace: Pace,
    max_images: usize,
    max_entries: usize,
}

impl CycleQueue {
    /// A queue of at most `max_entries`, of which at most `max_images` hold an image.
    pub(crate) fn new(pace: Pace, max_images: usize, max_entries: usize) -> Self {
        CycleQueue {
            state: Mutex::default(),
            changed: Condvar::new(),
            pace,
            max_images: max_images.max(1),
            max_entries: max_entries.max(1),
        }
    }

    /// Adds an entry. A full queue drops its oldest entries (live, images first) or blocks (lockstep).
    pub(crate) fn push(&self, entry: IndexedCycle) {
        let mut state = self.lock();
        let has_image = has_image(&entry);
        if self.pace == Pace::Lockstep {
            let full = |state: &mut QueueState| {
                let images = state.images >= self.max_images && has_image;
                !state.closed && (images || state.entries.len() >= self.max_entries)
            };
            state = self
                .changed
                .wait_while(state, full)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if state.closed {
            return;
        }
        state.images += usize::from(has_image);
        state.entries.push_back(entry);
        if self.pace == Pace::Live {
            if state.images > self.max_images {
                state.drop_oldest_image();
            }
            if state.entries.len() > self.max_entries {
                state.drop_oldest();
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    /// The oldest entry and the drops since the last call. None if the queue is closed and empty.
    pub(crate) fn pop(&self) -> Option<(IndexedCycle, DropCounts)> {
        let waiting = |state: &mut QueueState| state.entries.is_empty() && !state.closed;
        let mut state = self
            .changed
            .wait_while(self.lock(), waiting)
            .unwrap_or_else(PoisonError::into_inner);
        let popped = state.pop();
        drop(state);
        self.changed.notify_all();
        popped
    }

    /// As [`CycleQueue::pop`], but blocks no longer than `timeout`.
    pub(crate) fn pop_timeout(
        &self,
        timeout: Duration,
    ) -> Result<(IndexedCycle, DropCounts), RecvError> {
        let waiting = |state: &mut QueueState| state.entries.is_empty() && !state.closed;
        let (mut state, _) = self
            .changed
            .wait_timeout_while(self.lock(), timeout, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        let popped = state.pop();
        let nothing = if state.closed {
            RecvError::Closed
        } else {
            RecvError::Timeout
        };
        drop(state);
        self.changed.notify_all();
        popped.ok_or(nothing)
    }

    /// Accepts no more entries. Queued entries can still be popped.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    // Entries and counts are still valid after a panic of the other thread.
    fn lock(&self) -> MutexGuard<'_, QueueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl QueueState {
    fn pop(&mut self) -> Option<(IndexedCycle, DropCounts)> {
        let entry = self.entries.pop_front()?;
        self.images -= usize::from(has_image(&entry));
        Some((entry, std::mem::take(&mut self.dropped)))
    }

    fn drop_oldest_image(&mut self) {
        let holder = self.entries.iter_mut().find(|entry| has_image(entry));
        if let Some((_, cycle)) = holder {
            Arc::make_mut(cycle).inputs.image = None;
            self.images -= 1;
            self.dropped.images += 1;
        }
    }

    fn drop_oldest(&mut self) {
        if let Some(entry) = self.entries.pop_front() {
            self.images -= usize::from(has_image(&entry));
            self.dropped.cycles += 1;
        }
    }
}

fn has_image((_, cycle): &IndexedCycle) -> bool {
    cycle.inputs.image.is_some()
}
