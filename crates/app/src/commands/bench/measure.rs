//! How is a stage measured? Figures with their bounds, and the median time of a call.

use std::time::{Duration, Instant};

use pipeline::score::sample_statistics;
use serde::{Deserialize, Serialize};

/// Least number of repetitions of a stage's measurement.
pub(super) const REPEATS: usize = 300;

/// Least duration of a stage's measurement: other guests of a shared machine come and go within a second.
const MIN_DURATION: Duration = Duration::from_secs(2);

/// One measured figure, as `bench --json` prints it and a baseline file keeps it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct BenchFigure {
    /// Its name.
    pub(super) name: String,
    /// Its value.
    pub(super) value: f64,
    /// Its unit.
    pub(super) unit: String,
    /// Bound to be met, as text with its direction.
    pub(super) wanted: String,
}

impl BenchFigure {
    /// A figure with its unit and bound.
    pub(super) fn new(name: &str, value: f64, unit: &str, wanted: &str) -> Self {
        BenchFigure {
            name: name.to_owned(),
            value,
            unit: unit.to_owned(),
            wanted: wanted.to_owned(),
        }
    }
}

/// Median time of a call in milliseconds.
pub(super) fn median_ms(repeats: usize, mut call: impl FnMut()) -> f64 {
    let mut once = || {
        let started = Instant::now();
        call();
        started.elapsed().as_secs_f64() * 1e3
    };
    // The first calls fill caches.
    for _ in 0..repeats.div_ceil(10) {
        once();
    }
    let (started, mut times) = (Instant::now(), Vec::new());
    while times.len() < repeats || started.elapsed() < MIN_DURATION {
        times.push(once());
    }
    sample_statistics(times).map_or(f64::NAN, |spread| spread.median)
}
