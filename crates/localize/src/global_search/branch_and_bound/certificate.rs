//! What does a search prove about the poses that it does not return? Upper bounds of their scores.
//!
//! The bounds of the blocks are at hand after a search. Blocks are opened in the order of their bounds until the best cell
//! found elsewhere reaches the bound of the next block, or until the budget ends (docs/methods.md 6.9).

use super::best_first::PoseBlock;
use super::bound::{bounds_layer, bounds_width};
use super::certified_share::Certificate;
use super::tables::SCORE_MAX;
use super::{BranchAndBound, HeadingRange, Hypothesis};
use crate::frames::Pose;
use crate::matching::distance_field::DistanceField;

/// Below this share of the best cell's score no bound is lowered.
const TIGHT_SHARE: f32 = 0.5;

/// Largest scores of cells elsewhere.
#[derive(Debug, Clone, Copy, Default)]
struct BestElsewhere {
    /// Not at the first hypothesis.
    other: u16,
    /// At no hypothesis.
    unlisted: u16,
}

impl BranchAndBound {
    /// Bounds the scores of all poses that are not among the `hypotheses` of the search just made.
    pub(super) fn certify(
        &self,
        distances: &DistanceField,
        headings: &HeadingRange,
        hypotheses: &[Hypothesis],
    ) -> Option<Certificate> {
        let answer = hypotheses.first()?;
        let (blocks, dropped_bound) = self.most_promising_blocks(headings);
        let mut best = BestElsewhere::default();
        let mut remaining_bound = dropped_bound;
        for block in blocks {
            if block.bound <= best.unlisted {
                remaining_bound = best.unlisted;
                break;
            }
            if self.is_listed(&block, headings, hypotheses) {
                continue;
            }
            self.open_block(&block, headings, hypotheses, &mut best);
        }
        let full = SCORE_MAX * self.search.selected_points.len() as f32;
        Some(Certificate {
            points: self.search.selected_points.len(),
            answer_share: self.explained_share(distances, answer.pose),
            others_share_max: f32::from(best.other.max(remaining_bound)) / full,
            unlisted_share_max: f32::from(best.unlisted.max(remaining_bound)) / full,
            is_attained: best.other >= remaining_bound,
        })
    }

    /// The blocks with the largest bounds, in this order, at most `certificate_blocks`, and a bound of all others.
    fn most_promising_blocks(&self, headings: &HeadingRange) -> (Vec<PoseBlock>, u16) {
        let width = bounds_width(&self.tables);
        let layer = bounds_layer(&self.tables);
        let layers = || self.search.bounds[..headings.count * layer].chunks_exact(layer);
        let highest = layers().flatten().copied().fold(0, u16::max);
        let floor = (f32::from(highest) * TIGHT_SHARE) as u16;
        let budget = self.config.certificate_blocks;
        let mut blocks = Vec::new();
        for (heading, layer) in layers().enumerate() {
            let rows = layer.chunks_exact(width).take(self.tables.rows);
            for (row, bounds) in rows.enumerate() {
                if bounds.iter().copied().fold(0, u16::max) <= floor {
                    continue;
                }
                let promising = bounds
                    .iter()
                    .enumerate()
                    .filter(|(_, bound)| **bound > floor);
                blocks.extend(
                    promising.map(|(column, &bound)| PoseBlock::new(bound, heading, row, column)),
                );
            }
        }
        let mut dropped = floor;
        if blocks.len() > budget {
            blocks.select_nth_unstable_by_key(budget, PoseBlock::order);
            dropped = blocks.get(budget).map_or(floor, |block| block.bound);
            blocks.truncate(budget);
        }
        blocks.sort_unstable_by_key(PoseBlock::order);
        (blocks, dropped)
    }

    /// Are all cells of a block at one of the hypotheses? Only the corners need a test: the neighbourhood is convex.
    fn is_listed(
        &self,
        block: &PoseBlock,
        headings: &HeadingRange,
        hypotheses: &[Hypothesis],
    ) -> bool {
        hypotheses.first().is_some_and(|answer| {
            self.corner_poses(block, headings)
                .iter()
                .all(|&corner| self.is_same_up_to_fold(answer.pose, corner))
        })
    }

    /// Adds the cells of a block that lie elsewhere.
    fn open_block(
        &self,
        block: &PoseBlock,
        headings: &HeadingRange,
        hypotheses: &[Hypothesis],
        best: &mut BestElsewhere,
    ) {
        for (cell, &score) in self.cell_scores(block).as_flattened().iter().enumerate() {
            if score <= best.unlisted {
                continue;
            }
            let pose = self.cell_pose(block, headings, cell);
            let mut others = hypotheses.iter();
            let is_answer = others
                .next()
                .is_some_and(|answer| self.is_same_up_to_fold(answer.pose, pose));
            if is_answer {
                continue;
            }
            best.other = best.other.max(score);
            if !others.any(|other| self.is_same_up_to_fold(other.pose, pose)) {
                best.unlisted = best.unlisted.max(score);
            }
        }
    }

