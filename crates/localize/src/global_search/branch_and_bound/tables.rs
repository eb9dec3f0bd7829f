//! What does a point score in each cell, and at most in each block? Tables of one field, laid out for vector sums.
//!
//! The pooled table is stored once per offset modulo the block's side, so that one point's bounds for a row of blocks
//! are consecutive bytes. Rows have one of a few lengths that the compiler knows: then it can tell by one comparison
//! that several rows below each other lie inside the table.

use super::BranchAndBoundConfig;
use crate::field::Field;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;

/// Side of a block in cells.
pub(super) const BLOCK: usize = 4;
/// Largest score of a cell: 17 of them fit one byte.
const SCORE_MAX: f32 = 15.0;
/// Points whose bytes are added before they are widened.
pub(super) const BATCH: usize = 17;
/// Blocks bounded at once along a row: two vector registers of bytes.
pub(super) const LANES: usize = 64;
/// Rows of blocks bounded at once: with `LANES`, half the vector registers there are.
pub(super) const ROWS: usize = 4;

/// Scores of cells and bounds of blocks of one field.
#[derive(Debug, Clone)]
pub(super) struct ScoreTables {
    /// Scores by cell, `fine_stride` bytes per row.
    pub(super) scores: Vec<u8>,
    pub(super) score_stride: usize,
    /// Pooled scores: 16 planes, one per offset modulo the block's side.
    pub(super) planes: Vec<u8>,
    /// A power of two, at least 128.
    pub(super) plane_stride: usize,
    pub(super) plane_size: usize,
    /// Blocks of poses along x and y; rows are filled up to whole `ROWS`.
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Blocks beyond the poses on each side, so that every point's offset stays inside.
    padding: usize,
    /// Position of pose cell (0, 0), metres.
    pub(super) x0: f32,
    pub(super) y0: f32,
    per_cell: f32,
}

impl ScoreTables {
    pub(super) fn new(
        field: &Field,
        distances: &DistanceField,
        config: &BranchAndBoundConfig,
    ) -> Self {
        let cells_of = |half: f32| ((half + config.margin) / config.cell).ceil();
        let (half_x, half_y) = (cells_of(field.length / 2.0), cells_of(field.width / 2.0));
        let blocks_of = |half: f32| (2 * half as usize + 1).div_ceil(BLOCK);
        let (columns, rows) = (blocks_of(half_x), blocks_of(half_y));
        let apron = ((config.range_max / config.cell).ceil() as usize).div_ceil(BLOCK) + 1;
        let plane_stride = (columns.next_multiple_of(LANES) + 2 * apron)
            .next_power_of_two()
            .max(128);
        let plane_rows = rows.next_multiple_of(ROWS) + 2 * apron;
        let (fine_stride, fine_rows) = (plane_stride * BLOCK, plane_rows * BLOCK);
        let (x0, y0) = (-half_x * config.cell, -half_y * config.cell);
        let edge = (apron * BLOCK) as f32;
        let squared = config.kernel_scale * config.kernel_scale;
        let fine: Vec<u8> = (0..fine_rows * fine_stride)
            .map(|k| {
                let x = x0 + ((k % fine_stride) as f32 - edge) * config.cell;
                let y = y0 + ((k / fine_stride) as f32 - edge) * config.cell;
                let d = distances.nearest(x, y).signed_distance;
                (SCORE_MAX * squared / (squared + d * d)).round() as u8
            })
            .collect();
        let mut tables = ScoreTables {
            planes: Vec::new(),
            plane_stride,
            plane_size: plane_rows * plane_stride,
            scores: fine,
            score_stride: fine_stride,
            columns,
            rows,
            padding: apron,
            x0,
            y0,
            per_cell: 1.0 / config.cell,
        };
        tables.max_pool(fine_rows);
        tables
    }

    /// Memory held, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        self.scores.len() + self.planes.len()
    }

    /// Maxima over blocks from every cell on, sorted into planes by offset modulo the block's side.
    fn max_pool(&mut self, fine_rows: usize) {
        self.planes = vec![0; self.plane_size * BLOCK * BLOCK];
        for row in 0..fine_rows {
            for column in 0..self.score_stride {
                let mut best = 0;
                for r in row..(row + BLOCK).min(fine_rows) {
                    let start = r * self.score_stride;
                    let end = start + (column + BLOCK).min(self.score_stride);
                    for &score in &self.scores[start + column..end] {
                        best = best.max(score);
                    }
                }
                let plane = (row % BLOCK) * BLOCK + column % BLOCK;
                let place = (row / BLOCK) * self.plane_stride + column / BLOCK;
                self.planes[plane * self.plane_size + place] = best;
            }
        }
    }

    /// Appends the offsets of points (within `range_max`) in cells at one heading, from the tables' corner on.
    pub(super) fn point_offsets(
        &self,
        points: &[LinePoint],
        heading: f32,
        offsets: &mut Vec<(u32, u32)>,
    ) {
        let (sin, cos) = heading.sin_cos();
        let edge = (self.padding * BLOCK) as f32;
        offsets.extend(points.iter().map(|point| {
            let x = (cos * point.at.x - sin * point.at.y) * self.per_cell;
            let y = (sin * point.at.x + cos * point.at.y) * self.per_cell;
            // Never negative, so that cutting off rounds.
            ((x + edge + 0.5) as u32, (y + edge + 0.5) as u32)
        }));
    }
}
