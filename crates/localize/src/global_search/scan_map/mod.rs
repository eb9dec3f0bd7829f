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
mod config;
mod errors;
mod grid;
mod map;
mod pattern;

use crate::frames::Pose;
use crate::sample::LinePoint;

pub use config::ScanMapConfig;
pub use map::ScanMap;

use compare::CellError;
use config::BLOCK;
use errors::ErrorModel;
use grid::CellWindow;
use pattern::scan_points;

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

impl ScanMap {
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
