//! How long did it take? Times in bins of fixed number, so that a day's run needs no more memory than its first minute.

use serde::Serialize;

/// Width of a bin, milliseconds.
const BIN_MS: f64 = 0.02;
/// Bins; what takes longer than all of them is in the last.
const BINS: usize = 10_000;

/// A distribution of times.
#[derive(Debug, Clone)]
pub struct Times {
    bins: Vec<u32>,
    count: u64,
    max_ms: f64,
}

/// A distribution in three numbers, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Quantiles {
    /// Half are below.
    pub median: f64,
    /// 99 % are below.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

impl Default for Times {
    fn default() -> Self {
        Times {
            bins: vec![0; BINS],
            count: 0,
            max_ms: 0.0,
        }
    }
}

impl Times {
    /// Counts one, milliseconds.
    pub fn add(&mut self, time_ms: f64) {
        let bin = (time_ms.max(0.0) / BIN_MS) as usize;
        self.bins[bin.min(BINS - 1)] += 1;
        self.count += 1;
        self.max_ms = self.max_ms.max(time_ms);
    }

    /// The distribution so far; zeros if nothing was counted.
    pub fn quantiles(&self) -> Quantiles {
        Quantiles {
            median: self.below(0.5),
            p99: self.below(0.99),
            max: self.max_ms,
        }
    }

    /// The upper end of the bin that holds the given share's last.
    fn below(&self, share: f64) -> f64 {
        let wanted = (share * self.count as f64).ceil() as u64;
        let mut counted = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            counted += u64::from(*count);
            if wanted > 0 && counted >= wanted {
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
    fn one_slow_frame_in_a_hundred_is_the_longest_and_not_the_99th_percentile() {
        let mut times = Times::default();
        (0..99).for_each(|step| times.add(1.0 + f64::from(step) * 0.01));
        times.add(900.0);
        let quantiles = times.quantiles();
        assert!((quantiles.median - 1.5).abs() < 0.03, "{quantiles:?}");
        assert!((quantiles.p99 - 1.98).abs() < 0.03, "{quantiles:?}");
        assert_eq!(quantiles.max, 900.0);
        assert_eq!(Times::default().quantiles(), Quantiles::default());
    }
}
