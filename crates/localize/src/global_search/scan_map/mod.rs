//! The scan map (minho2016 IV): from which cell of the field do scan lines meet markings at the distances seen?
//!
//! For every cell of 0.1 m over field + 1 m the distances are stored at which its 72 radial lines (every 5°, up to
//! four each) and 72 spirals (36 each way, every 10°, one each) meet markings. A frame's distances are compared with
//! the cells', under a known heading, by the error of eq. 5; scan lines that saw nothing are ignored, and near points
//! weigh more. Where the paper compares all cells, here only blocks are opened whose bound says that they may hold
//! one of the best: the answer is the same.

mod bound;
mod cache;
mod compare;
mod errors;
mod grid;
mod pattern;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::frames::Pose;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;

use bound::ErrorBounds;
use errors::ErrorModel;
use grid::{CellWindow, Grid};
use pattern::{LAYERS, scan_field, scan_points};

pub use cache::CacheStatus;

/// Pattern and error of the scan map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScanMapConfig {
    /// Side of a cell, metres (minho2016 IV: 0.1).
    pub cell: f32,
    /// Cells beyond the boundary lines, metres (minho2016 IV: 1).
    pub margin: f32,
    /// Farthest distance looked at, metres ("the maximum robot visualization distance").
    pub range_max: f32,
    /// Nearest, metres: the robot's own radius ("MASK").
    pub range_min: f32,
    /// By how much a spiral turns from the nearest to the farthest distance, degrees.
    pub spiral_turn_deg: f32,
    /// c of eq. 5, metres.
    pub kernel_scale: f32,
    /// Distance at which a point's weight has fallen to half, metres.
    pub half_weight_range: f32,
    /// Half the side of the local search's square, metres (minho2016 VI: 4 m²).
    pub local_half: f32,
}

impl Default for ScanMapConfig {
    fn default() -> Self {
        ScanMapConfig {
            cell: 0.1,
            margin: 1.0,
            range_max: 6.0,
            range_min: 0.3,
            spiral_turn_deg: 120.0,
            kernel_scale: 0.25,
            half_weight_range: 4.0,
            local_half: 1.0,
        }
    }
}

/// Distances are stored in 180ths of the range; `NONE` stands for none, and is far from every distance seen.
const DISTANCE_STEPS: f32 = 180.0;
const NO_HIT: u8 = 255;

/// Side of a block in cells, and its cells.
const BLOCK: usize = 4;
const BLOCK_CELLS: usize = BLOCK * BLOCK;

/// Cells up to this part above the best error are kept, for the runners-up.
const KEPT_ERROR_RATIO: f32 = 1.25;

/// Distances of one field's markings from every cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanMap {
    config: ScanMapConfig,
    /// Distances by block, then by layer of the pattern, then by cell of the block.
    cells: Vec<u8>,
    bounds: ErrorBounds,
    errors: ErrorModel,
    grid: Grid,
}

impl ScanMap {
    /// Scans the field from every cell, blocks in parallel.
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

    /// With the distances of an earlier one; none if they are not as many as this field and pattern have.
    fn from_cells(field: &Field, config: ScanMapConfig, cells: Vec<u8>) -> Option<Self> {
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

    /// The cells with the least error under `heading`, best first, at most `most` and `apart` metres apart.
    pub fn find_poses(
        &self,
        points: &[LinePoint],
        heading: f32,
        most: usize,
        apart: f32,
    ) -> Vec<(f32, Pose)> {
        let seen = scan_points(points, heading, &self.config);
        if seen.is_empty() {
            return Vec::new();
        }
        let bounds = self.bounds.all_blocks(&seen);
        let cells = self.search_blocks(&seen, bounds, &self.grid.full_window(), KEPT_ERROR_RATIO);
        let mut found: Vec<(f32, Pose)> = Vec::new();
        for (sum, cell) in cells.into_sorted() {
            let pose = self.pose(cell, heading);
            let far = |other: &(f32, Pose)| other.1.origin().distance_to(pose.origin()) >= apart;
            if found.iter().all(far) {
                found.push((ErrorModel::relative(sum, seen.len()), pose));
            }
            if found.len() >= most {
                break;
            }
        }
        found
    }

    /// The same in a square about `centre` (minho2016 VI: 4 m²), the best cell alone.
    pub fn find_pose_near(&self, points: &[LinePoint], centre: Pose) -> Option<(f32, Pose)> {
        let seen = scan_points(points, centre.theta, &self.config);
        if seen.is_empty() {
            return None;
        }
        let half = (self.config.local_half / self.config.cell) as i32;
        let around = |at: f32, from: f32, count: usize| {
            let middle = ((at - from) / self.config.cell).round() as i32;
            [middle.saturating_sub(half), middle.saturating_add(half)]
                .map(|cell| cell.clamp(0, count as i32 - 1) as usize)
        };
        let window = CellWindow {
            columns: around(centre.x, self.grid.x0, self.grid.columns),
            rows: around(centre.y, self.grid.y0, self.grid.rows),
        };
        let blocks = |cells: [usize; 2]| cells.map(|cell| cell / BLOCK);
        let (columns, rows) = (blocks(window.columns), blocks(window.rows));
        let bounds = self.bounds.blocks_in(&seen, columns, rows);
        let cells = self.search_blocks(&seen, bounds, &window, 1.0);
        let &(sum, cell) = cells.into_sorted().first()?;
        Some((
            ErrorModel::relative(sum, seen.len()),
            self.pose(cell, centre.theta),
        ))
    }

    fn pose(&self, [column, row]: [usize; 2], heading: f32) -> Pose {
        Pose::new(
            self.grid.x0 + column as f32 * self.config.cell,
            self.grid.y0 + row as f32 * self.config.cell,
            heading,
        )
    }
}
