//! Best-first search: blocks are searched in the order of their bounds until none can hold a better cell.

use super::bound::{bounds_layer, bounds_width};
use super::tables::{BATCH, BLOCK, LANES};
use super::{BranchAndBound, HeadingRange};
use crate::frames::Pose;

/// A block of poses at one heading, with the upper bound of its cells' scores.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PoseBlock {
    pub(super) bound: u16,
    heading: u16,
    row: u16,
    column: u16,
}

impl PoseBlock {
    pub(super) fn new(bound: u16, heading: usize, row: usize, column: usize) -> Self {
        PoseBlock {
            bound,
            heading: heading as u16,
            row: row as u16,
            column: column as u16,
        }
    }

    /// Key of the order of the search: largest bounds first.
    pub(super) fn order(&self) -> (std::cmp::Reverse<u16>, u16, u16, u16) {
        let PoseBlock {
            bound,
            heading,
            row,
            column,
        } = *self;
        (std::cmp::Reverse(bound), heading, row, column)
    }
}

/// A pose cell and its score.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseCell {
    score: u16,
    pub(super) pose: Pose,
}

/// Blocks in the order of their bounds, and the state of the search through them.
#[derive(Debug, Clone)]
pub(super) struct SortedBlocks {
    headings: HeadingRange,
    blocks: Vec<PoseBlock>,
    next: usize,
    /// Best score so far.
    best: u16,
    /// Blocks for runners-up that may still be searched.
    runners_up_left: usize,
    cells: Vec<PoseCell>,
}

/// Number of headings whose best-bounded block is searched first, for an early estimate of the best score.
const SEED_HEADINGS: usize = 4;

impl BranchAndBound {
    /// The blocks that may hold the best cells, in the order of their bounds.
    pub(super) fn sort_blocks(&self, headings: HeadingRange) -> SortedBlocks {
        let count = headings.count;
        let width = bounds_width(&self.tables);
        let layer = bounds_layer(&self.tables);
        // Rows of blocks without the padding, with the indices of heading and row.
        let rows = self.search.bounds[..count * layer]
            .chunks_exact(layer)
            .enumerate()
            .flat_map(|(heading, layer)| {
                let rows = layer.chunks_exact(width).take(self.tables.rows).enumerate();
                rows.map(move |(row, bounds)| (heading, row, bounds))
            });
        let mut best_blocks = vec![PoseBlock::default(); count];
        for (heading, row, bounds) in rows.clone() {
            let bound = bound_max(bounds);
            if bound > best_blocks[heading].bound {
                let column = bounds.iter().position(|&other| other == bound);
                best_blocks[heading] = PoseBlock::new(bound, heading, row, column.unwrap_or(0));
            }
        }
        best_blocks.sort_by_key(|block| std::cmp::Reverse(block.bound));
        let mut best = 0;
        for block in best_blocks.into_iter().take(SEED_HEADINGS) {
            best = best.max(self.best_cell(block, &headings).score);
        }
        let floor = self.score_min(best);
        let mut blocks: Vec<PoseBlock> = Vec::new();
        for (heading, row, bounds) in rows {
            if bound_max(bounds) <= floor {
                continue;
            }
            let promising = bounds
                .iter()
                .enumerate()
                .filter(|(_, bound)| **bound > floor);
            blocks.extend(
                promising.map(|(column, &bound)| PoseBlock::new(bound, heading, row, column)),
            );
        }
        blocks.sort_unstable_by_key(PoseBlock::order);
        SortedBlocks {
            headings,
            blocks,
            next: 0,
            best,
            runners_up_left: self.config.runner_up_blocks,
            cells: Vec::new(),
        }
    }

    /// Smallest score of a hypothesis.
    fn score_min(&self, best: u16) -> u16 {
        (f32::from(best) * self.config.runner_up_share) as u16
    }

    /// Searches the next blocks, `count` at most. Returns true when no other block can hold a better cell.
    pub(super) fn search_blocks(&self, sorted: &mut SortedBlocks, count: usize) -> bool {
        let end = sorted.blocks.len().min(sorted.next.saturating_add(count));
        while sorted.next < end {
            let block = sorted.blocks[sorted.next];
            if block.bound <= sorted.best {
                if block.bound <= self.score_min(sorted.best) || sorted.runners_up_left == 0 {
                    return true;
                }
                sorted.runners_up_left -= 1;
            }
            sorted.next += 1;
            let cell = self.best_cell(block, &sorted.headings);
            sorted.best = sorted.best.max(cell.score);
            if cell.score > self.score_min(sorted.best) {
                sorted.cells.push(cell);
            }
        }
        sorted.next == sorted.blocks.len()
    }

