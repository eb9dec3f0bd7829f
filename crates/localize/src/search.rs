//! Where on the whole field can these line points have been seen from? Every pose, in a millisecond, provably.
//!
//! Branch and bound over (x, y, θ) on max-pooled score tables (not in the papers; MATH.md 4). A block of 4 × 4 cells
//! is bounded by the sum of its points' pooled scores. All blocks of one heading are bounded at once: the pooled
//! table is stored once per offset modulo four, so that one point's bounds for a row of blocks are consecutive bytes.
//! Only blocks whose bound beats the best cell found are opened. The best cells, distinct from each other, are
//! matched to the end and ranked by likelihood: the runners-up say how ambiguous the view is.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::distance::DistanceField;
use crate::field::Field;
use crate::frame::{Pose, wrap_angle};
use crate::matching::{Match, Matcher};
use crate::sample::LinePoint;

/// How the whole field is searched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SearchConfig {
    /// Side of a position cell, metres.
    pub cell: f32,
    /// Step of headings, degrees: half of it moves a point 5 m away by about a cell.
    pub heading_step_deg: f32,
    /// How far outside the boundary lines a robot may stand, metres.
    pub outside: f32,
    /// Line points beyond this distance from the robot are not used, metres: they swing too far per heading step.
    pub range_max: f32,
    /// c of the score c²/(c² + d²), metres: as wide as cell and heading step leave a true pose's points off.
    pub reach: f32,
    /// Most points used; more are thinned out evenly.
    pub points_max: usize,
    /// Most distinct hypotheses returned (each with its half turn, where the field has one).
    pub hypotheses_max: usize,
    /// Cells that score less than this share of the best are no hypotheses.
    pub runner_up_share: f32,
    /// Most blocks opened for runners-up, after the best cell is certain.
    pub runner_up_blocks: usize,
    /// Hypotheses closer than this are one, metres.
    pub distinct: f32,
    /// Hypotheses closer than this are one, degrees.
    pub distinct_deg: f32,
    /// By how much the points' joint likelihood is tempered: neighbouring points are not independent.
    pub evidence_share: f32,
}

impl Default for SearchConfig {
    fn default() -> Self {
        SearchConfig {
            cell: 0.1,
            heading_step_deg: 2.0,
            outside: 1.0,
            range_max: 10.0,
            reach: 0.2,
            points_max: 120,
            hypotheses_max: 6,
            runner_up_share: 0.85,
            runner_up_blocks: 600,
            distinct: 0.4,
            distinct_deg: 10.0,
            evidence_share: 0.3,
        }
    }
}

/// What is known about the heading beforehand (a compass).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingPrior {
    /// Expected heading, radians.
    pub heading: f32,
    /// Its standard deviation, radians.
    pub std: f32,
}

/// A pose that explains the points.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// The pose, matched to the end.
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians.
    pub covariance: Matrix3<f32>,
    /// Σ (1 − e) over the number of points.
    pub score: f32,
    /// Share of points that are inliers.
    pub inlier_share: f32,
    /// Root mean square distance of the inliers, metres.
    pub residual: f32,
    /// Lean (a, b), radians.
    pub lean: [f32; 2],
    /// Probability among the hypotheses returned.
    pub probability: f32,
}

impl Hypothesis {
    /// A match that nothing was compared with yet.
    pub(crate) fn of(matched: &Match) -> Self {
        Hypothesis {
            pose: matched.pose,
            covariance: matched.covariance,
            score: matched.score,
            inlier_share: matched.inlier_share,
            residual: matched.residual,
            lean: matched.lean,
            probability: 0.0,
        }
    }
}

/// Side of a block in cells.
const BLOCK: usize = 4;
/// Largest score of a cell: 17 of them fit one byte.
const TOP: f32 = 15.0;
/// Points whose bytes are added before they are widened.
const BATCH: usize = 17;
/// Blocks bounded at once: four vector registers of bytes.
const LANES: usize = 64;

