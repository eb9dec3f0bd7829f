//! Peaks of brightness along a scan line, of any width, by a threshold on their height.

/// A peak with its bases; indices of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peak {
    /// The highest sample.
    pub(crate) index: usize,
    /// Start of the rise.
    pub(crate) left_base: usize,
    /// End of the fall.
    pub(crate) right_base: usize,
    /// Left half-height crossing, interpolated.
    pub(crate) left_edge: f32,
    /// Right half-height crossing, interpolated.
    pub(crate) right_edge: f32,
    /// Height above the higher base, levels.
    pub(crate) contrast: f32,
}

impl Peak {
    /// Midpoint of the edges, samples.
    pub(crate) fn middle(&self) -> f32 {
        (self.left_edge + self.right_edge) / 2.0
    }
}

/// Samples per block when skipping plain carpet: one vector register of bytes.
const BLOCK: usize = 16;

/// Calls `found` with every peak that exceeds the valleys on both sides by the local threshold.
///
/// Thresholds must not rise along the line (lines appear thinner and fainter outward).
///
/// A valley may be far from the peak and much deeper than its surroundings. So the bases are searched downhill from the
/// peak, to where the values stop falling.
pub(crate) fn find_peaks(values: &[u8], thresholds: &[u8], mut found: impl FnMut(Peak)) {
    let mut scanner = PeakScanner {
        low: u8::MAX,
        low_index: 0,
        high: 0,
        high_index: 0,
        rising: false,
        left_valley: 0,
    };
    let (blocks, rest) = values.as_chunks::<BLOCK>();
    for (number, block) in blocks.iter().enumerate() {
        let start = number * BLOCK;
        if !scanner.skip_block(block, start, thresholds[start + BLOCK - 1]) {
            scanner.scan_samples(values, thresholds, start..start + BLOCK, &mut found);
        }
    }
    let rest = values.len() - rest.len()..values.len();
    scanner.scan_samples(values, thresholds, rest, &mut found);
}

/// State of the scan: rising to a peak or falling to a valley.
struct PeakScanner {
    low: u8,
    low_index: usize,
    high: u8,
    high_index: usize,
    rising: bool,
    left_valley: usize,
}

impl PeakScanner {
    /// Skips a block in which no peak can start or end; returns false if it must be scanned.
    fn skip_block(&mut self, block: &[u8; BLOCK], start: usize, threshold: u8) -> bool {
        let (least, most) = min_max(block);
        if self.rising {
            let high = self.high.max(most);
            if high - least >= threshold {
                return false;
            }
            if most > self.high
                && let Some(place) = block.iter().position(|&value| value == most)
            {
                (self.high, self.high_index) = (most, start + place);
            }
            return true;
        }
        let low = self.low.min(least);
        if most.saturating_sub(low) >= threshold {
            return false;
        }
        if least < self.low {
            // The valley only bounds the search for a base; the block's start is exact enough.
            (self.low, self.low_index) = (least, start);
        }
        true
    }

    fn scan_samples(
        &mut self,
        values: &[u8],
        thresholds: &[u8],
        range: std::ops::Range<usize>,
        found: &mut impl FnMut(Peak),
    ) {
        let (values_here, thresholds) = (&values[..range.end], &thresholds[..range.end]);
        let mut index = range.start;
        while index < range.end {
            if self.rising {
                let Some(fall) = self.find_fall(values_here, thresholds, index) else {
                    return;
                };
                if let Some(peak) =
                    measure_peak(values, self.left_valley, self.high_index, thresholds[fall])
                {
                    found(peak);
                }
                self.rising = false;
                (self.low, self.low_index) = (values[fall], fall);
                index = fall + 1;
            } else {
                let Some(rise) = self.find_rise(values_here, thresholds, index) else {
                    return;
                };
                self.rising = true;
                self.left_valley = self.low_index;
                (self.high, self.high_index) = (values[rise], rise);
                index = rise + 1;
            }
        }
    }