    /// Share of the points of the last search that a pose explains, without the grid's rounding.
    pub fn explained_share(&self, distances: &DistanceField, pose: Pose) -> f32 {
        let squared = self.config.kernel_scale * self.config.kernel_scale;
        let points = &self.search.selected_points;
        let sum: f32 = points
            .iter()
            .map(|point| {
                let at = pose * point.at;
                let distance = distances.nearest(at.x, at.y).signed_distance;
                squared / (squared + distance * distance)
            })
            .sum();
        sum / points.len().max(1) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::Field;
    use crate::field::tests::league_18x12;
    use crate::global_search::branch_and_bound::BranchAndBoundConfig;
    use crate::matching::distance_field::DistanceFieldConfig;
    use crate::matching::{MatchConfig, Matcher};
    use crate::synthetic::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
    use rand::SeedableRng;
    use rand::rngs::Xoshiro256PlusPlus;

    /// The largest score of any grid cell that is not at one of `listed`, by visiting every cell.
    fn exhaustive(search: &BranchAndBound, headings: &HeadingRange, listed: &[Hypothesis]) -> f32 {
        let mut best = 0;
        for heading in 0..headings.count {
            for row in 0..search.tables.rows {
                for column in 0..search.tables.columns {
                    let block = PoseBlock::new(0, heading, row, column);
                    for (cell, &score) in
                        search.cell_scores(&block).as_flattened().iter().enumerate()
                    {
                        let pose = search.cell_pose(&block, headings, cell);
                        let is_listed = listed
                            .iter()
                            .any(|other| search.is_same_up_to_fold(other.pose, pose));
                        if score > best && !is_listed {
                            best = score;
                        }
                    }
                }
            }
        }
        f32::from(best) / (SCORE_MAX * search.search.selected_points.len() as f32)
    }

    fn check(field: &Field, blocks: usize, seed: u64) -> (f32, f32, bool) {
        let distances = DistanceField::new(field, &DistanceFieldConfig::default());
        let config = BranchAndBoundConfig {
            certificate_blocks: blocks,
            ..BranchAndBoundConfig::default()
        };
        let mut search = BranchAndBound::new(field, &distances, config);
        let mut matcher = Matcher::new(MatchConfig::default());
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let truth = random_pose(field, &mut rng);
        let drive = SyntheticDriveConfig::default();
        let points = simulate_line_points(field, &drive, truth, &mut rng);
        let found = search.find_certified(&distances, &mut matcher, &points, None);
        let certificate = found.certificate.expect("a certificate");
        let headings = search.heading_range(None);
        let others = exhaustive(&search, &headings, &found.hypotheses[..1]);
        let unlisted = exhaustive(&search, &headings, &found.hypotheses);
        assert!(unlisted <= certificate.unlisted_share_max + 1e-6);
        assert!(certificate.unlisted_share_max <= certificate.others_share_max);
        (
            others,
            certificate.others_share_max,
            certificate.is_attained,
        )
    }

    #[test]
    fn no_cell_of_the_whole_grid_beats_the_certificate_whatever_the_budget() {
        let field = league_18x12("outer_edges");
        for (seed, blocks) in [(1, 0), (2, 50), (3, 1000), (4, 1_000_000)] {
            let (others, bound, is_attained) = check(&field, blocks, seed);
            assert!(
                others <= bound + 1e-6,
                "{others} beats {bound} with {blocks} blocks"
            );
            if is_attained {
                assert!(
                    (others - bound).abs() < 1e-6,
                    "{bound} is not attained: {others}"
                );
            }
        }
    }

    #[test]
    fn an_unlimited_budget_attains_the_bound() {
        let (_, _, is_attained) = check(&league_18x12("outer_edges"), 1_000_000, 5);
        assert!(is_attained);
    }

    #[test]
    fn without_points_there_is_no_certificate() {
        let field = league_18x12("outer_edges");
        let distances = DistanceField::new(&field, &DistanceFieldConfig::default());
        let mut search = BranchAndBound::new(&field, &distances, BranchAndBoundConfig::default());
        let mut matcher = Matcher::new(MatchConfig::default());
        let found = search.find_certified(&distances, &mut matcher, &[], None);
        assert!(found.hypotheses.is_empty() && found.certificate.is_none());
    }
}
