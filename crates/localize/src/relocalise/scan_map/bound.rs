//! How little can a block of cells err? Bounds from below, so that most of the field need not be compared.
//!
//! For each scan line and seen distance the least error that any cell of a block has there, in bytes that lie side by
//! side for all blocks: the bounds of the whole field are as many sums of rows as a frame has distances. No cell errs
//! less than its block's bound, so that what is found is what a comparison of all cells finds.

use rayon::prelude::*;

use super::errors::{Errors, QUANTUM};
use super::pattern::{LAYERS, LINES, Seen, layers};
use super::{BLOCK_CELLS, STEPS};

/// Steps of distance that share a bound: 0.1 m at 6 m range, as coarse as a cell.
const BIN: usize = 3;
const BINS: usize = STEPS as usize / BIN + 1;

/// Blocks whose bounds are added at once: eight sums fill a vector register.
const GROUP: usize = 8;

/// Least errors of all blocks, in quanta, by scan line, bin of distance, block; a group beyond the last, so that whole
/// groups can be read anywhere.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bounds {
    least: Vec<u8>,
    blocks: usize,
}

impl Bounds {
    /// From all cells' distances, by block, layer and cell; scan lines in parallel.
    pub(super) fn new(cells: &[u8], errors: &Errors) -> Self {
        let blocks = cells.len() / (LAYERS * BLOCK_CELLS);
        let mut least = vec![0; LINES * BINS * blocks + GROUP];
        least[..LINES * BINS * blocks]
            .par_chunks_exact_mut(BINS * blocks)
            .enumerate()
            .for_each(|(line, table)| {
                let (layer, slots) = layers(line);
                for (block, cells) in cells.chunks_exact(LAYERS * BLOCK_CELLS).enumerate() {
                    let stored = &cells[layer * BLOCK_CELLS..(layer + slots) * BLOCK_CELLS];
                    for (bin, difference) in nearest(stored).into_iter().enumerate() {
                        let error = errors.of((bin * BIN) as u8)[usize::from(difference)];
                        table[bin * blocks + block] = (u32::from(error) / QUANTUM) as u8;
                    }
                }
            });
        Bounds { least, blocks }
    }

    /// Memory held, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.least.len()
    }

    /// The least that any cell of each block can err in all.
    pub(super) fn of_all(&self, seen: &[Seen]) -> Vec<u32> {
        let mut sums = vec![0_u16; self.blocks];
        for one in seen {
            for (sum, &least) in sums.iter_mut().zip(self.row(one)) {
                *sum += u16::from(least);
            }
        }
        sums.iter().map(|&sum| u32::from(sum) * QUANTUM).collect()
    }

    /// The same for `count` blocks from each of `firsts` on.
    pub(super) fn of_some(&self, seen: &[Seen], firsts: &[usize], count: usize) -> Vec<u32> {
        let groups = count.div_ceil(GROUP);
        let mut sums = vec![[0_u16; GROUP]; firsts.len() * groups];
        for one in seen {
            let row = (one.line * BINS + usize::from(one.steps) / BIN) * self.blocks;
            for (sums, &first) in sums.chunks_exact_mut(groups).zip(firsts) {
                let (least, _) = self.least[row + first..][..groups * GROUP].as_chunks();
                for (sums, least) in sums.iter_mut().zip(least) {
                    let least: &[u8; GROUP] = least;
                    for (sum, &least) in sums.iter_mut().zip(least) {
                        *sum += u16::from(least);
                    }
                }
            }
        }
        let rows = sums.chunks_exact(groups);
        rows.flat_map(|row| row.as_flattened()[..count].iter())
            .map(|&sum| u32::from(sum) * QUANTUM)
            .collect()
    }

    fn row(&self, seen: &Seen) -> &[u8] {
        let row = seen.line * BINS + usize::from(seen.steps) / BIN;
        &self.least[row * self.blocks..(row + 1) * self.blocks]
    }
}

/// Least difference in steps between any distance of a bin and any of those stored.
fn nearest(stored: &[u8]) -> [u8; BINS] {
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
