//! Tables of a field: the score of a point in each cell, and its maximum in each block, laid out for vector sums.
//!
//! The max-pooled table is stored once per offset modulo the block's side, so that one point's bounds for a row of
//! blocks are consecutive bytes. Row lengths are one of a few constants: a single bounds check then covers several rows.

use super::BranchAndBoundConfig;
use crate::field::Field;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::sample::LinePoint;

/// Side of a block in cells.
pub(super) const BLOCK: usize = 4;
/// Largest score of a cell: the sum of 17 fits one byte.
pub(super) const SCORE_MAX: f32 = 15.0;
/// Number of points summed in bytes before widening.
pub(super) const BATCH: usize = 17;
/// Blocks per row bounded at once: two vector registers of bytes.
pub(super) const LANES: usize = 64;
/// Rows of blocks bounded at once: with `LANES` half of the vector registers.
pub(super) const ROWS: usize = 4;

/// Scores of cells and bounds of blocks of one field.
#[derive(Debug, Clone)]
pub(super) struct ScoreTables {
    /// Scores by cell, `score_stride` bytes per row.
    pub(super) scores: Vec<u8>,
    pub(super) score_stride: usize,
    /// Pooled scores: 16 planes, one per offset modulo the block's side.
    pub(super) planes: Vec<u8>,
    /// A power of two, at least 128.
    pub(super) plane_stride: usize,
    pub(super) plane_size: usize,
    /// Blocks of poses along x and y; rows are padded to a multiple of `ROWS`.
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Blocks of padding on each side, so that every point's offset stays inside.
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
        let padding = ((config.range_max / config.cell).ceil() as usize).div_ceil(BLOCK) + 1;
        let plane_stride = (columns.next_multiple_of(LANES) + 2 * padding)
            .next_power_of_two()
            .max(128);
        let plane_rows = rows.next_multiple_of(ROWS) + 2 * padding;
        let (score_stride, score_rows) = (plane_stride * BLOCK, plane_rows * BLOCK);
        let (x0, y0) = (-half_x * config.cell, -half_y * config.cell);
        let edge = (padding * BLOCK) as f32;
        let squared = config.kernel_scale * config.kernel_scale;
        let scores: Vec<u8> = (0..score_rows * score_stride)
            .map(|k| {
                let x = x0 + ((k % score_stride) as f32 - edge) * config.cell;
                let y = y0 + ((k / score_stride) as f32 - edge) * config.cell;
                let d = distances.nearest(x, y).signed_distance;
                (SCORE_MAX * squared / (squared + d * d)).round() as u8
            })
            .collect();
        let mut tables = ScoreTables {
            planes: Vec::new(),
            plane_stride,
            plane_size: plane_rows * plane_stride,
            scores,
            score_stride,
            columns,
            rows,
            padding,
            x0,
            y0,
            per_cell: 1.0 / config.cell,
        };
        tables.max_pool(score_rows);
        tables
    }

    /// Memory held, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        self.scores.len() + self.planes.len()
    }

    /// Maxima of the blocks that start at each cell, sorted into planes by offset modulo the block's side.
    fn max_pool(&mut self, score_rows: usize) {
        self.planes = vec![0; self.plane_size * BLOCK * BLOCK];
        for row in 0..score_rows {
            for column in 0..self.score_stride {
                let mut best = 0;
                for r in row..(row + BLOCK).min(score_rows) {
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

    /// Appends the points' offsets (columns, rows) from the tables' corner at one heading; points are within `range_max`.
    pub(super) fn point_offsets(
        &self,
        points: &[LinePoint],
        heading: f32,
        offsets: &mut Vec<(u32, u32)>,
    ) {
        let (sin, cos) = math::sin_cos(heading);
        let edge = (self.padding * BLOCK) as f32;
        offsets.extend(points.iter().map(|point| {
            let x = (cos * point.at.x - sin * point.at.y) * self.per_cell;
            let y = (sin * point.at.x + cos * point.at.y) * self.per_cell;
            // Never negative, so that truncation rounds to the nearest.
            ((x + edge + 0.5) as u32, (y + edge + 0.5) as u32)
        }));
    }
}
