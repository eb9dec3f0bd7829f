//! The stored distances of every cell, with the bounds of their blocks.

use rayon::prelude::*;

use super::bound::ErrorBounds;
use super::config::{BLOCK_CELLS, NO_HIT, ScanMapConfig};
use super::errors::ErrorModel;
use super::grid::Grid;
use super::pattern::{LAYERS, scan_field};
use crate::field::Field;
use crate::matching::distance_field::DistanceField;

/// Distances of one field's markings from every cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanMap {
    pub(super) config: ScanMapConfig,
    /// Distances in steps, ordered by block, layer of the pattern, cell of the block.
    pub(super) cells: Vec<u8>,
    pub(super) bounds: ErrorBounds,
    pub(super) errors: ErrorModel,
    pub(super) grid: Grid,
}

impl ScanMap {
    /// Scans the field from every cell; blocks run in parallel on rayon's global pool.
    pub fn new(field: &Field, distances: &DistanceField, config: ScanMapConfig) -> Self {
        let grid = Grid::new(field, &config);
        let mut cells = vec![NO_HIT; grid.blocks() * LAYERS * BLOCK_CELLS];
        cells
            .par_chunks_exact_mut(LAYERS * BLOCK_CELLS)
            .enumerate()
            .for_each(|(block, stored)| {
                for cell in 0..BLOCK_CELLS {
                    let [column, row] = grid.cell(block, cell);
                    let x = grid.x0 + column as f32 * config.cell;
                    let y = grid.y0 + row as f32 * config.cell;
                    let scanned = scan_field(field, distances, [x, y], &config);
                    for (layer, steps) in scanned.into_iter().enumerate() {
                        stored[layer * BLOCK_CELLS + cell] = steps;
                    }
                }
            });
        ScanMap::assemble(cells, grid, config)
    }

    /// The map with given distances; None if their number does not fit this field and pattern.
    pub(super) fn from_cells(field: &Field, config: ScanMapConfig, cells: Vec<u8>) -> Option<Self> {
        let grid = Grid::new(field, &config);
        (cells.len() == grid.blocks() * LAYERS * BLOCK_CELLS)
            .then(|| ScanMap::assemble(cells, grid, config))
    }

    fn assemble(cells: Vec<u8>, grid: Grid, config: ScanMapConfig) -> Self {
        let errors = ErrorModel::new(&config);
        ScanMap {
            bounds: ErrorBounds::new(&cells, &grid, &errors),
            errors,
            cells,
            grid,
            config,
        }
    }

    /// Memory held, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.cells.len() + self.bounds.memory_bytes()
    }
}
