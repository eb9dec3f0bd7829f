//! How do the devices keep time? Priority and waiting of their threads.

use std::time::Duration;

use localize::Stamp;

/// Raises the priority of the calling thread if the system allows it, because real devices do not wait for a processor.
pub(super) fn raise_thread_priority() {
    // Without the permission, samples are sometimes late.
    let _permitted = hw::realtime::set_realtime_priority(1);
}

pub(super) fn sleep_until(stamp: Stamp) {
    let left = stamp - hw::now();
    if left > 0.0 {
        std::thread::sleep(Duration::from_secs_f64(left));
    }
}