/// Score tables of one field.
#[derive(Debug, Clone)]
pub struct Search {
    config: SearchConfig,
    /// Scores by cell, `fine_stride` bytes per row.
    fine: Vec<u8>,
    fine_stride: usize,
    /// Pooled scores: 16 planes, one per offset modulo the block's side.
    planes: Vec<u8>,
    plane_stride: usize,
    plane_size: usize,
    /// Blocks of poses along x and y.
    columns: usize,
    rows: usize,
    /// Blocks beyond the poses on each side, so that every point's offset stays inside.
    apron: usize,
    /// Position of pose cell (0, 0), metres.
    x0: f32,
    y0: f32,
    /// A half turn maps the markings onto themselves.
    symmetric: bool,
    /// Headings of this search go up to half a turn: a pose stands for its half turn too.
    folded: bool,
    bounds: Vec<u16>,
    offsets: Vec<(i32, i32)>,
    used: Vec<LinePoint>,
}

/// A block of poses at one heading, and the most that any of its cells can score.
#[derive(Debug, Clone, Copy)]
struct Block {
    bound: u16,
    heading: u16,
    row: u16,
    column: u16,
}

/// A pose cell and its score.
#[derive(Debug, Clone, Copy)]
struct Cell {
    score: u16,
    pose: Pose,
}

impl Search {
    /// Fills the tables for a field.
    pub fn new(field: &Field, distances: &DistanceField, config: SearchConfig) -> Self {
        let cells_of = |half: f32| ((half + config.outside) / config.cell).ceil();
        let (half_x, half_y) = (cells_of(field.length / 2.0), cells_of(field.width / 2.0));
        let blocks_of = |half: f32| (2 * half as usize + 1).div_ceil(BLOCK);
        let (columns, rows) = (blocks_of(half_x), blocks_of(half_y));
        let apron = ((config.range_max / config.cell).ceil() as usize).div_ceil(BLOCK) + 1;
        let plane_stride = columns.div_ceil(LANES) * LANES + 2 * apron;
        let plane_rows = rows + 2 * apron;
        let (fine_stride, fine_rows) = (plane_stride * BLOCK, plane_rows * BLOCK);
        let (x0, y0) = (-half_x * config.cell, -half_y * config.cell);
        let edge = (apron * BLOCK) as f32;
        let squared = config.reach * config.reach;
        let fine: Vec<u8> = (0..fine_rows * fine_stride)
            .map(|k| {
                let x = x0 + ((k % fine_stride) as f32 - edge) * config.cell;
                let y = y0 + ((k / fine_stride) as f32 - edge) * config.cell;
                let d = distances.nearest(x, y).distance;
                (TOP * squared / (squared + d * d)).round() as u8
            })
            .collect();
        let mut search = Search {
            planes: Vec::new(),
            plane_stride,
            plane_size: plane_rows * plane_stride,
            fine,
            fine_stride,
            columns,
            rows,
            apron,
            x0,
            y0,
            symmetric: half_turn_symmetric(field, distances),
            folded: false,
            bounds: Vec::new(),
            offsets: Vec::new(),
            used: Vec::new(),
            config,
        };
        search.pool(fine_rows);
        search
    }

    /// Does a half turn map the field's markings onto themselves?
    pub fn symmetric(&self) -> bool {
        self.symmetric
    }

    /// Memory held by the tables, bytes.
    pub fn bytes(&self) -> usize {
        self.fine.len() + self.planes.len()
    }

    /// Maxima over blocks from every cell on, sorted into planes by offset modulo the block's side.
    fn pool(&mut self, fine_rows: usize) {
        self.planes = vec![0; self.plane_size * BLOCK * BLOCK];
        for row in 0..fine_rows {
            for column in 0..self.fine_stride {
                let mut best = 0;
                for r in row..(row + BLOCK).min(fine_rows) {
                    let start = r * self.fine_stride;
                    let end = start + (column + BLOCK).min(self.fine_stride);
                    for &score in &self.fine[start + column..end] {
                        best = best.max(score);
                    }
                }
                let plane = (row % BLOCK) * BLOCK + column % BLOCK;
                let place = (row / BLOCK) * self.plane_stride + column / BLOCK;
                self.planes[plane * self.plane_size + place] = best;
            }
        }
    }

