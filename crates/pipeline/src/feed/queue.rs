//! What waits to be taken? A bounded queue of cycles between the spine and one who watches: it drops or it waits, as told.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::cycle::Cycle;

/// Who waits when the disk is slow?
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Nobody: a robot drives on, the log drops the oldest, images first.
    Live,
    /// The run: a simulation or a recording loses nothing.
    Lockstep,
}

/// A cycle, and its number since the start of the run (dropped ones count).
pub(crate) type IndexedCycle = (u64, Arc<Cycle>);

/// What was dropped for want of time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DropCounts {
    /// Images; their cycles were kept.
    pub images: u64,
    /// Whole cycles.
    pub cycles: u64,
}

impl DropCounts {
    /// Nothing was dropped.
    pub fn is_zero(self) -> bool {
        self == DropCounts::default()
    }
}

/// Why there is no cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RecvError {
    /// None came in time.
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

/// The queue itself; one side pushes, the other pops.
pub(crate) struct CycleQueue {
    state: Mutex<QueueState>,
    changed: Condvar,
    run_mode: Pace,
    max_images: usize,
    max_entries: usize,
}

impl CycleQueue {
    /// A queue of at most so many entries, of which at most so many hold an image.
    pub(crate) fn new(pace: Pace, most_images: usize, most_entries: usize) -> Self {
        CycleQueue {
            state: Mutex::default(),
            changed: Condvar::new(),
            run_mode: pace,
            max_images: most_images.max(1),
            max_entries: most_entries.max(1),
        }
    }

    /// Adds an entry: at live pace by dropping the oldest of a full queue, images first; in lockstep by waiting.
    pub(crate) fn push(&self, entry: IndexedCycle) {
        let mut state = self.lock();
        let has_image = has_image(&entry);
        if self.run_mode == Pace::Lockstep {
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
        if self.run_mode == Pace::Live {
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

    /// The oldest entry and what was dropped since the last call; none when the queue is closed and empty.
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

    /// As [`Queue::pop`], but waits no longer than `patience`.
    pub(crate) fn pop_timeout(
        &self,
        patience: Duration,
    ) -> Result<(IndexedCycle, DropCounts), RecvError> {
        let waiting = |state: &mut QueueState| state.entries.is_empty() && !state.closed;
        let (mut state, _) = self
            .changed
            .wait_timeout_while(self.lock(), patience, waiting)
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

    /// Takes no more entries; those that wait are still popped.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    // A panic of the other side leaves entries and counts that are still true.
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
