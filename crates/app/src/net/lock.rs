//! How do the network threads share data?

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The locked data. Counts, clocks and messages are valid even if a thread panicked with the lock.
pub(super) fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
