//! Which cells err least? Blocks are compared in the order of their bounds, until no other can hold one of the best.

use super::grid::CellWindow;
use super::pattern::{LAYERS, ScanHit, layers};
use super::{BLOCK_CELLS, NO_HIT, ScanMap};

/// Distances between two looks at whether a block can still hold one of the best.
const CHECK_INTERVAL: usize = 16;

/// Cells with their errors: the least of them, and all that are not much worse.
pub(super) struct BestCells {
    error_min: u32,
    cells: Vec<(u32, [usize; 2])>,
    /// Cells are kept up to this part above the least.
    kept_ratio: f32,
}

impl BestCells {
    fn limit(&self) -> u32 {
        // From u32::MAX on the cast saturates.
        (self.error_min as f32 * self.kept_ratio) as u32
    }

    /// The best first, and of equal ones the first row's first.
    pub(super) fn into_sorted(mut self) -> Vec<(u32, [usize; 2])> {
        let limit = self.limit();
        self.cells.retain(|&(sum, _)| sum <= limit);
        self.cells
            .sort_unstable_by_key(|&(sum, [column, row])| (sum, row, column));
        self.cells
    }
}

impl ScanMap {
    /// Compares the cells of blocks with their bounds, those first that promise most, until no other can hold a cell
    /// of those kept.
    pub(super) fn search_blocks(
        &self,
        seen: &[ScanHit],
        mut bounds: Vec<(u32, usize)>,
        window: &CellWindow,
        kept: f32,
    ) -> BestCells {
        let mut found = BestCells {
            error_min: u32::MAX,
            cells: Vec::new(),
            kept_ratio: kept,
        };
        // The most promising block tells how few of the others are worth sorting.
        if let Some(&best) = bounds.iter().min() {
            self.search_block(&mut found, seen, best, window);
            let (_, block) = best;
            let limit = found.limit();
            bounds.retain(|&(bound, other)| bound <= limit && other != block);
        }
        bounds.sort_unstable();
        for (bound, block) in bounds {
            if bound > found.limit() {
                break;
            }
            self.search_block(&mut found, seen, (bound, block), window);
        }
        found
    }

    /// Compares a block's cells and keeps those that are not much worse than the best so far.
    fn search_block(
        &self,
        found: &mut BestCells,
        seen: &[ScanHit],
        (bound, block): (u32, usize),
        window: &CellWindow,
    ) {
        let limit = found.limit();
        let Some(sums) = self.block_errors(seen, (bound, block), limit) else {
            return;
        };
        for (cell, sum) in sums.into_iter().enumerate() {
            let at = self.grid.cell(block, cell);
            if sum <= limit && window.contains(at) {
                found.error_min = found.error_min.min(sum);
                found.cells.push((sum, at));
            }
        }
    }

    /// Errors of a block's cells over all distances seen, none once all of them must exceed the limit: what is left to
    /// compare adds to no cell less than its part of the block's bound. Of a radial line's up to four distances the
    /// nearest counts.
    fn block_errors(
        &self,
        seen: &[ScanHit],
        (bound, block): (u32, usize),
        limit: u32,
    ) -> Option<[u32; BLOCK_CELLS]> {
        let mut sums = [0; BLOCK_CELLS];
        let mut left = bound;
        let stored = &self.cells[block * LAYERS * BLOCK_CELLS..][..LAYERS * BLOCK_CELLS];
        let (layers_of_all, _) = stored.as_chunks::<BLOCK_CELLS>();
        for some in seen.chunks(CHECK_INTERVAL) {
            for one in some {
                let (first, slots) = layers(one.line);
                let mut least = [NO_HIT; BLOCK_CELLS];
                for layer in &layers_of_all[first..first + slots] {
                    for (least, &steps) in least.iter_mut().zip(layer) {
                        *least = (*least).min(steps.abs_diff(one.steps));
                    }
                }
                let weight = self.errors.weight(one.steps);
                for (sum, least) in sums.iter_mut().zip(least) {
                    *sum += self.errors.error(weight, least);
                }
            }
            left = left.saturating_sub(self.bounds.of_block(some, block));
            if sums.iter().all(|&sum| sum.saturating_add(left) > limit) {
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

    /// All cells of a window compared, as the paper does.
    fn exhaustive_minimum(
        map: &ScanMap,
        points: &[LinePoint],
        heading: f32,
        window: &CellWindow,
    ) -> f32 {
        let seen = scan_points(points, heading, &map.config);
        let least = (0..map.grid.blocks())
            .flat_map(|block| {
                let sums = map
                    .block_errors(&seen, (0, block), u32::MAX)
                    .expect("no limit");
                (0..BLOCK_CELLS).map(move |cell| (sums[cell], map.grid.cell(block, cell)))
            })
            .filter(|(_, at)| window.contains(*at))
            .map(|(sum, _)| sum)
            .min();
        ErrorModel::relative(least.expect("cells"), seen.len())
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
            assert_eq!(best.0, all);
            let centre = Pose::new(truth.x + 0.4, truth.y - 0.3, truth.theta);
            let (error, near) = map.find_pose_near(&points, centre).expect("points");
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
