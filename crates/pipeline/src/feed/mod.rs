//! How do subscribers receive cycles? Each has a bounded queue, so that none can delay the pipeline.

pub mod queue;
#[cfg(test)]
mod queue_tests;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use queue::{CycleQueue, IndexedCycle};
pub use queue::{DropCounts, Pace, RecvError};

use crate::cycle::Cycle;

/// Queued cycles per queued image.
///
/// An image is about 100 times as large as the rest of its cycle, and an old one is of little use.
const CYCLES_PER_IMAGE: usize = 4;

/// The publisher's side. Publishing never blocks.
///
/// Clones publish to the same subscribers. The subscriptions end when the last clone is dropped.
#[derive(Clone, Default)]
pub struct Feed {
    shared: Arc<FeedShared>,
}

#[derive(Default)]
struct FeedShared {
    state: Mutex<FeedState>,
}

#[derive(Default)]
struct FeedState {
    next_index: u64,
    subscribers: Vec<Weak<CycleQueue>>,
}

impl Feed {
    /// A feed without subscribers.
    pub fn new() -> Self {
        Feed::default()
    }

    /// Queues a cycle for every subscriber without blocking. A full queue drops its oldest entries, images first.
    pub fn publish(&self, cycle: &Arc<Cycle>) {
        let mut state = self.shared.lock();
        let index = state.next_index;
        state.next_index += 1;
        state.subscribers.retain(|subscriber| {
            let Some(queue) = subscriber.upgrade() else {
                return false;
            };
            queue.push((index, cycle.clone()));
            true
        });
    }

    /// Subscribes, starting with the next cycle.
    ///
    /// `capacity`: number of queued cycles. A quarter of them (at least one) keep their images. With 1, only the newest
    /// cycle is queued.
    pub fn subscribe(&self, capacity: usize) -> Subscription {
        let images = capacity / CYCLES_PER_IMAGE;
        let queue = Arc::new(CycleQueue::new(Pace::Live, images, capacity));
        self.shared.lock().subscribers.push(Arc::downgrade(&queue));
        Subscription {
            queue,
            dropped: Default::default(),
        }
    }
}

impl FeedShared {
    // The list is still valid after a panic of another thread.
    fn lock(&self) -> std::sync::MutexGuard<'_, FeedState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for FeedShared {
    fn drop(&mut self) {
        for queue in self.lock().subscribers.iter().filter_map(Weak::upgrade) {
            queue.close();
        }
    }
}

/// The subscriber's side.
pub struct Subscription {
    queue: Arc<CycleQueue>,
    dropped: [AtomicU64; 2],
}

impl Subscription {
    /// The oldest queued cycle, without blocking.
    pub fn try_recv(&self) -> Result<Arc<Cycle>, RecvError> {
        self.recv_timeout(Duration::ZERO)
    }

    /// The oldest queued cycle. Blocks until there is one, at most for `timeout`.
    pub fn recv_timeout(&self, timeout: Duration) -> Result<Arc<Cycle>, RecvError> {
        self.recv_indexed(timeout).map(|((_, cycle), _)| cycle)
    }

    /// Entries dropped for this subscriber before the latest cycle that it received.
    pub fn dropped(&self) -> DropCounts {
        let [images, cycles] = &self.dropped;
        DropCounts {
            images: images.load(Ordering::Relaxed),
            cycles: cycles.load(Ordering::Relaxed),
        }
    }

    /// As [`Subscription::recv_timeout`], with the cycle's number and the drops before it.
    pub fn recv_indexed(&self, timeout: Duration) -> Result<(IndexedCycle, DropCounts), RecvError> {
        let (entry, dropped) = self.queue.pop_timeout(timeout)?;
        let [images, cycles] = &self.dropped;
        images.fetch_add(dropped.images, Ordering::Relaxed);
        cycles.fetch_add(dropped.cycles, Ordering::Relaxed);
        Ok((entry, dropped))
    }
}
