//! What time is it? CLOCK_MONOTONIC: the clock that cameras' drivers stamp frames with, and that no one sets back.

use localize::Stamp;
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Now, nanoseconds since some time before the machine's start.
pub fn now() -> Stamp {
    let time = clock_gettime(ClockId::Monotonic);
    Stamp(time.tv_sec * 1_000_000_000 + time.tv_nsec)
}

/// How long it is until `stamp`, not less than nothing.
pub(crate) fn time_until(stamp: Stamp) -> Timespec {
    let left = stamp.0.saturating_sub(now().0).max(0);
    Timespec {
        tv_sec: left / 1_000_000_000,
        tv_nsec: left % 1_000_000_000,
    }
}
