//! How often do the network threads check whether they must end?

use std::time::Duration;

/// Longest wait for a cycle or a datagram: the latency of a stop.
pub(super) const POLL_PERIOD: Duration = Duration::from_millis(50);
