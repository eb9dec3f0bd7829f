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
    /// Its value; of a time, the median.
    pub(super) value: f64,
    /// 99th percentile of a time that was measured call by call.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) p99: Option<f64>,
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
            p99: None,
            unit: unit.to_owned(),
            wanted: wanted.to_owned(),
        }
    }

    /// The median of a call's times in milliseconds with its bound, and their 99th percentile.
    pub(super) fn of_times(name: &str, times: &CallTimes, wanted: &str) -> Self {
        BenchFigure {
            p99: Some(times.p99),
            ..BenchFigure::new(name, times.median, "ms", wanted)
        }
    }

    /// Does it depend on the load of the machine?
    pub(super) fn is_timed(&self) -> bool {
        self.unit == "ms" || self.unit.contains("real time")
    }
}

/// Times of a call, milliseconds.
pub(super) struct CallTimes {
    pub(super) median: f64,
    pub(super) p99: f64,
}

impl CallTimes {
    /// Median and 99th percentile (nearest rank); NaN of no times.
    pub(super) fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let rank = (times.len() * 99).div_ceil(100);
        CallTimes {
            p99: times
                .get(rank.saturating_sub(1))
                .map_or(f64::NAN, |time| *time),
            median: sample_statistics(times).map_or(f64::NAN, |spread| spread.median),
        }
    }
}

/// The figures of a run, of which only those with a text in their name are measured.
pub(super) struct Figures {
    only: String,
    pub(super) measured: Vec<BenchFigure>,
}

impl Figures {
    /// None measured yet.
    pub(super) fn only(text: &str) -> Self {
        Figures {
            only: text.to_owned(),
            measured: Vec::new(),
        }
    }

    /// Is a figure of this name to be measured?
    pub(super) fn wants(&self, name: &str) -> bool {
        name.contains(&self.only)
    }

    /// Adds a figure if it is wanted.
    pub(super) fn push(&mut self, figure: BenchFigure) {
        if self.wants(&figure.name) {
            self.measured.push(figure);
        }
    }

    /// Adds the median and the 99th percentile of a call's times, with a bound of each.
    pub(super) fn push_times(&mut self, name: &str, times: &CallTimes, wanted: [&str; 2]) {
        self.push(BenchFigure::new(name, times.median, "ms", wanted[0]));
        self.push(BenchFigure::new(
            &format!("{name}_p99"),
            times.p99,
            "ms",
            wanted[1],
        ));
    }

    /// Adds those that are wanted.
    pub(super) fn extend(&mut self, figures: impl IntoIterator<Item = BenchFigure>) {
        for figure in figures {
            self.push(figure);
        }
    }

    /// Times a call at least `repeats` times and for two seconds, if the figure is wanted.
    pub(super) fn time_calls(
        &mut self,
        name: &str,
        wanted: &str,
        repeats: usize,
        mut call: impl FnMut(),
    ) {
        if !self.wants(name) {
            return;
        }
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
        self.push(BenchFigure::of_times(name, &CallTimes::of(times), wanted));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentile_is_a_measured_time_that_one_in_a_hundred_exceeds() {
        let times = CallTimes::of((1..=101).rev().map(f64::from).collect());
        assert_eq!((times.median, times.p99), (51.0, 100.0));
        assert_eq!(CallTimes::of(vec![3.0]).p99, 3.0);
        assert!(CallTimes::of(Vec::new()).p99.is_nan());
    }
}
