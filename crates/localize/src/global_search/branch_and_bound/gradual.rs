//! The same search, a part per call: for a check of the whole field that no single image pays for.

use super::best_first::SortedBlocks;
use super::{BranchAndBound, HeadingPrior, HeadingRange, Hypothesis, SearchBuffers};
use crate::frames::Pose;
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;

/// Headings whose bounds are computed in one call.
const HEADINGS_PER_PART: usize = 5;
/// Blocks searched in one call.
const BLOCKS_PER_PART: usize = 60;

/// A search in progress.
#[derive(Debug, Clone)]
pub struct GradualSearch {
    points: Vec<LinePoint>,
    headings: HeadingRange,
    buffers: SearchBuffers,
    stage: Stage,
}

/// What the next part does.
#[derive(Debug, Clone)]
enum Stage {
    /// Computes bounds from this heading on.
    Bounds(usize),
    Sort,
    Blocks(SortedBlocks),
    /// Refines these cells, one by one. Those done are kept.
    Refine(Vec<Pose>, Vec<Hypothesis>),
}

impl BranchAndBound {
    /// Starts a search for the poses that explain `points` (finite; robot frame) best.
    pub fn start_gradually(
        &mut self,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> GradualSearch {
        let mut search = GradualSearch {
            points: points.to_vec(),
            headings: HeadingRange::default(),
            buffers: SearchBuffers::default(),
            stage: Stage::Bounds(0),
        };
        std::mem::swap(&mut self.search, &mut search.buffers);
        self.select_points(points);
        self.search.fold_half_turn = prior.is_none() && self.half_turn_symmetric;
        search.headings = self.heading_range(prior);
        self.start_bounds(&search.headings);
        std::mem::swap(&mut self.search, &mut search.buffers);
        search
    }

    /// Does a part of the search. Returns the distinct poses found when it is complete, in no particular order.
    pub fn continue_gradually(
        &mut self,
        search: &mut GradualSearch,
        distances: &DistanceField,
        matcher: &mut Matcher,
    ) -> Option<Vec<Hypothesis>> {
        std::mem::swap(&mut self.search, &mut search.buffers);
        let stage = std::mem::replace(&mut search.stage, Stage::Sort);
        let mut found = None;
        search.stage = match stage {
            Stage::Bounds(first) => {
                let end = (first + HEADINGS_PER_PART).min(search.headings.count);
                self.compute_bounds(&search.headings, first..end);
                if end < search.headings.count {
                    Stage::Bounds(end)
                } else {
                    Stage::Sort
                }
            }
            Stage::Sort => Stage::Blocks(self.sort_blocks(search.headings)),
            Stage::Blocks(mut blocks) => {
                if self.search_blocks(&mut blocks, BLOCKS_PER_PART) {
                    let cells = self.best_cells(blocks);
                    Stage::Refine(cells.iter().map(|cell| cell.pose).collect(), Vec::new())
                } else {
                    Stage::Blocks(blocks)
                }
            }
            Stage::Refine(mut starts, mut hypotheses) => {
                if let Some(start) = starts.pop() {
                    let error = self.config.kernel_scale;
                    let matched = matcher.refine(distances, &search.points, start, error);
                    let is_new = !hypotheses.iter().any(|other: &Hypothesis| {
                        self.is_same_up_to_fold(other.pose, matched.pose)
                    });
                    if is_new {
                        hypotheses.push(Hypothesis::from_match(&matched));
                    }
                }
                if starts.is_empty() {
                    found = Some(std::mem::take(&mut hypotheses));
                }
                Stage::Refine(starts, hypotheses)
            }
        };
        std::mem::swap(&mut self.search, &mut search.buffers);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;
    use crate::global_search::branch_and_bound::BranchAndBoundConfig;
    use crate::matching::MatchConfig;
    use crate::matching::distance_field::DistanceFieldConfig;
    use crate::synthetic::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
    use rand::SeedableRng;
    use rand::rngs::Xoshiro256PlusPlus;

    #[test]
    fn a_gradual_search_finds_the_pose_of_the_search_at_once() {
        let field = league_18x12("outer_edges");
        let distances = DistanceField::new(&field, &DistanceFieldConfig::default());
        let mut search = BranchAndBound::new(&field, &distances, BranchAndBoundConfig::default());
        let mut matcher = Matcher::new(MatchConfig::default());
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
        for _ in 0..5 {
            let truth = random_pose(&field, &mut rng);
            let drive = SyntheticDriveConfig::default();
            let points = simulate_line_points(&field, &drive, truth, &mut rng);
            let mut gradual = search.start_gradually(&points, None);
            let at_once = search.find_hypotheses(&distances, &mut matcher, &points, None);
            let found = (0..200)
                .find_map(|_| search.continue_gradually(&mut gradual, &distances, &mut matcher))
                .expect("a complete search");
            let best = found.iter().max_by(|a, b| a.score.total_cmp(&b.score));
            let best = best.expect("a hypothesis").pose;
            let is_same = |pose: Pose| search.is_same_hypothesis(best, pose);
            assert!(is_same(at_once[0].pose) || is_same(at_once[1].pose));
        }
    }
}
