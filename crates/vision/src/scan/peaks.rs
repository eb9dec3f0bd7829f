//! Peaks of brightness along a scan line, of any width, by a threshold on their height.

use std::ops::Range;

use wide::u8x16;

use crate::scan::flanks::{Peak, measure_peak};

/// Samples per block when skipping plain carpet: one vector register of bytes.
const BLOCK: usize = 16;

/// Calls `found` with every peak that exceeds the valleys on both sides by the local threshold.
///
/// Thresholds must not rise along the line (lines appear thinner and fainter outward).
///
/// A valley may be far from the peak and much deeper than its surroundings. So the bases are searched downhill from the
/// peak, to where the values stop falling.
///
/// `values`, `thresholds`: of all scan lines; `line`: the samples of one.
pub(crate) fn find_peaks(
    values: &[u8],
    thresholds: &[u8],
    line: Range<usize>,
    mut found: impl FnMut(Peak),
) {
    let mut scanner = PeakScanner {
        low: u8::MAX,
        low_index: 0,
        high: 0,
        high_index: 0,
        rising: false,
        left_valley: 0,
    };
    let thresholds = &thresholds[line.clone()];
    let mut measure = |turn: Turn| {
        let threshold = thresholds[turn.fall];
        let peak = measure_peak(
            values,
            line.clone(),
            turn.left_valley,
            turn.high_index,
            threshold,
        );
        if let Some(peak) = peak {
            found(peak);
        }
    };
    let (blocks, rest) = values[line.clone()].as_chunks::<BLOCK>();
    let (threshold_blocks, threshold_rest) = thresholds.as_chunks::<BLOCK>();
    for (number, (block, thresholds)) in blocks.iter().zip(threshold_blocks).enumerate() {
        let start = number * BLOCK;
        if !scanner.skip_block(block, start, thresholds[BLOCK - 1]) {
            scanner.scan_block(block, thresholds, start, &mut measure);
        }
    }
    if let (Some(&value), Some(&threshold)) = (rest.last(), threshold_rest.last()) {
        // Repeated last samples: at none of them the line turns.
        let (mut block, mut thresholds) = ([value; BLOCK], [threshold; BLOCK]);
        block[..rest.len()].copy_from_slice(rest);
        thresholds[..rest.len()].copy_from_slice(threshold_rest);
        scanner.scan_block(&block, &thresholds, blocks.len() * BLOCK, &mut measure);
    }
}

/// Where a line turns from rising to falling.
struct Turn {
    left_valley: usize,
    high_index: usize,
    /// First sample that is by its threshold below the highest.
    fall: usize,
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

    /// Calls `turned` at every fall from a peak within the block.
    fn scan_block(
        &mut self,
        block: &[u8; BLOCK],
        thresholds: &[u8; BLOCK],
        start: usize,
        turned: &mut impl FnMut(Turn),
    ) {
        let values = u8x16::from(*block);
        let thresholds = u8x16::from(*thresholds);
        let mut lane = 0;
        while lane < BLOCK {
            // A rise is a fall of the complement.
            let (values, extreme) = match self.rising {
                true => (values, self.high),
                false => (!values, !self.low),
            };
            let drop = find_drop(values, thresholds, lane, extreme);
            let (extreme, index) = match self.rising {
                true => (&mut self.high, &mut self.high_index),
                false => (&mut self.low, &mut self.low_index),
            };
            if let Some(highest) = drop.highest {
                *index = start + highest;
                *extreme = block[highest];
            }
            let Some(drop) = drop.lane else {
                return;
            };
            let here = start + drop;
            if self.rising {
                turned(Turn {
                    left_valley: self.left_valley,
                    high_index: self.high_index,
                    fall: here,
                });
                (self.low, self.low_index) = (block[drop], here);
            } else {
                self.left_valley = self.low_index;
                (self.high, self.high_index) = (block[drop], here);
            }
            self.rising = !self.rising;
            lane = drop + 1;
        }
    }
}

/// What [`find_drop`] finds in a block.
struct Drop {
    /// First value that is by its threshold below the highest before it.
    lane: Option<usize>,
    /// First of the highest values before it, or of all; None if an earlier block has one as high.
    highest: Option<usize>,
}

/// Finds where values first drop by their threshold below the highest so far, from a lane on; `high`: the highest before.
#[inline(always)]
fn find_drop(values: u8x16, thresholds: u8x16, lane: usize, high: u8) -> Drop {
    let (_, open) = OPEN_LANES.split_at(BLOCK - lane);
    let open = open
        .first_chunk()
        .map_or(u8x16::ZERO, |&lanes| u8x16::from(lanes));
    let seen = values & open;
    // Highest up to each lane, by doubling.
    let highest = SHIFTS.iter().fold(seen, |highest, &lanes| {
        highest.max(highest.shuffle_zeroing(u8x16::from(lanes)))
    });
    let highest = highest.max(u8x16::splat(high));
    let below = highest.saturating_sub(values);
    let drops = (below.simd_ge(thresholds) & open).to_bitmask();
    let drop = (drops != 0).then_some(drops.trailing_zeros() as usize);
    let last = drop.unwrap_or(BLOCK - 1);
    let top = highest.to_array()[last];
    let tops = (seen.simd_eq(u8x16::splat(top)) & open).to_bitmask();
    Drop {
        lane: drop,
        highest: (top > high).then_some(tops.trailing_zeros() as usize),
    }
}

/// Lanes from one on: a window of these.
const OPEN_LANES: [u8; 2 * BLOCK] = {
    let mut lanes = [0; 2 * BLOCK];
    let mut lane = BLOCK;
    while lane < lanes.len() {
        lanes[lane] = u8::MAX;
        lane += 1;
    }
    lanes
};

/// Indices that shift a vector by 1, 2, 4 and 8 lanes; those outside it give 0.
const SHIFTS: [[u8; BLOCK]; 4] = {
    let mut shifts = [[0; BLOCK]; 4];
    let mut step = 0;
    while step < shifts.len() {
        let mut lane = 0;
        while lane < BLOCK {
            shifts[step][lane] = (lane as u8).wrapping_sub(1 << step);
            lane += 1;
        }
        step += 1;
    }
    shifts
};

/// Minimum and maximum of a block; vectorises only as a separate function.
#[inline(never)]
fn min_max(block: &[u8; BLOCK]) -> (u8, u8) {
    let least = block.iter().fold(u8::MAX, |least, &value| least.min(value));
    let most = block.iter().fold(0, |most: u8, &value| most.max(value));
    (least, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collect_peaks(values: &[u8], threshold: u8) -> Vec<Peak> {
        let mut peaks = Vec::new();
        let thresholds = vec![threshold; values.len()];
        find_peaks(values, &thresholds, 0..values.len(), |peak| {
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
