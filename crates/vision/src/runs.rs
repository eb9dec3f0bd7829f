//! Where does a scan line rise and fall? Peaks between valleys, whatever their width, by a threshold on their height.

/// A peak of a scan line with the feet it stands on, indices of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Run {
    /// The highest sample.
    pub(crate) peak: usize,
    /// Where the rise starts.
    pub(crate) left_foot: usize,
    /// Where the fall ends.
    pub(crate) right_foot: usize,
    /// Crossing of the left half level, between samples.
    pub(crate) left_edge: f32,
    /// Crossing of the right half level, between samples.
    pub(crate) right_edge: f32,
    /// Height over the higher foot, levels.
    pub(crate) contrast: f32,
}

impl Run {
    /// Halfway between its edges, samples.
    pub(crate) fn middle(&self) -> f32 {
        (self.left_edge + self.right_edge) / 2.0
    }
}

/// Plain carpet is passed over in blocks of this many samples: one vector register of bytes.
const BLOCK: usize = 16;

/// Calls `found` with every peak that stands out by its place's threshold from the valleys on both its sides.
///
/// Thresholds must not rise along the line: outward lines grow thinner and fainter.
///
/// The valley may lie far from the peak and much deeper than what borders it, so the feet are sought from the peak
/// downward: the fall ends where the next samples fall no further.
pub(crate) fn peaks(values: &[u8], thresholds: &[u8], mut found: impl FnMut(Run)) {
    let mut walk = Walk {
        low: u8::MAX,
        low_at: 0,
        high: 0,
        high_at: 0,
        rising: false,
        left_valley: 0,
    };
    let (blocks, rest) = values.as_chunks::<BLOCK>();
    for (number, block) in blocks.iter().enumerate() {
        let start = number * BLOCK;
        if !walk.passes(block, start, thresholds[start + BLOCK - 1]) {
            walk.steps(values, thresholds, start..start + BLOCK, &mut found);
        }
    }
    let rest = values.len() - rest.len()..values.len();
    walk.steps(values, thresholds, rest, &mut found);
}

/// Where a walk along the values stands: climbing to a peak, or descending to a valley.
struct Walk {
    low: u8,
    low_at: usize,
    high: u8,
    high_at: usize,
    rising: bool,
    left_valley: usize,
}

impl Walk {
    /// Takes a whole block at once if no peak can begin or end in it.
    fn passes(&mut self, block: &[u8; BLOCK], start: usize, threshold: u8) -> bool {
        let (least, most) = extremes(block);
        if self.rising {
            let high = self.high.max(most);
            if high - least >= threshold {
                return false;
            }
            if most > self.high
                && let Some(place) = block.iter().position(|&value| value == most)
            {
                (self.high, self.high_at) = (most, start + place);
            }
            return true;
        }
        let low = self.low.min(least);
        if most.saturating_sub(low) >= threshold {
            return false;
        }
        if least < self.low {
            // The valley only bounds the search for a foot; the block's start is near enough.
            (self.low, self.low_at) = (least, start);
        }
        true
    }

    fn steps(
        &mut self,
        values: &[u8],
        thresholds: &[u8],
        range: std::ops::Range<usize>,
        found: &mut impl FnMut(Run),
    ) {
        let (values_here, thresholds) = (&values[..range.end], &thresholds[..range.end]);
        let mut index = range.start;
        while index < range.end {
            if self.rising {
                let Some(fall) = self.fall(values_here, thresholds, index) else {
                    return;
                };
                if let Some(run) = run(values, self.left_valley, self.high_at, thresholds[fall]) {
                    found(run);
                }
                self.rising = false;
                (self.low, self.low_at) = (values[fall], fall);
                index = fall + 1;
            } else {
                let Some(rise) = self.rise(values_here, thresholds, index) else {
                    return;
                };
                self.rising = true;
                self.left_valley = self.low_at;
                (self.high, self.high_at) = (values[rise], rise);
                index = rise + 1;
            }
        }
    }

    /// The first sample that lies by its threshold below the highest so far.
    fn fall(&mut self, values: &[u8], thresholds: &[u8], start: usize) -> Option<usize> {
        let (mut high, mut high_at) = (self.high, self.high_at);
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
        (self.high, self.high_at) = (high, high_at);
        fall
    }

    /// The first sample that lies by its threshold above the lowest so far.
    fn rise(&mut self, values: &[u8], thresholds: &[u8], start: usize) -> Option<usize> {
        let (mut low, mut low_at) = (self.low, self.low_at);
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
        (self.low, self.low_at) = (low, low_at);
        rise
    }
}

/// Least and greatest of a block: a dozen vector instructions, as long as it is a function of its own.
#[inline(never)]
fn extremes(block: &[u8; BLOCK]) -> (u8, u8) {
    let least = block.iter().fold(u8::MAX, |least, &value| least.min(value));
    let most = block.iter().fold(0, |most: u8, &value| most.max(value));
    (least, most)
}

fn run(values: &[u8], left_valley: usize, peak: usize, threshold: u8) -> Option<Run> {
    let level = i32::from(values[peak]);
    let threshold = i32::from(threshold);
    let still = (threshold / 4).max(1);
    let value = |index: usize| i32::from(values[index]);
    let mut left = peak;
    while left > left_valley && level - value(left) < threshold {
        left -= 1;
    }
    while left > left_valley && value(left) - value(left - 1) >= still {
        left -= 1;
    }
    let mut right = peak;
    while right + 1 < values.len() && level - value(right) < threshold {
        right += 1;
    }
    while right + 1 < values.len() && value(right) - value(right + 1) >= still {
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
    Some(Run {
        peak,
        left_foot: left,
        right_foot: right,
        left_edge: edge(left_level, peak, -1)?,
        right_edge: edge(right_level, peak, 1)?,
        contrast: (level - left_level.max(right_level)) as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(values: &[u8], threshold: u8) -> Vec<Run> {
        let mut runs = Vec::new();
        peaks(values, &vec![threshold; values.len()], |run| runs.push(run));
        runs
    }

    #[test]
    fn a_line_between_carpet_and_a_black_rod_keeps_its_own_feet() {
        let values = [
            80, 80, 81, 140, 200, 200, 140, 80, 80, 80, 10, 10, 10, 80, 80,
        ];
        let runs = all(&values, 20);
        assert_eq!(runs.len(), 1);
        let run = runs[0];
        assert!(
            (run.left_edge - 3.0).abs() < 0.1 && (run.right_edge - 6.0).abs() < 0.1,
            "{run:?}"
        );
        assert!(run.right_foot <= 8);
    }

    #[test]
    fn two_faint_lines_beside_each_other_are_two_runs() {
        let values = [80, 80, 95, 80, 80, 97, 81, 80];
        let runs = all(&values, 8);
        assert_eq!(runs.len(), 2);
        assert!((runs[0].left_edge + runs[0].right_edge - 4.0).abs() < 0.2);
    }

    #[test]
    fn a_step_is_no_run() {
        assert!(all(&[80, 80, 80, 200, 200, 200, 200], 20).is_empty());
    }
}
