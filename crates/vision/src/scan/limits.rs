//! Limits reading of the scan lines to the carpet and a margin beyond its boundary.

use crate::scan::pattern::{ScanPattern, ScanSample, ScanSegment};

/// Samples per block: one vector register of bytes.
const BLOCK: usize = 16;

/// Extent of a block of samples, to test whether it lies beyond the carpet.
#[derive(Debug, Clone, Copy)]
struct SampleBlock {
    /// Range of its nearest sample, metres.
    nearest: f32,
    /// First of the rays (see [`crate::objects::radial_scan`]) that enclose its samples.
    ray: u16,
    /// Number of further rays.
    extra_rays: u16,
}

/// The blocks of all scan lines.
#[derive(Debug, Clone)]
pub(crate) struct ScanLimits {
    blocks: Vec<SampleBlock>,
    /// Index of each segment's first block, and one past the last.
    starts: Vec<u32>,
}

impl ScanLimits {
    /// `rays`: number of directions of the carpet's boundary.
    pub(crate) fn new(pattern: &ScanPattern, rays: usize) -> Self {
        let (mut blocks, mut starts) = (Vec::new(), vec![0]);
        for segment in &pattern.segments {
            let samples = &pattern.samples[segment.start as usize..segment.end as usize];
            blocks.extend(
                samples
                    .chunks(BLOCK)
                    .map(|block| SampleBlock::new(block, rays)),
            );
            starts.push(blocks.len() as u32);
        }
        ScanLimits { blocks, starts }
    }

    /// One past the last sample of a segment to read; `carpet_end`: one entry per ray, metres.
    ///
    /// Includes one block beyond the boundary, so that a peak across it is complete.
    pub(crate) fn segment_end(
        &self,
        segment: usize,
        segments: &[ScanSegment],
        carpet_end: &[f32],
    ) -> usize {
        let ScanSegment { start, end, .. } = segments[segment];
        let blocks = &self.blocks[self.starts[segment] as usize..self.starts[segment + 1] as usize];
        let kept = blocks
            .iter()
            .rposition(|block| !block.is_beyond_carpet(carpet_end));
        let samples = kept.map_or(0, |last| (last + 2) * BLOCK);
        (start as usize + samples).min(end as usize)
    }
}

impl SampleBlock {
    fn new(samples: &[ScanSample], rays: usize) -> Self {
        let place = |sample: &ScanSample| sample.azimuth_turns * rays as f32;
        let first = samples.first().map_or(0.0, place);
        // Relative to the first sample, so that blocks across azimuth 0 stay narrow.
        let half = rays as f32 / 2.0;
        let unwound = |sample| (place(sample) - first + half).rem_euclid(rays as f32) - half;
        let (mut least, mut most) = (0.0f32, 0.0f32);
        let mut nearest = f32::INFINITY;
        for sample in samples {
            least = least.min(unwound(sample));
            most = most.max(unwound(sample));
            nearest = nearest.min(sample.range);
        }
        let (lower, upper) = ((first + least).floor(), (first + most).floor() + 1.0);
        SampleBlock {
            nearest,
            ray: lower.rem_euclid(rays as f32) as u16,
            extra_rays: (upper - lower) as u16,
        }
    }

    /// True if the carpet ends before the block in all its directions.
    fn is_beyond_carpet(&self, carpet_end: &[f32]) -> bool {
        let count = carpet_end.len();
        let mut rays = usize::from(self.ray)..=usize::from(self.ray) + usize::from(self.extra_rays);
        rays.all(|ray| carpet_end[ray % count] < self.nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::pattern::ScanKind;

    /// One radial line along image right, half a metre per sample, alternating slightly to both sides.
    fn pattern() -> ScanPattern {
        let sample = |index: usize| ScanSample {
            u: 0,
            v: 0,
            ground: [0.0; 2],
            range: 0.5 * index as f32,
            radial_footprint: 0.5,
            tangential_footprint: 0.5,
            azimuth_turns: if index.is_multiple_of(2) {
                0.001
            } else {
                0.999
            },
        };
        ScanPattern {
            samples: (0..64).map(sample).collect(),
            segments: vec![ScanSegment {
                kind: ScanKind::Radial,
                line_index: 0,
                start: 0,
                end: 64,
            }],
            pixel_count: 64,
            coverage: 1.0,
        }
    }

    fn end(carpet_end: &[f32]) -> usize {
        let pattern = pattern();
        ScanLimits::new(&pattern, carpet_end.len()).segment_end(0, &pattern.segments, carpet_end)
    }

    #[test]
    fn scan_line_is_read_one_block_past_the_carpet_end() {
        let mut carpet_end = [f32::INFINITY; 12];
        assert_eq!(end(&carpet_end), 64);
        // The rays adjacent to image right are the last, the first and the second.
        for ray in [11, 0, 1] {
            carpet_end[ray] = 7.0;
        }
        assert_eq!(end(&carpet_end), 32);
        carpet_end[11] = 9.0;
        assert_eq!(end(&carpet_end), 48);
        assert_eq!(end(&[-1.0; 12]), 0);
    }
}
