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

/// Calls `found` with every peak that stands out by `threshold` from the valleys on both its sides.
///
/// The valley may lie far from the peak and much deeper than what borders it, so the feet are sought from the peak
/// downward: the fall ends where the next samples fall no further.
pub(crate) fn peaks(values: &[u8], threshold: u8, mut found: impl FnMut(Run)) {
    let (mut low, mut low_at) = (u8::MAX, 0);
    let (mut high, mut high_at) = (0u8, 0);
    let mut rising = false;
    let mut left_valley = 0;
    for (index, &value) in values.iter().enumerate() {
        if rising {
            if value > high {
                (high, high_at) = (value, index);
            } else if high - value >= threshold {
                if let Some(run) = run(values, left_valley, high_at, threshold) {
                    found(run);
                }
                rising = false;
                (low, low_at) = (value, index);
            }
        } else if value < low {
            (low, low_at) = (value, index);
        } else if value - low >= threshold {
            rising = true;
            left_valley = low_at;
            (high, high_at) = (value, index);
        }
    }
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
        peaks(values, threshold, |run| runs.push(run));
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
