//! Time stamps: nanoseconds on the clock of the source.

use std::ops::{Add, Sub};

use serde::{Deserialize, Serialize};

/// A point in time, nanoseconds since the source's epoch.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct Stamp(pub i64);

impl Stamp {
    /// From seconds, rounded to the nearest nanosecond.
    pub fn from_seconds(seconds: f64) -> Self {
        Stamp((seconds * 1e9).round() as i64)
    }

    /// Seconds since the source's epoch.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Seconds from `self` to `later`.
    pub fn seconds_until(self, later: Stamp) -> f64 {
        later - self
    }
}

#[expect(
    clippy::suspicious_arithmetic_impl,
    reason = "seconds are a multiple of the nanoseconds held"
)]
impl Sub for Stamp {
    type Output = f64;

    /// Seconds from `earlier` to `self`.
    fn sub(self, earlier: Stamp) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 * 1e-9
    }
}

#[expect(
    clippy::suspicious_arithmetic_impl,
    reason = "nanoseconds are a multiple of the seconds given"
)]
impl Add<f64> for Stamp {
    type Output = Stamp;

    fn add(self, seconds: f64) -> Stamp {
        Stamp(self.0.saturating_add((seconds * 1e9).round() as i64))
    }
}