    /// The best distinct cells of the blocks searched, best first.
    pub(super) fn best_cells(&self, sorted: SortedBlocks) -> Vec<PoseCell> {
        let score_min = self.score_min(sorted.best);
        self.suppress_neighbours(sorted.cells, score_min)
    }

    /// The best cells with scores above `score_min`, without those close to a better one.
    fn suppress_neighbours(&self, mut cells: Vec<PoseCell>, score_min: u16) -> Vec<PoseCell> {
        cells.sort_by_key(|cell| std::cmp::Reverse(cell.score));
        let mut distinct: Vec<PoseCell> = Vec::new();
        for cell in cells {
            if distinct.len() >= self.config.hypotheses_max || cell.score <= score_min {
                break;
            }
            if !distinct
                .iter()
                .any(|other| self.is_same_up_to_fold(other.pose, cell.pose))
            {
                distinct.push(cell);
            }
        }
        distinct
    }

    /// The best cell of a block.
    fn best_cell(&self, block: PoseBlock, headings: &HeadingRange) -> PoseCell {
        let sums = self.cell_scores(&block);
        let sums = sums.as_flattened();
        let mut best = 0;
        for (k, &sum) in sums.iter().enumerate() {
            if sum > sums[best] {
                best = k;
            }
        }
        PoseCell {
            score: sums[best],
            pose: self.cell_pose(&block, headings, best),
        }
    }

    /// The pose of a cell of a block; cells are counted row by row.
    pub(super) fn cell_pose(
        &self,
        block: &PoseBlock,
        headings: &HeadingRange,
        cell: usize,
    ) -> Pose {
        let column = usize::from(block.column) * BLOCK + cell % BLOCK;
        let row = usize::from(block.row) * BLOCK + cell / BLOCK;
        Pose::new(
            self.tables.x0 + column as f32 * self.config.cell,
            self.tables.y0 + row as f32 * self.config.cell,
            headings.heading(usize::from(block.heading)),
        )
    }

    /// The poses of a block's corner cells.
    pub(super) fn corner_poses(&self, block: &PoseBlock, headings: &HeadingRange) -> [Pose; 4] {
        let last = BLOCK - 1;
        [0, last, last * BLOCK, last * BLOCK + last]
            .map(|cell| self.cell_pose(block, headings, cell))
    }

    /// The scores of a block's cells, by row and column.
    pub(super) fn cell_scores(&self, block: &PoseBlock) -> [[u16; BLOCK]; BLOCK] {
        let points = self.search.selected_points.len();
        let start = usize::from(block.heading) * points;
        let offsets = &self.search.offsets[start..start + points];
        let tables = &self.tables;
        let stride = tables.score_stride;
        let at = usize::from(block.row) * BLOCK * stride + usize::from(block.column) * BLOCK;
        let mut sums = [[0_u16; BLOCK]; BLOCK];
        for batch in offsets.chunks(BATCH) {
            // The scores of a row of cells are the bytes of a u32. The sum of a batch does not overflow a byte.
            let mut bytes = [0_u32; BLOCK];
            for &(x, y) in batch {
                let start = at + y as usize * stride + x as usize;
                for (row, bytes) in bytes.iter_mut().enumerate() {
                    let scores = tables.scores.get(start + row * stride..);
                    if let Some(scores) = scores.and_then(|from| from.first_chunk()) {
                        *bytes = bytes.wrapping_add(u32::from_le_bytes(*scores));
                    }
                }
            }
            for (sums, bytes) in sums.iter_mut().zip(bytes) {
                for (sum, byte) in sums.iter_mut().zip(bytes.to_le_bytes()) {
                    *sum += u16::from(byte);
                }
            }
        }
        sums
    }
}

/// The highest bound of a row.
fn bound_max(bounds: &[u16]) -> u16 {
    let (chunks, _) = bounds.as_chunks::<LANES>();
    let of = |chunk: &[u16; LANES]| chunk.iter().copied().fold(0, u16::max);
    chunks.iter().map(of).fold(0, u16::max)
}
