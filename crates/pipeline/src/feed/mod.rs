//! Who else wants to know? Each cycle goes from the spine to whoever subscribed, and nobody of them can hold it up.

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

/// Of the cycles that wait for a subscriber, one in so many keeps its image.
///
/// An image is a hundred times as large as the rest of its cycle and ages as fast; what is found in it stays useful.
const CYCLES_PER_IMAGE: usize = 4;

/// The spine's side: publish a cycle and go on.
///
/// Clones publish to the same subscribers; when the last one is dropped, the subscriptions end.
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

    /// Hands a cycle to every subscriber, and returns at once: whoever is behind loses the oldest, images first.
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

    /// Subscribes from the next cycle on.
    ///
    /// `capacity`: cycles that may wait; a quarter of them (at least one) keep their images. With 1 it is always the
    /// newest cycle that waits.
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
    // A panic elsewhere leaves a list that is still true.
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

/// A subscriber's side: take what waits.
pub struct Subscription {
    queue: Arc<CycleQueue>,
    dropped: [AtomicU64; 2],
}

impl Subscription {
    /// The oldest cycle that waits, at once.
    pub fn try_recv(&self) -> Result<Arc<Cycle>, RecvError> {
        self.recv_timeout(Duration::ZERO)
    }

    /// The oldest cycle that waits or comes within `patience`.
    pub fn recv_timeout(&self, patience: Duration) -> Result<Arc<Cycle>, RecvError> {
        self.recv_indexed(patience).map(|((_, cycle), _)| cycle)
    }

    /// What this subscriber lost by being slow, as far as it was told by what it received since.
    pub fn dropped(&self) -> DropCounts {
        let [images, cycles] = &self.dropped;
        DropCounts {
            images: images.load(Ordering::Relaxed),
            cycles: cycles.load(Ordering::Relaxed),
        }
    }

    /// As [`Subscription::recv_timeout`], with the cycle's number and what was dropped before it.
    pub fn recv_indexed(
        &self,
        patience: Duration,
    ) -> Result<(IndexedCycle, DropCounts), RecvError> {
        let (entry, dropped) = self.queue.pop_timeout(patience)?;
        let [images, cycles] = &self.dropped;
        images.fetch_add(dropped.images, Ordering::Relaxed);
        cycles.fetch_add(dropped.cycles, Ordering::Relaxed);
        Ok((entry, dropped))
    }
}
