//! Line points of many keyframes in one frame, as pieces of line in cells: a normal distributions transform.

use std::collections::HashMap;

use crate::frames::{At, FieldFrame};

/// Sums over the points of a cell, relative to the cell's corner.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct CellSums {
    pub(super) count: f32,
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) xx: f32,
    pub(super) xy: f32,
    pub(super) yy: f32,
}

/// A straight piece of marking in a cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinePiece {
    pub(super) mean: At<FieldFrame>,
    /// Unit vector across it.
    pub(super) normal: [f32; 2],
    /// Variance of the points across it, m².
    pub(super) across: f32,
}

/// Points by cell.
#[derive(Debug, Clone)]
pub(super) struct PointMap {
    cell: f32,
    cells: HashMap<(i32, i32), CellSums>,
}

/// Weight of the points that make a piece of line.
const COUNT_MIN: f32 = 3.0;
/// Least ratio of the variances along and across.
const ELONGATION_MIN: f32 = 3.0;

impl CellSums {
    pub(super) fn add(&mut self, x: f32, y: f32, weight: f32) {
        self.count += weight;
        self.x += weight * x;
        self.y += weight * y;
        self.xx += weight * x * x;
        self.xy += weight * x * y;
        self.yy += weight * y * y;
    }

    pub(super) fn merge(&mut self, other: &CellSums) {
        self.count += other.count;
        self.x += other.x;
        self.y += other.y;
        self.xx += other.xx;
        self.xy += other.xy;
        self.yy += other.yy;
    }

    fn less(&self, other: &CellSums) -> CellSums {
        CellSums {
            count: self.count - other.count,
            x: self.x - other.x,
            y: self.y - other.y,
            xx: self.xx - other.xx,
            xy: self.xy - other.xy,
            yy: self.yy - other.yy,
        }
    }

    /// Mean, and the covariance xx, xy, yy.
    pub(super) fn moments(&self) -> ([f32; 2], [f32; 3]) {
        let (x, y) = (self.x / self.count, self.y / self.count);
        let covariance = [
            (self.xx / self.count - x * x).max(0.0),
            self.xy / self.count - x * y,
            (self.yy / self.count - y * y).max(0.0),
        ];
        ([x, y], covariance)
    }
}

impl PointMap {
    pub(super) fn new(cell: f32) -> Self {
        PointMap {
            cell,
            cells: HashMap::new(),
        }
    }

    /// Adds points with weights.
    pub(super) fn add(&mut self, points: impl Iterator<Item = (At<FieldFrame>, f32)>) {
        self.add_weighted(points);
    }

    /// Removes points that were added before.
    pub(super) fn remove(&mut self, points: impl Iterator<Item = (At<FieldFrame>, f32)>) {
        self.add_weighted(points.map(|(at, weight)| (at, -weight)));
    }

    fn add_weighted(&mut self, points: impl Iterator<Item = (At<FieldFrame>, f32)>) {
        for (point, weight) in points {
            let key = self.key(point);
            let (x, y) = self.within(point, key);
            self.cells.entry(key).or_default().add(x, y, weight);
        }
    }

    fn key(&self, at: At<FieldFrame>) -> (i32, i32) {
        (
            (at.x / self.cell).floor() as i32,
            (at.y / self.cell).floor() as i32,
        )
    }

    fn within(&self, at: At<FieldFrame>, key: (i32, i32)) -> (f32, f32) {
        (
            at.x - key.0 as f32 * self.cell,
            at.y - key.1 as f32 * self.cell,
        )
    }

    /// The piece of line nearest to a point, not counting the points of `without`, and whether those alone know the place.
    pub(super) fn nearest(
        &self,
        at: At<FieldFrame>,
        reach: f32,
        without: Option<&PointMap>,
    ) -> Option<(LinePiece, bool)> {
        let (column, row) = self.key(at);
        let mut best: Option<(f32, LinePiece, bool)> = None;
        for dx in -1..=1 {
            for dy in -1..=1 {
                let key = (column + dx, row + dy);
                let Some(all) = self.cells.get(&key) else {
                    continue;
                };
                let others = without
                    .and_then(|without| without.cells.get(&key))
                    .map_or(*all, |own| all.less(own));
                // Places that only the neighbouring keyframes know hold them together.
                let is_own = others.count < COUNT_MIN;
                let sums = if is_own { all } else { &others };
                let Some(piece) = self.piece(key, sums) else {
                    continue;
                };
                let (x, y) = (at.x - piece.mean.x, at.y - piece.mean.y);
                let across = (x * piece.normal[0] + y * piece.normal[1]).abs();
                let along = (x * piece.normal[1] - y * piece.normal[0]).abs();
                if across > reach || along > self.cell {
                    continue;
                }
                let distance = across + 0.3 * along;
                if best.is_none_or(|(least, ..)| distance < least) {
                    best = Some((distance, piece, is_own));
                }
            }
        }
        best.map(|(_, piece, is_own)| (piece, is_own))
    }

    fn piece(&self, key: (i32, i32), sums: &CellSums) -> Option<LinePiece> {
        if sums.count < COUNT_MIN {
            return None;
        }
        let ([x, y], [xx, xy, yy]) = sums.moments();
        let half = 0.5 * (xx + yy);
        let root = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let (along, across) = (half + root, (half - root).max(1e-5));
        if along < ELONGATION_MIN * across {
            return None;
        }
        let angle = 0.5 * crate::math::atan2(2.0 * xy, xx - yy);
        let (sin, cos) = crate::math::sin_cos(angle);
        Some(LinePiece {
            mean: At::new(key.0 as f32 * self.cell + x, key.1 as f32 * self.cell + y),
            normal: [-sin, cos],
            across,
        })
    }
}
