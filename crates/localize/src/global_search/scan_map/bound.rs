//! Lower bounds of the errors of a block's cells, so that most of the field need not be compared.
//!
//! A table holds, for each scan line and bin of distance, the smallest error of any cell of a block. The bytes of all
//! blocks are adjacent, so that bounding the whole field takes one row sum per measured distance. No cell's error is
//! below its block's bound, so that the result equals that of an exhaustive comparison.

use rayon::prelude::*;

use super::config::{BLOCK_CELLS, DISTANCE_STEPS};
use super::errors::{ErrorModel, QUANTUM};
use super::grid::Grid;
use super::pattern::{LAYERS, SCAN_LINES, ScanHit, layers};

/// Steps of distance per bin: 0.1 m at a range of 6 m, about the side of a cell.
const BIN: usize = 3;
const BINS: usize = DISTANCE_STEPS as usize / BIN + 1;

/// Side of a tile in blocks: a tile's bounds fill one cache line, so that a local search touches few lines.
const TILE: usize = 8;
const TILE_BLOCKS: usize = TILE * TILE;

/// A block of cells and the lower bound of their errors; ordered by bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct BoundedBlock {
    pub(super) bound: u32,
    pub(super) block: usize,
}

/// Smallest errors of all blocks, in quanta, by scan line, bin of distance, tile, block of the tile.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ErrorBounds {
    lower_bounds: Vec<[u8; TILE_BLOCKS]>,
    /// Tiles along x and y; the last may extend beyond the blocks.
    tiles: [usize; 2],
    /// Blocks along x and y.
    blocks: [usize; 2],
}

impl ErrorBounds {
    /// From all cells' distances, ordered by block, layer and cell; scan lines run in parallel.
    pub(super) fn new(cells: &[u8], grid: &Grid, errors: &ErrorModel) -> Self {
        let blocks = [grid.block_columns, grid.block_rows];
        let mut bounds = ErrorBounds {
            lower_bounds: Vec::new(),
            tiles: blocks.map(|blocks| blocks.div_ceil(TILE)),
            blocks,
        };
        let tiles = bounds.tiles[0] * bounds.tiles[1];
        let mut least = vec![[0; TILE_BLOCKS]; SCAN_LINES * BINS * tiles];
        least
            .par_chunks_exact_mut(BINS * tiles)
            .enumerate()
            .for_each(|(line, table)| {
                let (layer, slots) = layers(line);
                for (block, cells) in cells.chunks_exact(LAYERS * BLOCK_CELLS).enumerate() {
                    let (tile, place) = bounds.tile_index(block);
                    let stored = &cells[layer * BLOCK_CELLS..(layer + slots) * BLOCK_CELLS];
                    for (bin, difference) in min_step_differences(stored).into_iter().enumerate() {
                        let error = errors.error(errors.weight((bin * BIN) as u8), difference);
                        table[bin * tiles + tile][place] = (error / QUANTUM) as u8;
                    }
                }
            });
        bounds.lower_bounds = least;
        bounds
    }

    /// Memory held, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        self.lower_bounds.len() * TILE_BLOCKS
    }

    /// All blocks with the lower bounds of their total errors.
    pub(super) fn all_blocks(&self, hits: &[ScanHit]) -> Vec<BoundedBlock> {
        self.blocks_in(hits, [0, self.blocks[0] - 1], [0, self.blocks[1] - 1])
    }

    /// The blocks of a rectangle (first and last along x and y) with their bounds.
    pub(super) fn blocks_in(
        &self,
        hits: &[ScanHit],
        [left, right]: [usize; 2],
        [top, bottom]: [usize; 2],
    ) -> Vec<BoundedBlock> {
        let (across, down) = (left / TILE..=right / TILE, top / TILE..=bottom / TILE);
        let width = across.clone().count();
        let mut sums = vec![[0_u16; TILE_BLOCKS]; width * down.clone().count()];
        for hit in hits {
            let row = self.row_offset(hit);
            for (sums, y) in sums.chunks_exact_mut(width).zip(down.clone()) {
                let first = row + y * self.tiles[0] + across.start();
                for (sums, least) in sums
                    .iter_mut()
                    .zip(&self.lower_bounds[first..first + width])
                {
                    for (sum, &least) in sums.iter_mut().zip(least) {
                        *sum += u16::from(least);
                    }
                }
            }
        }
        let mut bounds = Vec::with_capacity((right - left + 1) * (bottom - top + 1));
        for y in top..=bottom {
            for x in left..=right {
                let tile = (y / TILE - down.start()) * width + x / TILE - across.start();
                let sum = sums[tile][y % TILE * TILE + x % TILE];
                bounds.push(BoundedBlock {
                    bound: u32::from(sum) * QUANTUM,
                    block: y * self.blocks[0] + x,
                });
            }
        }
        bounds
    }

    /// The lower bound of a block's error over the given distances.
    pub(super) fn of_block(&self, hits: &[ScanHit], block: usize) -> u32 {
        let (tile, place) = self.tile_index(block);
        let least =
            |hit: &ScanHit| u32::from(self.lower_bounds[self.row_offset(hit) + tile][place]);
        hits.iter().map(least).sum::<u32>() * QUANTUM
    }

    /// A block's tile, and its index in the tile.
    fn tile_index(&self, block: usize) -> (usize, usize) {
        let (x, y) = (block % self.blocks[0], block / self.blocks[0]);
        let tile = y / TILE * self.tiles[0] + x / TILE;
        (tile, y % TILE * TILE + x % TILE)
    }

    /// Index of the first tile of a distance.
    fn row_offset(&self, hit: &ScanHit) -> usize {
        (hit.line * BINS + usize::from(hit.steps) / BIN) * self.tiles[0] * self.tiles[1]
    }
}

/// Smallest difference in steps between any distance of a bin and any stored distance.
fn min_step_differences(stored: &[u8]) -> [u8; BINS] {
    let first: [u8; BINS] = std::array::from_fn(|bin| (bin * BIN) as u8);
    let mut nearest = [u8::MAX; BINS];
    for &steps in stored {
        for (nearest, first) in nearest.iter_mut().zip(first) {
            let last = first + (BIN as u8 - 1);
            let off = first.saturating_sub(steps).max(steps.saturating_sub(last));
            *nearest = (*nearest).min(off);
        }
    }
    nearest
}