    /// The poses that explain `points` (finite; robot frame) best, most probable first; empty without points.
    ///
    /// Without a prior all headings are searched. On a symmetric field every pose then comes with its half turn.
    pub fn find(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        prior: Option<HeadingPrior>,
    ) -> Vec<Hypothesis> {
        self.choose(points);
        if self.used.is_empty() {
            return Vec::new();
        }
        self.folded = prior.is_none() && self.symmetric;
        let (first, count) = self.headings(prior);
        let step = self.config.heading_step_deg.to_radians();
        self.bound(first, step, count);
        let cells = self.open(first, step, count);
        let starts: Vec<Pose> = cells.iter().map(|cell| cell.pose).collect();
        let reach = self.config.reach;
        self.rank(distances, matcher, points, &starts, prior, reach)
    }

    /// Matches the points from each start (off by about `spread` metres), leaves each pose once, and ranks by
    /// likelihood; without a prior on a symmetric field with each pose's half turn behind it.
    pub fn rank(
        &mut self,
        distances: &DistanceField,
        matcher: &mut Matcher,
        points: &[LinePoint],
        starts: &[Pose],
        prior: Option<HeadingPrior>,
        spread: f32,
    ) -> Vec<Hypothesis> {
        self.choose(points);
        self.folded = prior.is_none() && self.symmetric;
        let used = std::mem::take(&mut self.used);
        let mut found: Vec<(f32, Hypothesis)> = Vec::new();
        for start in screen(distances, &used, starts, spread) {
            let matched = matcher.refine(distances, &used, start, spread);
            let known = |(_, other): &(f32, Hypothesis)| self.same_folded(other.pose, matched.pose);
            if found.iter().any(known) {
                continue;
            }
            let turned = prior.map_or(0.0, |prior| {
                0.5 * (wrap_angle(matched.pose.theta - prior.heading) / prior.std).powi(2)
            });
            let cost = self.config.evidence_share * matched.cost + turned;
            found.push((cost, Hypothesis::of(&matched)));
        }
        self.used = used;
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        if self.folded {
            found = found
                .into_iter()
                .flat_map(|(cost, one)| {
                    let other = half_turned(&one);
                    [(cost, one), (cost, other)]
                })
                .collect();
        }
        weigh(found)
    }

    /// Thins the points out to those used.
    fn choose(&mut self, points: &[LinePoint]) {
        let range = self.config.range_max;
        self.used.clear();
        self.used.extend(
            points
                .iter()
                .filter(|point| point.at.distance() < range)
                .copied(),
        );
        let (count, most) = (self.used.len(), self.config.points_max);
        if count > most {
            for k in 0..most {
                self.used[k] = self.used[k * count / most];
            }
            self.used.truncate(most);
        }
    }

    /// First heading and number of headings to search.
    fn headings(&self, prior: Option<HeadingPrior>) -> (f32, usize) {
        use std::f32::consts::{PI, TAU};
        let step = self.config.heading_step_deg.to_radians();
        let all = if self.folded { PI } else { TAU };
        let Some(prior) = prior else {
            return (0.0, (all / step).ceil() as usize);
        };
        let half = (3.0 * prior.std).min(PI);
        let count = ((2.0 * half / step).ceil() as usize).max(1);
        (prior.heading - half + 0.5 * step, count)
    }

    /// Offsets of the points in cells at one heading.
    fn turn(&mut self, heading: f32) {
        let (sin, cos) = heading.sin_cos();
        let per_cell = 1.0 / self.config.cell;
        let edge = (self.apron * BLOCK) as f32;
        self.offsets.clear();
        self.offsets.extend(self.used.iter().map(|point| {
            let x = (cos * point.at.x - sin * point.at.y) * per_cell;
            let y = (sin * point.at.x + cos * point.at.y) * per_cell;
            ((x + edge).round() as i32, (y + edge).round() as i32)
        }));
    }

