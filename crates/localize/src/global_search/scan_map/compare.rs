//! Which cells have the smallest errors? Blocks are compared in the order of their bounds until none can hold a better
//! cell.

use super::bound::BoundedBlock;
use super::config::{BLOCK_CELLS, NO_HIT};
use super::grid::CellWindow;
use super::map::ScanMap;
use super::pattern::{LAYERS, ScanHit, layers};

/// Distances compared between two checks of whether a block can still hold one of the best cells.
const CHECK_INTERVAL: usize = 16;

/// Column and row of a cell, with its summed error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CellError {
    pub(super) sum: u32,
    pub(super) cell: [usize; 2],
}

/// The smallest error, and the cells whose errors are not much larger.
pub(super) struct BestCells {
    error_min: u32,
    cells: Vec<CellError>,
    /// Cells are kept up to this multiple of the smallest error.
    kept_ratio: f32,
}

impl BestCells {
    fn limit(&self) -> u32 {
        // The cast saturates at u32::MAX.
        (self.error_min as f32 * self.kept_ratio) as u32
    }

    /// Best first; equal errors by row, then by column.
    pub(super) fn into_sorted(mut self) -> Vec<CellError> {
        let limit = self.limit();
        self.cells.retain(|cell| cell.sum <= limit);
        self.cells.sort_unstable_by_key(|cell| {
            let [column, row] = cell.cell;
            (cell.sum, row, column)
        });
        self.cells
    }
}

impl ScanMap {
    /// Compares the cells of blocks in the order of their bounds, until no other block can hold a cell to be kept.
    pub(super) fn search_blocks(
        &self,
        hits: &[ScanHit],
        mut bounds: Vec<BoundedBlock>,
        window: &CellWindow,
        kept_ratio: f32,
    ) -> BestCells {
        let mut best_cells = BestCells {
            error_min: u32::MAX,
            cells: Vec::new(),
            kept_ratio,
        };
        // The block with the smallest bound gives a limit that leaves few others to sort.
        if let Some(&first) = bounds.iter().min() {
            self.search_block(&mut best_cells, hits, first, window);
            let limit = best_cells.limit();
            bounds.retain(|other| other.bound <= limit && other.block != first.block);
        }
        bounds.sort_unstable();
        for bounded in bounds {
            if bounded.bound > best_cells.limit() {
                break;
            }
            self.search_block(&mut best_cells, hits, bounded, window);
        }
        best_cells
    }

    /// Compares a block's cells and keeps those that are not much worse than the best so far.
    fn search_block(
        &self,
        best_cells: &mut BestCells,
        hits: &[ScanHit],
        bounded: BoundedBlock,
        window: &CellWindow,
    ) {
        let limit = best_cells.limit();
        let Some(sums) = self.block_errors(hits, bounded, limit) else {
            return;
        };
        for (index, sum) in sums.into_iter().enumerate() {
            let cell = self.grid.cell(bounded.block, index);
            if sum <= limit && window.contains(cell) {
                best_cells.error_min = best_cells.error_min.min(sum);
                best_cells.cells.push(CellError { sum, cell });
            }
        }
    }

    /// Errors of a block's cells over all measured distances; None as soon as all cells must exceed the limit.
    ///
    /// The remaining distances add at least their share of the block's bound to each cell. Of the up to four distances
    /// of a radial line the one nearest to the measured distance counts.
    fn block_errors(
        &self,
        hits: &[ScanHit],
        BoundedBlock { bound, block }: BoundedBlock,
        limit: u32,
    ) -> Option<[u32; BLOCK_CELLS]> {
        let mut sums = [0; BLOCK_CELLS];
        let mut remaining_bound = bound;
        let stored = &self.cells[block * LAYERS * BLOCK_CELLS..][..LAYERS * BLOCK_CELLS];
        let (block_layers, _) = stored.as_chunks::<BLOCK_CELLS>();
        for chunk in hits.chunks(CHECK_INTERVAL) {
            for hit in chunk {
                let (first, slots) = layers(hit.line);
                let mut least = [NO_HIT; BLOCK_CELLS];
                for layer in &block_layers[first..first + slots] {
                    for (least, &steps) in least.iter_mut().zip(layer) {
                        *least = (*least).min(steps.abs_diff(hit.steps));
                    }
                }
                let weight = self.errors.weight(hit.steps);
                for (sum, least) in sums.iter_mut().zip(least) {
                    *sum += self.errors.error(weight, least);
                }
            }
            remaining_bound = remaining_bound.saturating_sub(self.bounds.of_block(chunk, block));
            if sums
                .iter()
                .all(|&sum| sum.saturating_add(remaining_bound) > limit)
            {
                return None;
            }
        }
        Some(sums)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;
    use crate::frames::Pose;
    use crate::global_search::scan_map::ScanMapConfig;
    use crate::global_search::scan_map::errors::ErrorModel;
    use crate::global_search::scan_map::pattern::scan_points;
    use crate::matching::distance_field::{DistanceField, DistanceFieldConfig};
    use crate::sample::LinePoint;
    use crate::synthetic::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    /// The smallest error of a window by comparing all cells, as the paper does.
    fn exhaustive_minimum(
        map: &ScanMap,
        points: &[LinePoint],
        heading: f32,
        window: &CellWindow,
    ) -> f32 {
        let hits = scan_points(points, heading, &map.config);
        let least = (0..map.grid.blocks())
            .flat_map(|block| {
                let sums = map
                    .block_errors(&hits, BoundedBlock { bound: 0, block }, u32::MAX)
                    .expect("no limit");
                (0..BLOCK_CELLS).map(move |cell| (sums[cell], map.grid.cell(block, cell)))
            })
            .filter(|(_, at)| window.contains(*at))
            .map(|(sum, _)| sum)
            .min();
        ErrorModel::relative(least.expect("cells"), hits.len())
    }

    #[test]
    fn bounded_search_equals_exhaustive_search() {
        let field = league_18x12("centres");
        let distances = DistanceField::new(&field, &DistanceFieldConfig::default());
        let config = ScanMapConfig {
            cell: 0.2,
            ..ScanMapConfig::default()
        };
        let map = ScanMap::new(&field, &distances, config);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for k in 0..8 {
            let truth = random_pose(&field, &mut rng);
            let drive = SyntheticDriveConfig {
                outlier_share: 0.1 * k as f32,
                ..SyntheticDriveConfig::default()
            };
            let points = simulate_line_points(&field, &drive, truth, &mut rng);
            let best = map.find_poses(&points, truth.theta, 6, 0.4)[0];
            let all = exhaustive_minimum(&map, &points, truth.theta, &map.grid.full_window());
            assert_eq!(best.error, all);
            let centre = Pose::new(truth.x + 0.4, truth.y - 0.3, truth.theta);
            let near = map.find_pose_near(&points, centre).expect("points");
            let (error, near) = (near.error, near.pose);
            assert!((near.x - centre.x).abs() < 1.11 && (near.y - centre.y).abs() < 1.11);
            let cell = |at: f32, from: f32| ((at - from) / map.config.cell).round() as usize;
            let (column, row) = (cell(centre.x, map.grid.x0), cell(centre.y, map.grid.y0));
            let square = CellWindow {
                columns: [column.saturating_sub(5), column + 5],
                rows: [row.saturating_sub(5), row + 5],
            };
            let local = exhaustive_minimum(&map, &points, truth.theta, &square);
            assert_eq!(error, local);
        }
    }
}
