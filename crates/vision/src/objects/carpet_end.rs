//! Where does the carpet end along each ray? One bit for each sample tells carpet from anything else.

use std::ops::Range;

use crate::colour::class_bits::{WORD, class_bits};
use crate::colour::lookup_table::ColourClass;
use crate::config::ObjectDetectionConfig;
use crate::objects::radial_scan::RadialScan;

/// End of the carpet along one ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CarpetEnd {
    /// Range of the last carpet sample, metres; infinite if nothing ends the carpet or none is visible.
    pub(crate) range: f32,
    /// First sample beyond it.
    pub(crate) first_beyond: usize,
    /// True if the ray shows carpet.
    pub(crate) carpet_seen: bool,
}

/// Samples of a ray that count as next to the robot.
const NEAR_ROBOT_SAMPLES: u32 = 8;
/// Share of its width that counts of a white gap.
const WHITE_SHARE: f32 = 0.25;

/// The carpet among the samples of one ray, by words of bits.
#[derive(Default)]
struct CarpetBits {
    carpet: Vec<u64>,
    /// Samples at which carpet starts again: they and three of the four before are carpet. Fewer are noise on a dark object.
    resumed: Vec<u64>,
    /// The first sample of carpet.
    first: Option<usize>,
}

impl CarpetBits {
    fn read(&mut self, classes: &[ColourClass], ray: Range<usize>) {
        self.carpet.clear();
        self.resumed.clear();
        let mut before = 0;
        for here in class_bits(classes, ray, ColourClass::CARPET) {
            let [a, b, c, d] = [1, 2, 3, 4].map(|lag| here << lag | before >> (WORD - lag));
            let three = (a & b) & (c | d) | (c & d) & (a | b);
            self.carpet.push(here);
            self.resumed.push(here & three);
            before = here;
        }
        let start = self.carpet.first().map_or(0, |&carpet| {
            // Next to the robot little carpet may be visible before an obstacle: two samples suffice.
            let near = (1 << NEAR_ROBOT_SAMPLES) - 1;
            carpet & carpet << 1 & near | self.resumed[0]
        });
        self.first = match start {
            0 => first_bit(&self.resumed, 0, 0),
            start => Some(start.trailing_zeros() as usize),
        };
    }

    /// The first sample from one on that is not carpet, or one past the last.
    fn end_of_run(&self, from: usize, samples: usize) -> usize {
        first_bit(&self.carpet, from, u64::MAX).map_or(samples, |end| end.min(samples))
    }
}

/// The first set bit from a place on, of words that are combined with a mask by exclusive or.
fn first_bit(words: &[u64], from: usize, mask: u64) -> Option<usize> {
    let mut open = u64::MAX << (from % WORD);
    for (index, word) in words.iter().enumerate().skip(from / WORD) {
        let bits = (word ^ mask) & open;
        if bits != 0 {
            return Some(index * WORD + bits.trailing_zeros() as usize);
        }
        open = u64::MAX;
    }
    None
}

/// What is known of one ray.
struct RayView<'a> {
    classes: &'a [ColourClass],
    /// Metres.
    ranges: &'a [f32],
    /// True if ranges never fall.
    ascending: bool,
}

/// Finds the end of the carpet along each ray.
///
/// Gaps of up to `carpet_gap_max` plus `carpet_gap_per_range` times the range are ignored: cables, shadows, a ball.
/// White counts a quarter, since a line may point at the robot. A ray whose nearest samples are covered (own body,
/// a rod) starts at its first carpet.
pub(crate) fn find_carpet_ends(
    rays: &RadialScan,
    config: &ObjectDetectionConfig,
) -> Vec<CarpetEnd> {
    let mut bits = CarpetBits::default();
    let carpet_end = |ray| {
        let samples = rays.starts[ray]..rays.starts[ray + 1];
        let view = RayView {
            classes: &rays.classes[samples.clone()],
            ranges: &rays.ranges[samples.clone()],
            ascending: rays.ascending[ray],
        };
        bits.read(&rays.classes, samples.clone());
        let end = view.find_carpet_end(&bits, config);
        CarpetEnd {
            first_beyond: samples.start + end.first_beyond,
            ..end
        }
    };
    (0..rays.count()).map(carpet_end).collect()
}

impl RayView<'_> {
    fn find_carpet_end(&self, bits: &CarpetBits, config: &ObjectDetectionConfig) -> CarpetEnd {
        let samples = self.classes.len();
        let endless = |carpet_seen| CarpetEnd {
            range: f32::INFINITY,
            first_beyond: samples,
            carpet_seen,
        };
        let Some(mut first) = bits.first else {
            return endless(false);
        };
        loop {
            let gap_start = bits.end_of_run(first, samples);
            let resumed = first_bit(&bits.resumed, gap_start, 0);
            let range = self.ranges[gap_start - 1];
            let gap_max = config.carpet_gap_max + config.carpet_gap_per_range * range;
            if self.is_gap_wider(gap_start..resumed.unwrap_or(samples), gap_max) {
                return CarpetEnd {
                    range,
                    first_beyond: gap_start,
                    carpet_seen: true,
                };
            }
            match resumed {
                Some(index) => first = index,
                None => return endless(true),
            }
        }
    }

    /// True if a gap after carpet covers more ground than a limit, metres; white counts a quarter.
    fn is_gap_wider(&self, gap: Range<usize>, limit: f32) -> bool {
        if gap.is_empty() {
            return false;
        }
        let ranges = &self.ranges[gap.start - 1..gap.end];
        // Both ends bound the sum and mostly suffice; rounding is far smaller than this margin.
        const MARGIN: f32 = 1e-3;
        let whole = ranges[gap.len()] - ranges[0];
        if self.ascending && whole < (1.0 - MARGIN) * limit {
            return false;
        }
        if self.ascending && WHITE_SHARE * whole > (1.0 + MARGIN) * limit {
            return true;
        }
        let mut width = 0.0;
        let steps = ranges.array_windows().map(|[before, here]| here - before);
        steps.zip(&self.classes[gap]).any(|(step, &class)| {
            let share = if class == ColourClass::WHITE {
                WHITE_SHARE
            } else {
                1.0
            };
            width += share * step;
            width > limit
        })
    }
}

/// True if the carpet reaches at least `more` metres beyond `range` on both sides of a group of rays.
///
/// Skips one ray on each side, which may graze the silhouette.
pub(crate) fn occludes_carpet_end(
    carpet_ends: &[CarpetEnd],
    group: &[usize],
    range: f32,
    more: f32,
) -> bool {
    let (Some(first), Some(last)) = (group.first(), group.last()) else {
        return false;
    };
    let count = carpet_ends.len();
    [(first + count - 2) % count, (last + 2) % count]
        .iter()
        .all(|&ray| carpet_ends[ray].range - range >= more)
}