    /// Bounds of all blocks at all headings.
    fn bound(&mut self, first: f32, step: f32, count: usize) {
        let width = self.columns.div_ceil(LANES) * LANES;
        let mut bounds = std::mem::take(&mut self.bounds);
        bounds.clear();
        bounds.resize(count * self.rows * width, 0);
        let mut bases = Vec::with_capacity(self.used.len());
        for (heading, layer) in bounds.chunks_exact_mut(self.rows * width).enumerate() {
            self.turn(first + heading as f32 * step);
            bases.clear();
            bases.extend(self.offsets.iter().map(|&(x, y)| {
                let (x, y) = (x as usize, y as usize);
                let plane = (y % BLOCK) * BLOCK + x % BLOCK;
                plane * self.plane_size + (y / BLOCK) * self.plane_stride + x / BLOCK
            }));
            for (row, line) in layer.chunks_exact_mut(width).enumerate() {
                for (chunk, sums) in line.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                    let at = row * self.plane_stride + chunk * LANES;
                    add_rows(&self.planes[at..], &bases, sums);
                }
            }
        }
        self.bounds = bounds;
    }

    /// The best cells, distinct, best first.
    fn open(&mut self, first: f32, step: f32, count: usize) -> Vec<Cell> {
        let width = self.columns.div_ceil(LANES) * LANES;
        let layer = self.rows * width;
        let mut blocks: Vec<Block> = Vec::new();
        let mut tops: Vec<Block> = Vec::with_capacity(count);
        let block = |index: usize, bound: u16| Block {
            bound,
            heading: (index / layer) as u16,
            row: (index % layer / width) as u16,
            column: (index % width) as u16,
        };
        for heading in 0..count {
            let bounds = &self.bounds[heading * layer..(heading + 1) * layer];
            let top = bounds.iter().copied().max().unwrap_or(0);
            let at = bounds.iter().position(|&bound| bound == top).unwrap_or(0);
            tops.push(block(heading * layer + at, top));
        }
        tops.sort_by_key(|top| std::cmp::Reverse(top.bound));
        let mut best = 0;
        for top in tops.iter().take(4) {
            self.turn(first + f32::from(top.heading) * step);
            best = best.max(self.best_cell(*top, first, step).score);
        }
        let part = self.config.runner_up_share;
        let share = |best: u16| (f32::from(best) * part) as u16;
        let floor = share(best);
        for (index, &bound) in self.bounds.iter().enumerate() {
            if bound > floor && index % width < self.columns {
                blocks.push(block(index, bound));
            }
        }
        blocks.sort_unstable_by_key(|block| {
            (
                std::cmp::Reverse(block.bound),
                block.heading,
                block.row,
                block.column,
            )
        });
        let mut cells: Vec<Cell> = Vec::new();
        let mut spare = self.config.runner_up_blocks;
        let mut turned_to = u16::MAX;
        for block in blocks {
            if block.bound <= best {
                if block.bound <= share(best) || spare == 0 {
                    break;
                }
                spare -= 1;
            }
            if block.heading != turned_to {
                self.turn(first + f32::from(block.heading) * step);
                turned_to = block.heading;
            }
            let cell = self.best_cell(block, first, step);
            best = best.max(cell.score);
            if cell.score > share(best) {
                cells.push(cell);
            }
        }
        cells.sort_by_key(|cell| std::cmp::Reverse(cell.score));
        let mut distinct: Vec<Cell> = Vec::new();
        for cell in cells {
            if distinct.len() >= self.config.hypotheses_max || cell.score <= share(best) {
                break;
            }
            if !distinct
                .iter()
                .any(|other| self.same_folded(other.pose, cell.pose))
            {
                distinct.push(cell);
            }
        }
        distinct
    }

    /// The best cell of a block; `turn` must have been called for its heading.
    fn best_cell(&self, block: Block, first: f32, step: f32) -> Cell {
        let at =
            usize::from(block.row) * BLOCK * self.fine_stride + usize::from(block.column) * BLOCK;
        let mut sums = [0_u16; BLOCK * BLOCK];
        for batch in self.offsets.chunks(BATCH) {
            let mut bytes = [0_u8; BLOCK * BLOCK];
            for &(x, y) in batch {
                let start = at + y as usize * self.fine_stride + x as usize;
                for row in 0..BLOCK {
                    let from = start + row * self.fine_stride;
                    for (byte, &score) in bytes[row * BLOCK..(row + 1) * BLOCK]
                        .iter_mut()
                        .zip(&self.fine[from..from + BLOCK])
                    {
                        *byte += score;
                    }
                }
            }
            for (sum, byte) in sums.iter_mut().zip(bytes) {
                *sum += u16::from(byte);
            }
        }
        let mut best = 0;
        for (k, &sum) in sums.iter().enumerate() {
            if sum > sums[best] {
                best = k;
            }
        }
        let column = usize::from(block.column) * BLOCK + best % BLOCK;
        let row = usize::from(block.row) * BLOCK + best / BLOCK;
        Cell {
            score: sums[best],
            pose: Pose::new(
                self.x0 + column as f32 * self.config.cell,
                self.y0 + row as f32 * self.config.cell,
                first + f32::from(block.heading) * step,
            ),
        }
    }

    /// Are two poses too close to be two hypotheses?
    pub fn same(&self, a: Pose, b: Pose) -> bool {
        a.origin().distance_to(b.origin()) < self.config.distinct
            && wrap_angle(a.theta - b.theta).abs() < self.config.distinct_deg.to_radians()
    }

    /// The same, up to the half turn where headings are searched up to it.
    fn same_folded(&self, a: Pose, b: Pose) -> bool {
        self.same(a, b) || self.folded && self.same(a, half_turn(b))
    }
}

