//! Ends a background thread when its owner is dropped.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Sets its thread's stop flag when dropped.
pub(crate) struct StopGuard(Arc<AtomicBool>);

impl StopGuard {
    /// A guard, and the flag that its thread checks: true means stop.
    pub(crate) fn new() -> (Self, Arc<AtomicBool>) {
        let stop = Arc::new(AtomicBool::new(false));
        (StopGuard(stop.clone()), stop)
    }
}

impl Drop for StopGuard {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
