//! How little can a block of cells err? Bounds from below, so that most of the field need not be compared.
//!
//! For each scan line and seen distance the least error that any cell of a block has there, in bytes that lie side by
//! side for all blocks: the bounds of the whole field are as many sums of rows as a frame has distances. No cell errs
//! less than its block's bound, so that what is found is what a comparison of all cells finds.

use rayon::prelude::*;

use super::errors::{ErrorModel, QUANTUM};
use super::grid::Grid;
use super::pattern::{LAYERS, SCAN_LINES, ScanHit, layers};
use super::{BLOCK_CELLS, DISTANCE_STEPS};

/// Steps of distance that share a bound: 0.1 m at 6 m range, as coarse as a cell.
const BIN: usize = 3;
const BINS: usize = DISTANCE_STEPS as usize / BIN + 1;

/// Side of a tile in blocks: a tile's bounds fill a cache line, so that those near a place are fetched with few.
const TILE: usize = 8;
const TILE_BLOCKS: usize = TILE * TILE;

/// Least errors of all blocks, in quanta, by scan line, bin of distance, tile, block of the tile.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ErrorBounds {
    lower_bounds: Vec<[u8; TILE_BLOCKS]>,
    /// Tiles along x and y; the last may reach beyond the blocks.
    tiles: [usize; 2],
    /// Blocks along x and y.
    blocks: [usize; 2],
}

impl ErrorBounds {
    /// From all cells' distances, by block, layer and cell; scan lines in parallel.
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

    /// The least that any cell of each block can err in all, with the block.
    pub(super) fn all_blocks(&self, seen: &[ScanHit]) -> Vec<(u32, usize)> {
        self.blocks_in(seen, [0, self.blocks[0] - 1], [0, self.blocks[1] - 1])
    }

    /// The same for the blocks of a rectangle: first and last along x and y.
    pub(super) fn blocks_in(
        &self,
        seen: &[ScanHit],
        [left, right]: [usize; 2],
        [top, bottom]: [usize; 2],
    ) -> Vec<(u32, usize)> {
        let (across, down) = (left / TILE..=right / TILE, top / TILE..=bottom / TILE);
        let width = across.clone().count();
        let mut sums = vec![[0_u16; TILE_BLOCKS]; width * down.clone().count()];
        for one in seen {
            let row = self.row_offset(one);
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
                bounds.push((u32::from(sum) * QUANTUM, y * self.blocks[0] + x));
            }
        }
        bounds
    }

    /// The least that any cell of one block can err in these distances.
    pub(super) fn of_block(&self, seen: &[ScanHit], block: usize) -> u32 {
        let (tile, place) = self.tile_index(block);
        let least =
            |one: &ScanHit| u32::from(self.lower_bounds[self.row_offset(one) + tile][place]);
        seen.iter().map(least).sum::<u32>() * QUANTUM
    }

    /// A block's tile, and its place there.
    fn tile_index(&self, block: usize) -> (usize, usize) {
        let (x, y) = (block % self.blocks[0], block / self.blocks[0]);
        let tile = y / TILE * self.tiles[0] + x / TILE;
        (tile, y % TILE * TILE + x % TILE)
    }

    /// Where the tiles of a distance begin.
    fn row_offset(&self, seen: &ScanHit) -> usize {
        (seen.line * BINS + usize::from(seen.steps) / BIN) * self.tiles[0] * self.tiles[1]
    }
}

/// Least difference in steps between any distance of a bin and any of those stored.
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