/// The pose after the field was turned by half a turn.
pub fn half_turn(pose: Pose) -> Pose {
    Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI)
}

fn half_turned(one: &Hypothesis) -> Hypothesis {
    // Turning by half a turn maps (x, y) to (−x, −y): second moments stay, those with θ change sign.
    let mut covariance = one.covariance;
    for i in 0..2 {
        covariance[(i, 2)] = -covariance[(i, 2)];
        covariance[(2, i)] = -covariance[(2, i)];
    }
    Hypothesis {
        pose: half_turn(one.pose),
        covariance,
        ..one.clone()
    }
}

/// Starts that are matched to the end.
const MATCHED: usize = 24;

/// Points that many starts are screened with.
const SCREENED: usize = 40;

/// The starts themselves if they are few, or those under which some of the points lie nearest to markings.
fn screen(
    distances: &DistanceField,
    points: &[LinePoint],
    starts: &[Pose],
    reach: f32,
) -> Vec<Pose> {
    if starts.len() <= MATCHED {
        return starts.to_vec();
    }
    let some: Vec<&LinePoint> = points
        .iter()
        .step_by(points.len().div_ceil(SCREENED).max(1))
        .collect();
    let squared = reach * reach;
    let mut scored: Vec<(f32, Pose)> = starts
        .iter()
        .map(|&pose| {
            let score = some
                .iter()
                .map(|point| {
                    let at = pose * point.at;
                    let distance = distances.nearest(at.x, at.y).distance;
                    squared / (squared + distance * distance)
                })
                .sum();
            (score, pose)
        })
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored
        .into_iter()
        .map(|(_, pose)| pose)
        .take(MATCHED)
        .collect()
}

/// Probabilities from costs (negative log likelihoods, ascending).
fn weigh(found: Vec<(f32, Hypothesis)>) -> Vec<Hypothesis> {
    let least = found.first().map_or(0.0, |(cost, _)| *cost);
    let total: f32 = found.iter().map(|(cost, _)| (least - cost).exp()).sum();
    found
        .into_iter()
        .map(|(cost, hypothesis)| Hypothesis {
            probability: (least - cost).exp() / total,
            ..hypothesis
        })
        .collect()
}

/// Adds one row of blocks of every point: bytes first, widened before they overflow.
fn add_rows(planes: &[u8], bases: &[usize], sums: &mut [u16; LANES]) {
    for batch in bases.chunks(BATCH) {
        let mut bytes = [0_u8; LANES];
        for &base in batch {
            let Some(row) = planes[base..].first_chunk::<LANES>() else {
                continue;
            };
            for (byte, &score) in bytes.iter_mut().zip(row) {
                *byte = byte.wrapping_add(score);
            }
        }
        for (sum, byte) in sums.iter_mut().zip(bytes) {
            *sum += u16::from(byte);
        }
    }
}

/// Compares distances at points and at their half turns over the carpet.
fn half_turn_symmetric(field: &Field, distances: &DistanceField) -> bool {
    let (half_x, half_y) = field.carpet_half_extent();
    let step = 0.25;
    let (columns, rows) = ((half_x / step) as i32, (2.0 * half_y / step) as i32);
    (0..=columns).all(|column| {
        (0..=rows).all(|row| {
            let (x, y) = (column as f32 * step, row as f32 * step - half_y);
            let here = distances.nearest(x, y).distance.abs();
            let there = distances.nearest(-x, -y).distance.abs();
            (here - there).abs() < 0.02
        })
    })
}
