//! Upper bounds of the scores of all blocks at a heading, as sums of table rows.

use super::tables::{BATCH, BLOCK, LANES, ROWS, ScoreTables};
use super::{BranchAndBound, HeadingRange, SearchBuffers};

impl BranchAndBound {
    /// Clears the bounds for a search over `headings`.
    ///
    /// Rows are `bounds_width` long, zero beyond the blocks, and padded to a multiple of `ROWS`.
    pub(super) fn start_bounds(&mut self, headings: &HeadingRange) {
        let layer = bounds_layer(&self.tables);
        self.search.bounds.resize(headings.count * layer, 0);
        self.search.offsets.clear();
    }

    /// Computes the bounds of all blocks at the `indices` of headings, which continue the previous ones, and the points'
    /// offsets at each heading.
    pub(super) fn compute_bounds(
        &mut self,
        headings: &HeadingRange,
        indices: std::ops::Range<usize>,
    ) {
        let tables = &self.tables;
        let layer = bounds_layer(tables);
        let SearchBuffers {
            bounds,
            offsets,
            selected_points,
            ..
        } = &mut self.search;
        let mut bases = Vec::with_capacity(selected_points.len());
        let layers = bounds.chunks_exact_mut(layer).enumerate();
        for (index, bounds) in layers.take(indices.end).skip(indices.start) {
            let start = offsets.len();
            tables.point_offsets(selected_points, headings.heading(index), offsets);
            bases.clear();
            bases.extend(offsets[start..].iter().map(|&(x, y)| {
                let (x, y) = (x as usize, y as usize);
                let plane = (y % BLOCK) * BLOCK + x % BLOCK;
                plane * tables.plane_size + (y / BLOCK) * tables.plane_stride + x / BLOCK
            }));
            // A field of 25 m has rows of 128 blocks with padding, the largest allowed field 4096.
            match tables.plane_stride {
                128 => bound_heading::<128, 512>(tables, &bases, bounds),
                256 => bound_heading::<256, 1024>(tables, &bases, bounds),
                512 => bound_heading::<512, 2048>(tables, &bases, bounds),
                1024 => bound_heading::<1024, 4096>(tables, &bases, bounds),
                2048 => bound_heading::<2048, 8192>(tables, &bases, bounds),
                _ => bound_heading::<4096, 16384>(tables, &bases, bounds),
            }
        }
    }
}

/// Number of bounds at one heading.
pub(super) fn bounds_layer(tables: &ScoreTables) -> usize {
    tables.rows.next_multiple_of(ROWS) * bounds_width(tables)
}

/// Number of blocks in a row of bounds.
pub(super) fn bounds_width(tables: &ScoreTables) -> usize {
    tables.columns.next_multiple_of(LANES)
}

/// Bounds at one heading; `SPAN` bytes are `ROWS` rows of `STRIDE` bytes.
fn bound_heading<const STRIDE: usize, const SPAN: usize>(
    tables: &ScoreTables,
    bases: &[usize],
    bounds: &mut [u16],
) {
    let width = bounds_width(tables);
    for (group, bounds) in bounds.chunks_exact_mut(ROWS * width).enumerate() {
        for first in (0..width).step_by(LANES) {
            let planes = &tables.planes[group * ROWS * STRIDE + first..];
            let sums = sum_rows::<STRIDE, SPAN>(planes, bases);
            for (sums, row) in sums.iter().zip(bounds.chunks_exact_mut(width)) {
                row[first..first + LANES].copy_from_slice(sums);
            }
        }
        for row in bounds.chunks_exact_mut(width) {
            row[tables.columns..].fill(0);
        }
    }
}

/// Sums `ROWS` rows of blocks over all points: in bytes per batch, widened to u16 before they overflow.
fn sum_rows<const STRIDE: usize, const SPAN: usize>(
    planes: &[u8],
    bases: &[usize],
) -> [[u16; LANES]; ROWS] {
    let mut sums = [[0_u16; LANES]; ROWS];
    for batch in bases.chunks(BATCH) {
        let mut bytes = [[0_u8; LANES]; ROWS];
        for &base in batch {
            let Some(span) = planes
                .get(base..)
                .and_then(|from| from.first_chunk::<SPAN>())
            else {
                continue;
            };
            for row in 0..ROWS {
                for lane in 0..LANES {
                    bytes[row][lane] = bytes[row][lane].wrapping_add(span[row * STRIDE + lane]);
                }
            }
        }
        for row in 0..ROWS {
            for lane in 0..LANES {
                sums[row][lane] += u16::from(bytes[row][lane]);
            }
        }
    }
    sums
}
