//! What time is it? CLOCK_MONOTONIC: camera drivers stamp images with it, and it is never set back.

use localize::Stamp;
use rustix::time::{ClockId, Timespec, clock_gettime};

/// The current time; its zero is arbitrary.
pub fn now() -> Stamp {
    let time = clock_gettime(ClockId::Monotonic);
    Stamp(time.tv_sec * 1_000_000_000 + time.tv_nsec)
}

/// Time until `stamp`, at least 0.
pub(crate) fn time_until(stamp: Stamp) -> Timespec {
    let remaining_ns = stamp.0.saturating_sub(now().0).max(0);
    Timespec {
        tv_sec: remaining_ns / 1_000_000_000,
        tv_nsec: remaining_ns % 1_000_000_000,
    }
}