    /// First sample that is by its threshold below the maximum so far.
    fn find_fall(&mut self, values: &[u8], thresholds: &[u8], start: usize) -> Option<usize> {
        let (mut high, mut high_at) = (self.high, self.high_index);
        let samples = values[start..].iter().zip(&thresholds[start..]);
        let mut fall = None;
        for (index, (&value, &threshold)) in (start..).zip(samples) {
            if high.saturating_sub(value) >= threshold {
                fall = Some(index);
                break;
            }
            high_at = if value > high { index } else { high_at };
            high = high.max(value);
        }
        (self.high, self.high_index) = (high, high_at);
        fall
    }

    /// First sample that is by its threshold above the minimum so far.
    fn find_rise(&mut self, values: &[u8], thresholds: &[u8], start: usize) -> Option<usize> {
        let (mut low, mut low_at) = (self.low, self.low_index);
        let samples = values[start..].iter().zip(&thresholds[start..]);
        let mut rise = None;
        for (index, (&value, &threshold)) in (start..).zip(samples) {
            if value.saturating_sub(low) >= threshold {
                rise = Some(index);
                break;
            }
            low_at = if value < low { index } else { low_at };
            low = low.min(value);
        }
        (self.low, self.low_index) = (low, low_at);
        rise
    }
}

/// Minimum and maximum of a block; vectorises only as a separate function.
#[inline(never)]
fn min_max(block: &[u8; BLOCK]) -> (u8, u8) {
    let least = block.iter().fold(u8::MAX, |least, &value| least.min(value));
    let most = block.iter().fold(0, |most: u8, &value| most.max(value));
    (least, most)
}

fn measure_peak(values: &[u8], left_valley: usize, peak: usize, threshold: u8) -> Option<Peak> {
    let level = i32::from(values[peak]);
    let threshold = i32::from(threshold);
    let step_min = (threshold / 4).max(1);
    let value = |index: usize| i32::from(values[index]);
    let mut left = peak;
    while left > left_valley && level - value(left) < threshold {
        left -= 1;
    }
    while left > left_valley && value(left) - value(left - 1) >= step_min {
        left -= 1;
    }
    let mut right = peak;
    while right + 1 < values.len() && level - value(right) < threshold {
        right += 1;
    }
    while right + 1 < values.len() && value(right) - value(right + 1) >= step_min {
        right += 1;
    }
    let (left_level, right_level) = (value(left), value(right));
    let edge = |foot: i32, from: usize, outward: isize| {
        let half = (level + foot) as f32 / 2.0;
        let mut index = from;
        loop {
            let next = index.checked_add_signed(outward)?;
            let outer = f32::from(*values.get(next)?);
            if outer <= half {
                let inner = f32::from(values[index]);
                let part = (inner - half) / (inner - outer).max(1e-3);
                return Some(index as f32 + outward as f32 * part);
            }
            index = next;
        }
    };
    Some(Peak {
        index: peak,
        left_base: left,
        right_base: right,
        left_edge: edge(left_level, peak, -1)?,
        right_edge: edge(right_level, peak, 1)?,
        contrast: (level - left_level.max(right_level)) as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collect_peaks(values: &[u8], threshold: u8) -> Vec<Peak> {
        let mut peaks = Vec::new();
        find_peaks(values, &vec![threshold; values.len()], |peak| {
            peaks.push(peak)
        });
        peaks
    }

    #[test]
    fn peak_bases_stop_at_an_adjacent_dark_rod() {
        let values = [
            80, 80, 81, 140, 200, 200, 140, 80, 80, 80, 10, 10, 10, 80, 80,
        ];
        let peaks = collect_peaks(&values, 20);
        assert_eq!(peaks.len(), 1);
        let peak = peaks[0];
        assert!(
            (peak.left_edge - 3.0).abs() < 0.1 && (peak.right_edge - 6.0).abs() < 0.1,
            "{peak:?}"
        );
        assert!(peak.right_base <= 8);
    }

    #[test]
    fn adjacent_faint_lines_are_separate_peaks() {
        let values = [80, 80, 95, 80, 80, 97, 81, 80];
        let peaks = collect_peaks(&values, 8);
        assert_eq!(peaks.len(), 2);
        assert!((peaks[0].left_edge + peaks[0].right_edge - 4.0).abs() < 0.2);
    }

    #[test]
    fn step_edge_is_not_a_peak() {
        assert!(collect_peaks(&[80, 80, 80, 200, 200, 200, 200], 20).is_empty());
    }
}
