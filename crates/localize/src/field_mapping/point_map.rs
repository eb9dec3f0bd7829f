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

/// A piece of line, and whose points it holds.
#[derive(Debug, Clone, Copy)]
pub(super) struct KnownPiece {
    pub(super) piece: LinePiece,
    pub(super) known_from: KnownFrom,
}

/// Which keyframes saw a place?
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum KnownFrom {
    /// Those of another visit: they close a loop.
    OtherVisit,
    /// Those of the same visit, but not the neighbours.
    SameVisit,
    /// The neighbours alone.
    Neighbours,
}

/// Points by cell and keyframe.
#[derive(Debug, Clone)]
pub(super) struct PointMap {
    cell: f32,
    /// In the order of keyframes.
    cells: HashMap<(i32, i32), Vec<(usize, CellSums)>>,
}

/// The pieces that one keyframe's points may lie on, each cell looked up once.
#[derive(Debug)]
pub(super) struct PieceLookup<'a> {
    map: &'a PointMap,
    keyframe: usize,
    pieces: HashMap<(i32, i32), Vec<KnownPiece>>,
}

/// Keyframes on each side that are neighbours. A place that was not seen for longer is visited again when it is seen.
pub(super) const NEIGHBOURS: usize = 12;
/// Least cosine between the normals of a piece of the own visit and of the same line's piece in another one.
const PARALLEL_MIN: f32 = 0.85;
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

    /// Adds a keyframe's points with weights. Keyframes come in order.
    pub(super) fn add(
        &mut self,
        keyframe: usize,
        points: impl Iterator<Item = (At<FieldFrame>, f32)>,
    ) {
        for (point, weight) in points {
            let key = self.key(point);
            let (x, y) = self.within(point, key);
            let cell = self.cells.entry(key).or_default();
            if cell.last().is_none_or(|(last, _)| *last != keyframe) {
                cell.push((keyframe, CellSums::default()));
            }
            if let Some((_, sums)) = cell.last_mut() {
                sums.add(x, y, weight);
            }
        }
    }

    /// The pieces as a keyframe's points are compared with them.
    pub(super) fn lookup(&self, keyframe: usize) -> PieceLookup<'_> {
        PieceLookup {
            map: self,
            keyframe,
            pieces: HashMap::new(),
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

    /// The pieces of a cell for a keyframe. Visits that disagree are apart: their common mean would be no line.
    fn pieces(&self, key: (i32, i32), keyframe: usize) -> Vec<KnownPiece> {
        let Some(cell) = self.cells.get(&key) else {
            return Vec::new();
        };
        let [mut all, mut far, mut others] = [CellSums::default(); 3];
        let mut visits = Vec::new();
        for visit in cell.chunk_by(|a, b| b.0 - a.0 <= NEIGHBOURS) {
            let is_near = |(index, _): &&(usize, CellSums)| index.abs_diff(keyframe) <= NEIGHBOURS;
            let mut sums = CellSums::default();
            for (_, part) in visit {
                sums.merge(part);
            }
            all.merge(&sums);
            if visit.iter().any(|part| is_near(&part)) {
                for (_, part) in visit.iter().filter(|part| !is_near(part)) {
                    far.merge(part);
                }
            } else {
                others.merge(&sums);
                visits.push(sums);
            }
        }
        let known = |sums: &CellSums, known_from| {
            let piece = self.piece(key, sums)?;
            Some(KnownPiece { piece, known_from })
        };
        if others.count >= COUNT_MIN {
            let mut agreed = others;
            agreed.merge(&far);
            let agreed = [agreed, others];
            let agreed = agreed
                .iter()
                .find_map(|sums| known(sums, KnownFrom::OtherVisit));
            return match agreed {
                Some(piece) => vec![piece],
                None => visits
                    .iter()
                    .filter_map(|sums| known(sums, KnownFrom::OtherVisit))
                    .collect(),
            };
        }
        let own = if far.count >= COUNT_MIN {
            known(&far, KnownFrom::SameVisit)
        } else {
            known(&all, KnownFrom::Neighbours)
        };
        own.into_iter().collect()
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

impl PieceLookup<'_> {
    /// The piece of line that a point lies on: of another visit if one is within reach, so that copies of a line beside
    /// one another, each true to itself, are drawn together.
    pub(super) fn nearest(&mut self, at: At<FieldFrame>, reach: f32) -> Option<KnownPiece> {
        let own = self.nearest_of(at, reach, |known| known.known_from != KnownFrom::OtherVisit);
        let other = self.nearest_of(at, reach, |known| {
            known.known_from == KnownFrom::OtherVisit
                && own.is_none_or(|own| {
                    let ([ax, ay], [bx, by]) = (own.piece.normal, known.piece.normal);
                    (ax * bx + ay * by).abs() >= PARALLEL_MIN
                })
        });
        other.or(own)
    }

    fn nearest_of(
        &mut self,
        at: At<FieldFrame>,
        reach: f32,
        is_wanted: impl Fn(&KnownPiece) -> bool,
    ) -> Option<KnownPiece> {
        let (map, keyframe) = (self.map, self.keyframe);
        let (column, row) = map.key(at);
        let mut best: Option<(f32, KnownPiece)> = None;
        for dx in -1..=1 {
            for dy in -1..=1 {
                let key = (column + dx, row + dy);
                let pieces = self
                    .pieces
                    .entry(key)
                    .or_insert_with(|| map.pieces(key, keyframe));
                for known in pieces.iter().filter(|known| is_wanted(known)) {
                    let piece = &known.piece;
                    let (x, y) = (at.x - piece.mean.x, at.y - piece.mean.y);
                    let across = (x * piece.normal[0] + y * piece.normal[1]).abs();
                    let along = (x * piece.normal[1] - y * piece.normal[0]).abs();
                    if across > reach || along > map.cell {
                        continue;
                    }
                    let distance = across + 0.3 * along;
                    if best.is_none_or(|(least, _)| distance < least) {
                        best = Some((distance, *known));
                    }
                }
            }
        }
        best.map(|(_, known)| known)
    }
}
