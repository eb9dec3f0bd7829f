//! How far does a peak of brightness reach to both sides? Outward from its highest sample, 32 samples at a time.
//!
//! The end of a search is a bit of a mask. Loops that end after a few samples each are often foreseen wrongly.

use std::ops::Range;

use wide::u8x32;

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

/// Samples at a time: one vector register of bytes.
const WINDOW: usize = 32;

/// Measures a peak; None if a flank does not fall to half of its height. Indices are those of the line's samples.
///
/// `values`: of all scan lines; `line`: the samples of one.
pub(super) fn measure_peak(
    values: &[u8],
    line: Range<usize>,
    left_valley: usize,
    peak: usize,
    threshold: u8,
) -> Option<Peak> {
    let top = line.start + peak;
    let left = Flank::<true> {
        values,
        top,
        length: peak,
    };
    let right = Flank::<false> {
        values,
        top,
        length: line.len() - 1 - peak,
    };
    let left_base = left.base(peak - left_valley, threshold);
    let right_base = right.base(right.length, threshold);
    let (left_level, right_level) = (left.value(left_base), right.value(right_base));
    Some(Peak {
        index: peak,
        left_base: peak - left_base,
        right_base: peak + right_base,
        left_edge: left.edge(peak, left_level)?,
        right_edge: right.edge(peak, right_level)?,
        contrast: f32::from(values[top]) - f32::from(left_level.max(right_level)),
    })
}

/// The samples on one side of a peak, by their distance from its highest sample.
struct Flank<'a, const LEFT: bool> {
    /// Those of all scan lines.
    values: &'a [u8],
    /// Index of the highest sample.
    top: usize,
    /// Distance of the line's last sample.
    length: usize,
}

impl<const LEFT: bool> Flank<'_, LEFT> {
    fn value(&self, distance: usize) -> u8 {
        self.values[match LEFT {
            true => self.top - distance,
            false => self.top + distance,
        }]
    }

    /// Values from a distance on. Those beyond the line mean nothing.
    #[inline(always)]
    fn window(&self, distance: usize) -> u8x32 {
        let outward = match LEFT {
            true => &self.values[..self.top + 1 - distance],
            false => &self.values[self.top + distance..],
        };
        let window = match LEFT {
            true => outward.last_chunk().map(reversed),
            false => outward.first_chunk().map(|&window| u8x32::from(window)),
        };
        window.unwrap_or_else(|| padded::<LEFT>(outward))
    }

    /// First distance from one on at which the samples there and one farther satisfy a condition, or `last`.
    #[inline(always)]
    fn find(&self, from: usize, last: usize, condition: impl Fn(u8x32, u8x32) -> u8x32) -> usize {
        let mut start = from - from % WINDOW;
        let mut open = u32::MAX << (from % WINDOW);
        while start < last {
            let (here, farther) = (self.window(start), self.window(start + 1));
            let bits = condition(here, farther).to_bitmask() & open;
            if bits != 0 {
                return last.min(start + bits.trailing_zeros() as usize);
            }
            (start, open) = (start + WINDOW, u32::MAX);
        }
        last
    }

    /// Distance at which values stop falling, once they are by the threshold below the highest.
    #[inline(always)]
    fn base(&self, last: usize, threshold: u8) -> usize {
        let level = u8x32::splat(self.value(0));
        let height = u8x32::splat(threshold);
        let step_min = u8x32::splat((threshold / 4).max(1));
        let low = self.find(0, last, |here, _| {
            level.saturating_sub(here).simd_ge(height)
        });
        self.find(low, last, |here, farther| {
            !here.saturating_sub(farther).simd_ge(step_min)
        })
    }

    /// Index of the crossing of half the height above a foot, interpolated; `peak`: index of the highest sample.
    #[inline(always)]
    fn edge(&self, peak: usize, foot: u8) -> Option<f32> {
        let doubled = u16::from(self.value(0)) + u16::from(foot);
        let half = f32::from(doubled) / 2.0;
        let limit = u8x32::splat((doubled / 2) as u8);
        let distance = self.find(1, self.length + 1, |here, _| here.simd_le(limit));
        if distance > self.length {
            return None;
        }
        let inner = f32::from(self.value(distance - 1));
        let outer = f32::from(self.value(distance));
        let part = (inner - half) / (inner - outer).max(1e-3);
        Some(match LEFT {
            true => (peak - (distance - 1)) as f32 - part,
            false => (peak + (distance - 1)) as f32 + part,
        })
    }
}

/// A window in reverse order.
#[inline(always)]
fn reversed(window: &[u8; WINDOW]) -> u8x32 {
    const HALF: usize = WINDOW / 2;
    const REVERSED: [u8; WINDOW] = {
        let mut lanes = [0; WINDOW];
        let mut lane = 0;
        while lane < WINDOW {
            lanes[lane] = (HALF - 1 - lane % HALF) as u8;
            lane += 1;
        }
        lanes
    };
    let mut swapped = [0; WINDOW];
    swapped[..HALF].copy_from_slice(&window[HALF..]);
    swapped[HALF..].copy_from_slice(&window[..HALF]);
    u8x32::from(swapped).swizzle_half_relaxed(u8x32::from(REVERSED))
}

/// A window at the first or last samples of all lines.
#[cold]
fn padded<const LEFT: bool>(outward: &[u8]) -> u8x32 {
    let mut window = [0; WINDOW];
    let mut fill = |values: &mut dyn Iterator<Item = &u8>| {
        for (slot, &value) in window.iter_mut().zip(values) {
            *slot = value;
        }
    };
    match LEFT {
        true => fill(&mut outward.iter().rev()),
        false => fill(&mut outward.iter()),
    }
    u8x32::from(window)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, one sample after the other.
    fn measure_peak_singly(
        values: &[u8],
        left_valley: usize,
        peak: usize,
        threshold: u8,
    ) -> Option<Peak> {
        let value = |index: usize| i32::from(values[index]);
        let (level, threshold) = (value(peak), i32::from(threshold));
        let step_min = (threshold / 4).max(1);
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
        let edge = |foot: usize, outward: isize| {
            let half = (level + value(foot)) as f32 / 2.0;
            let mut index = peak;
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
            left_edge: edge(left, -1)?,
            right_edge: edge(right, 1)?,
            contrast: (level - value(left).max(value(right))) as f32,
        })
    }

    #[test]
    fn windows_measure_what_single_samples_do() {
        let mut state = 3u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) % below
        };
        let mut measured = 0;
        for _ in 0..2000 {
            // Slow and fast walks: short and long flanks.
            let step = 1 + random(40) as i32;
            let mut level = 100;
            let values: Vec<u8> = (0..200)
                .map(|_| {
                    level = (level + random(2 * step as u32 + 1) as i32 - step).clamp(0, 255);
                    level as u8
                })
                .collect();
            let start = random(60) as usize;
            let line = start..start + 5 + random(135) as usize;
            let on_line = &values[line.clone()];
            let peak = random(on_line.len() as u32) as usize;
            let valley = random(peak as u32 + 1) as usize;
            let threshold = 1 + random(60) as u8;
            let windows = measure_peak(&values, line.clone(), valley, peak, threshold);
            assert_eq!(
                windows,
                measure_peak_singly(on_line, valley, peak, threshold)
            );
            measured += usize::from(windows.is_some());
        }
        assert!(measured > 500, "{measured}");
    }
}
