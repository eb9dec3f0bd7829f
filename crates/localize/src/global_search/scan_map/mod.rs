//! The scan map (minho2016 IV): from which cell of the field do scan lines cross markings at the measured distances?
//!
//! Each cell of 0.1 m, up to 1 m outside the field, stores the distances at which its scan lines cross markings. There
//! are 72 radial lines (every 5°, up to four distances each) and 72 spirals (36 per direction, every 10°, one each).
//! An image's distances are compared with those of the cells under a known heading, by the error of eq. 5. Scan lines
//! without a measurement are ignored, and near points have larger weights. The paper compares all cells. Here a block
//! of cells is searched only if its bound allows one of the best cells: the result is the same (docs/methods.md 6.4).

mod bound;
mod bytes;
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
use compare::CellError;
use errors::ErrorModel;
use grid::{CellWindow, Grid};
use pattern::{LAYERS, scan_field, scan_points};

/// Settings of the scan map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScanMapConfig {
    /// Side of a cell, metres (minho2016 IV: 0.1). A smaller cell is more accurate and costs more memory.
    pub cell: f32,
    /// Extent of the cells beyond the boundary lines, metres (minho2016 IV: 1).
    pub margin: f32,
    /// Largest distance used, metres ("the maximum robot visualization distance").
    pub range_max: f32,
    /// Smallest distance used, metres: the robot's own radius ("MASK").
    pub range_min: f32,
    /// Rotation of a spiral from the smallest to the largest distance, degrees.
    pub spiral_turn_deg: f32,
    /// Kernel scale c of eq. 5, metres.
    pub kernel_scale: f32,
    /// Distance at which the weight of a point is one half, metres.
    pub half_weight_range: f32,
    /// Half the side of the square of the local search, metres (minho2016 VI: 4 m²).
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

/// Distances are stored in steps of 1/180 of the range. `NO_HIT` means none and differs much from every step.
const DISTANCE_STEPS: f32 = 180.0;
const NO_HIT: u8 = 255;

/// Side of a block in cells, and the number of its cells.
const BLOCK: usize = 4;
const BLOCK_CELLS: usize = BLOCK * BLOCK;

/// Cells with up to this multiple of the best error are kept, as runners-up.
const KEPT_ERROR_RATIO: f32 = 1.25;

/// A cell of the scan map and how well it explains an image's distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellMatch {
    /// Centre of the cell, under the heading of the search.
    pub pose: Pose,
    /// Error as a share of the largest possible: 0 is a perfect match, 1 the worst.
    pub error: f32,
}

/// Distances of one field's markings from every cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanMap {
    config: ScanMapConfig,
    /// Distances in steps, ordered by block, layer of the pattern, cell of the block.
    cells: Vec<u8>,
    bounds: ErrorBounds,
    errors: ErrorModel,
    grid: Grid,
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

    /// The cells with the smallest errors under `heading` (radians), best first: at most `count_max`, and at least
    /// `separation_min` metres apart.
    pub fn find_poses(
        &self,
        points: &[LinePoint],
        heading: f32,
        count_max: usize,
        separation_min: f32,
    ) -> Vec<CellMatch> {
        let hits = scan_points(points, heading, &self.config);
        if hits.is_empty() {
            return Vec::new();
        }
        let bounds = self.bounds.all_blocks(&hits);
        let cells = self.search_blocks(&hits, bounds, &self.grid.full_window(), KEPT_ERROR_RATIO);
        let mut matches: Vec<CellMatch> = Vec::new();
        for CellError { sum, cell } in cells.into_sorted() {
            let pose = self.pose(cell, heading);
            let is_far = |other: &CellMatch| {
                other.pose.origin().distance_to(pose.origin()) >= separation_min
            };
            if matches.iter().all(is_far) {
                let error = ErrorModel::relative(sum, hits.len());
                matches.push(CellMatch { pose, error });
            }
            if matches.len() >= count_max {
                break;
            }
        }
        matches
    }

    /// The best cell of a square around `centre` (minho2016 VI: 4 m²), under its heading; None without points.
    pub fn find_pose_near(&self, points: &[LinePoint], centre: Pose) -> Option<CellMatch> {
        let hits = scan_points(points, centre.theta, &self.config);
        if hits.is_empty() {
            return None;
        }
        let half = (self.config.local_half / self.config.cell) as i32;
        let cell_range = |position: f32, origin: f32, count: usize| {
            let middle = ((position - origin) / self.config.cell).round() as i32;
            [middle.saturating_sub(half), middle.saturating_add(half)]
                .map(|cell| cell.clamp(0, count as i32 - 1) as usize)
        };
        let window = CellWindow {
            columns: cell_range(centre.x, self.grid.x0, self.grid.columns),
            rows: cell_range(centre.y, self.grid.y0, self.grid.rows),
        };
        let blocks = |cells: [usize; 2]| cells.map(|cell| cell / BLOCK);
        let (columns, rows) = (blocks(window.columns), blocks(window.rows));
        let bounds = self.bounds.blocks_in(&hits, columns, rows);
        let cells = self.search_blocks(&hits, bounds, &window, 1.0);
        let &CellError { sum, cell } = cells.into_sorted().first()?;
        Some(CellMatch {
            pose: self.pose(cell, centre.theta),
            error: ErrorModel::relative(sum, hits.len()),
        })
    }

    fn pose(&self, [column, row]: [usize; 2], heading: f32) -> Pose {
        Pose::new(
            self.grid.x0 + column as f32 * self.config.cell,
            self.grid.y0 + row as f32 * self.config.cell,
            heading,
        )
    }
}
