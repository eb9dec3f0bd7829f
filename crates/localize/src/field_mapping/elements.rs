//! Where do the points of the whole drive lie? Means over small cells, with their direction and their spread over time.

use std::collections::BTreeMap;

use super::FieldMappingConfig;
use super::keyframes::Keyframe;
use super::point_map::CellSums;
use super::registration::map_points;
use crate::math;

/// Parts of the drive whose means are compared for the standard deviations.
pub(super) const BLOCKS: usize = 8;
/// Cells on each side that give a cell its direction.
const DIRECTION_CELLS: i32 = 2;
/// Least count around a cell, share of the typical one: fewer are outliers.
const TYPICAL_SHARE_MIN: f32 = 0.08;

/// The mean of the points of a small cell.
#[derive(Debug, Clone)]
pub(super) struct Element {
    pub(super) at: [f32; 2],
    /// Unit vector across the marking.
    pub(super) normal: [f32; 2],
    /// Sum of the points' weights.
    pub(super) weight: f32,
    /// Points and their sums by part of the drive.
    pub(super) blocks: [[f32; 3]; BLOCKS],
}

#[derive(Debug, Clone, Default)]
struct Cell {
    sums: CellSums,
    blocks: [[f32; 3]; BLOCKS],
}

/// Averages the points of all keyframes. Cells with few points around are left out.
pub(super) fn average(keyframes: &[Keyframe], config: &FieldMappingConfig) -> Vec<Element> {
    let mut cells: BTreeMap<(i32, i32), Cell> = BTreeMap::new();
    for (index, keyframe) in keyframes.iter().enumerate() {
        let block = index * BLOCKS / keyframes.len();
        for (at, weight) in map_points(keyframe) {
            let key = [at.x, at.y].map(|value| (value / config.element).floor() as i32);
            let cell = cells.entry((key[0], key[1])).or_default();
            cell.sums.add(at.x, at.y, weight);
            for (sum, value) in cell.blocks[block].iter_mut().zip([1.0, at.x, at.y]) {
                *sum += weight * value;
            }
        }
    }
    let around = |(column, row): (i32, i32), reach: i32| {
        let mut sums = CellSums::default();
        for dx in -reach..=reach {
            for (_, cell) in cells.range((column + dx, row - reach)..=(column + dx, row + reach)) {
                sums.merge(&cell.sums);
            }
        }
        sums
    };
    let counts: Vec<f32> = cells.keys().map(|&key| around(key, 1).count).collect();
    let least = TYPICAL_SHARE_MIN * typical_count(&counts);
    let kept = cells
        .iter()
        .zip(&counts)
        .filter(|(_, count)| **count >= least);
    kept.map(|((&key, cell), _)| {
        let (_, [xx, xy, yy]) = around(key, DIRECTION_CELLS).moments();
        let (sin, cos) = math::sin_cos(0.5 * math::atan2(2.0 * xy, xx - yy));
        Element {
            at: cell.sums.moments().0,
            normal: [-sin, cos],
            weight: cell.sums.count,
            blocks: cell.blocks,
        }
    })
    .collect()
}

/// Entropy of the points over small cells: the wrong copies of a line beside the true one spread them over more cells.
pub(super) fn entropy(keyframes: &[Keyframe], config: &FieldMappingConfig) -> f32 {
    let mut cells: BTreeMap<(i32, i32), f32> = BTreeMap::new();
    for (at, weight) in keyframes.iter().flat_map(map_points) {
        let key = [at.x, at.y].map(|value| (value / config.element).floor() as i32);
        *cells.entry((key[0], key[1])).or_default() += weight;
    }
    let total: f32 = cells.values().sum();
    let shares = cells.values().map(|weight| weight / total);
    shares.map(|share| -share * math::ln(share)).sum()
}

/// Half of all points lie in places with at least this count.
fn typical_count(counts: &[f32]) -> f32 {
    let mut sorted = counts.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let half = 0.5 * sorted.iter().sum::<f32>();
    let mut sum = 0.0;
    for count in sorted {
        sum += count;
        if sum >= half {
            return count;
        }
    }
    0.0
}
