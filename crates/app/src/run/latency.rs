//! How are latencies distributed? A histogram with a fixed number of bins, so that memory does not grow with time.

use serde::Serialize;

/// Width of a bin, milliseconds.
const BIN_MS: f64 = 0.02;
/// Number of bins. The last one holds all longer times.
const BINS: usize = 10_000;

/// A distribution of times.
#[derive(Debug, Clone)]
pub(crate) struct LatencyHistogram {
    bins: Vec<u32>,
    count: u64,
    max_ms: f64,
}

/// Quantiles of a distribution, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(crate) struct LatencySummary {
    /// Half are below.
    pub median: f64,
    /// 99 % are below.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        LatencyHistogram {
            bins: vec![0; BINS],
            count: 0,
            max_ms: 0.0,
        }
    }
}

impl LatencyHistogram {
    /// Adds a time, milliseconds.
    pub(crate) fn add(&mut self, time_ms: f64) {
        let bin = (time_ms.max(0.0) / BIN_MS) as usize;
        self.bins[bin.min(BINS - 1)] += 1;
        self.count += 1;
        self.max_ms = self.max_ms.max(time_ms);
    }

    /// The quantiles so far; zeros if empty.
    pub(crate) fn summary(&self) -> LatencySummary {
        LatencySummary {
            median: self.quantile(0.5),
            p99: self.quantile(0.99),
            max: self.max_ms,
        }
    }

    /// The upper end of the bin that holds the quantile.
    fn quantile(&self, share: f64) -> f64 {
        let rank = (share * self.count as f64).ceil() as u64;
        let mut counted = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            counted += u64::from(*count);
            if rank > 0 && counted >= rank {
                return ((bin + 1) as f64 * BIN_MS).min(self.max_ms);
            }
        }
        self.max_ms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_outlier_in_100_sets_max_but_not_p99() {
        let mut times = LatencyHistogram::default();
        (0..99).for_each(|step| times.add(1.0 + f64::from(step) * 0.01));
        times.add(900.0);
        let quantiles = times.summary();
        assert!((quantiles.median - 1.5).abs() < 0.03, "{quantiles:?}");
        assert!((quantiles.p99 - 1.98).abs() < 0.03, "{quantiles:?}");
        assert_eq!(quantiles.max, 900.0);
        assert_eq!(
            LatencyHistogram::default().summary(),
            LatencySummary::default()
        );
    }
}
