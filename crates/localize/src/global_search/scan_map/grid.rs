//! Positions of the scan map's cells, and their grouping into blocks.

use super::config::{BLOCK, ScanMapConfig};
use crate::field::Field;

/// Layout of the cells.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Blocks along x and y; the last may extend beyond the cells.
    pub(super) block_columns: usize,
    pub(super) block_rows: usize,
    /// Centre of cell (0, 0), metres.
    pub(super) x0: f32,
    pub(super) y0: f32,
}

/// A rectangle of cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellWindow {
    pub(super) columns: [usize; 2],
    pub(super) rows: [usize; 2],
}

impl Grid {
    pub(super) fn new(field: &Field, config: &ScanMapConfig) -> Self {
        let cells = |half: f32| ((half + config.margin) / config.cell).round();
        let (half_x, half_y) = (cells(field.length / 2.0), cells(field.width / 2.0));
        let (columns, rows) = (2 * half_x as usize + 1, 2 * half_y as usize + 1);
        Grid {
            columns,
            rows,
            block_columns: columns.div_ceil(BLOCK),
            block_rows: rows.div_ceil(BLOCK),
            x0: -half_x * config.cell,
            y0: -half_y * config.cell,
        }
    }

    pub(super) fn blocks(&self) -> usize {
        self.block_columns * self.block_rows
    }

    /// Column and row of a cell of a block.
    pub(super) fn cell(&self, block: usize, cell: usize) -> [usize; 2] {
        let column = block % self.block_columns * BLOCK + cell % BLOCK;
        let row = block / self.block_columns * BLOCK + cell / BLOCK;
        [column, row]
    }

    /// All cells.
    pub(super) fn full_window(&self) -> CellWindow {
        CellWindow {
            columns: [0, self.columns - 1],
            rows: [0, self.rows - 1],
        }
    }
}

impl CellWindow {
    pub(super) fn contains(&self, [column, row]: [usize; 2]) -> bool {
        let within = |at: usize, [first, last]: [usize; 2]| first <= at && at <= last;
        within(column, self.columns) && within(row, self.rows)
    }
}
