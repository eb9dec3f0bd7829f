//! The scan map (minho2016 IV): from which cell of the field do scan lines meet markings at the distances seen?
//!
//! For every cell of 0.1 m over field + 1 m the distances are stored at which its 72 radial lines (every 5°, up to
//! four each) and 72 spirals (36 each way, every 10°, one each) meet markings. A frame's distances are compared with
//! every cell's, under a known heading, by the error of eq. 5; scan lines that saw nothing are ignored, and near
//! points weigh more. Sums that already exceed the best are not finished, which changes nothing in the result.

use std::f32::consts::TAU;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::distance::DistanceField;
use crate::drive::crossings;
use crate::field::Field;
use crate::frame::Pose;
use crate::sample::LinePoint;

/// Pattern and error of the scan map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScanMapConfig {
    /// Side of a cell, metres (minho2016 IV: 0.1).
    pub cell: f32,
    /// Cells beyond the boundary lines, metres (minho2016 IV: 1).
    pub outside: f32,
    /// Farthest distance looked at, metres ("the maximum robot visualization distance").
    pub range: f32,
    /// Nearest, metres: the robot's own radius ("MASK").
    pub range_min: f32,
    /// By how much a spiral turns from the nearest to the farthest distance, degrees.
    pub spiral_turn_deg: f32,
    /// c of eq. 5, metres.
    pub reach: f32,
    /// Distance at which a point's weight has fallen to half, metres.
    pub half_weight: f32,
    /// Half the side of the local search's square, metres (minho2016 VI: 4 m²).
    pub local_half: f32,
}

impl Default for ScanMapConfig {
    fn default() -> Self {
        ScanMapConfig {
            cell: 0.1,
            outside: 1.0,
            range: 6.0,
            range_min: 0.3,
            spiral_turn_deg: 120.0,
            reach: 0.25,
            half_weight: 4.0,
            local_half: 1.0,
        }
    }
}

/// Version of the stored file; another one is built anew.
const VERSION: u32 = 1;
const MAGIC: &[u8; 8] = b"MBSCAN\0\0";

/// Radial lines, distances of each, spirals each way.
const RADIALS: usize = 72;
const SLOTS: usize = 4;
const SPIRALS: usize = 36;
const LAYERS: usize = RADIALS * SLOTS + 2 * SPIRALS;

/// Distances are stored in 180ths of the range; this stands for none, and is far from every distance seen.
const STEPS: f32 = 180.0;
const NONE: u8 = 255;

/// Cells compared at once.
const LANES: usize = 64;
/// The same for the local search: its rows are 21 cells.
const LOCAL_LANES: usize = 24;
/// Scan lines that put the blocks in order.
const FIRST: usize = 16;
/// Scan lines between two looks at whether a block of cells can still win.
const STRIDE: usize = 12;
/// Cells up to this part above the best error are finished, for the runners-up.
const KEPT: f32 = 1.25;

/// Why a stored map cannot be used or written.
#[derive(Debug, thiserror::Error)]
pub enum ScanMapError {
    /// The file cannot be written or read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
}

/// Distances of one field's markings from every cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanMap {
    config: ScanMapConfig,
    /// By scan line and slot, then by cell.
    layers: Vec<u8>,
    columns: usize,
    rows: usize,
    /// Bytes per layer: the cells, filled up to whole blocks.
    plane: usize,
    /// Errors of eq. 5 by weight class and difference in steps.
    errors: Vec<[u16; 256]>,
    x0: f32,
    y0: f32,
}

/// A frame's distance on one scan line: first layer, number of layers, distance, look-up of its errors.
#[derive(Debug, Clone, Copy)]
struct Seen {
    layer: usize,
    slots: usize,
    steps: u8,
    errors: usize,
}

impl ScanMap {
    /// Scans the field from every cell, rows in parallel.
    pub fn new(field: &Field, distances: &DistanceField, config: ScanMapConfig) -> Self {
        let mut map = ScanMap::empty(field, config);
        let (columns, rows) = (map.columns, map.rows);
        let scans: Vec<[u8; LAYERS]> = (0..columns * rows)
            .into_par_iter()
            .map(|cell| {
                let x = map.x0 + (cell % columns) as f32 * map.config.cell;
                let y = map.y0 + (cell / columns) as f32 * map.config.cell;
                map.scan(field, distances, x, y)
            })
            .collect();
        for (cell, scan) in scans.iter().enumerate() {
            for (layer, &steps) in scan.iter().enumerate() {
                map.layers[layer * map.plane + cell] = steps;
            }
        }
        map
    }

    /// Reads the map from `path`, or builds it and writes it there when there is none for this field and pattern.
    /// Says whether it was built.
    pub fn cached(
        path: &Path,
        field: &Field,
        distances: &DistanceField,
        config: ScanMapConfig,
    ) -> Result<(Self, bool), ScanMapError> {
        let wrap = |source| ScanMapError::File {
            path: path.to_owned(),
            source,
        };
        match std::fs::read(path) {
            Ok(bytes) => {
                if let Some(map) = ScanMap::from_bytes(&bytes, field, &config) {
                    return Ok((map, false));
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(wrap(error)),
        }
        let map = ScanMap::new(field, distances, config);
        std::fs::write(path, map.to_bytes(field)).map_err(wrap)?;
        Ok((map, true))
    }

    /// The stored form: magic, version, fingerprint of field and pattern, checksum, distances.
    pub fn to_bytes(&self, field: &Field) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.layers.len() + 28);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&fingerprint(field, &self.config).to_le_bytes());
        bytes.extend_from_slice(&checksum(&self.layers).to_le_bytes());
        bytes.extend_from_slice(&self.layers);
        bytes
    }

    /// A stored map, none if it is of another version, field or pattern, or damaged.
    pub fn from_bytes(bytes: &[u8], field: &Field, config: &ScanMapConfig) -> Option<Self> {
        let (magic, rest) = bytes.split_first_chunk::<8>()?;
        let (version, rest) = rest.split_first_chunk::<4>()?;
        let (made_for, rest) = rest.split_first_chunk::<8>()?;
        let (sum, layers) = rest.split_first_chunk::<8>()?;
        let mut map = ScanMap::empty(field, config.clone());
        let fits = magic == MAGIC
            && u32::from_le_bytes(*version) == VERSION
            && u64::from_le_bytes(*made_for) == fingerprint(field, config)
            && layers.len() == map.layers.len()
            && u64::from_le_bytes(*sum) == checksum(layers);
        fits.then(|| {
            map.layers.copy_from_slice(layers);
            map
        })
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.layers.len()
    }

    fn empty(field: &Field, config: ScanMapConfig) -> Self {
        let cells = |half: f32| ((half + config.outside) / config.cell).round();
        let (half_x, half_y) = (cells(field.length / 2.0), cells(field.width / 2.0));
        let (columns, rows) = (2 * half_x as usize + 1, 2 * half_y as usize + 1);
        // One block more, so that every row of the local search has its lanes.
        let plane = (columns * rows).div_ceil(LANES) * LANES + LANES;
        ScanMap {
            layers: vec![NONE; plane * LAYERS],
            columns,
            rows,
            plane,
            errors: errors(&config),
            x0: -half_x * config.cell,
            y0: -half_y * config.cell,
            config,
        }
    }

    /// Distances at which the scan lines from (x, y) meet markings (minho2016 IV.A, eqs 1 to 4).
    fn scan(&self, field: &Field, distances: &DistanceField, x: f32, y: f32) -> [u8; LAYERS] {
        let mut scan = [NONE; LAYERS];
        let config = &self.config;
        let mut hits = Vec::new();
        for radial in 0..RADIALS {
            let (sin, cos) = (radial as f32 / RADIALS as f32 * TAU).sin_cos();
            crossings(&field.markings, [x, y], [cos, sin], &mut hits);
            hits.retain(|&hit| hit > config.range_min && hit < config.range);
            hits.sort_by(f32::total_cmp);
            for (slot, &hit) in hits.iter().take(SLOTS).enumerate() {
                scan[radial * SLOTS + slot] = self.steps(hit);
            }
        }
        for spiral in 0..2 * SPIRALS {
            let (start, turn) = self.spiral(spiral);
            // No marking is nearer than the distance field says: as far can be gone along the spiral at once.
            let mut range = config.range_min;
            while range < config.range {
                let (sin, cos) = (start + turn * (range - config.range_min)).sin_cos();
                let free = distances
                    .nearest(x + range * cos, y + range * sin)
                    .distance
                    .abs();
                if free < 0.03 {
                    scan[RADIALS * SLOTS + spiral] = self.steps(range);
                    break;
                }
                // Metres along the spiral per metre outwards.
                let along = (1.0 + (turn * range).powi(2)).sqrt();
                range += (free / along).max(0.01);
            }
        }
        scan
    }

    /// Start direction of a spiral and its turn per metre outwards.
    fn spiral(&self, spiral: usize) -> (f32, f32) {
        let start = (spiral % SPIRALS) as f32 / SPIRALS as f32 * TAU;
        let reach = self.config.range - self.config.range_min;
        let turn = self.config.spiral_turn_deg.to_radians() / reach;
        (start, if spiral < SPIRALS { turn } else { -turn })
    }

    fn steps(&self, range: f32) -> u8 {
        (range / self.config.range * STEPS).round() as u8
    }

    /// The frame's distances, by the scan lines that its points lie on under `heading` (radians).
    fn sort(&self, points: &[LinePoint], heading: f32) -> Vec<Seen> {
        let mut radials: Vec<Vec<f32>> = vec![Vec::new(); RADIALS];
        let mut spirals = [f32::MAX; 2 * SPIRALS];
        let turns = |angle: f32, lines: usize| (angle / TAU).rem_euclid(1.0) * lines as f32;
        for point in points {
            let range = point.at.distance();
            if range <= self.config.range_min || range >= self.config.range {
                continue;
            }
            let direction = heading + point.at.bearing();
            let radial = turns(direction, RADIALS).round() as usize % RADIALS;
            radials[radial].push(range);
            for way in [0, SPIRALS] {
                let (_, turn) = self.spiral(way);
                let start = turns(direction - turn * (range - self.config.range_min), SPIRALS);
                // Only what lies within 2.5° of the spiral was met by it.
                if (start - start.round()).abs() <= 0.25 {
                    let nearest = &mut spirals[way + start.round() as usize % SPIRALS];
                    *nearest = nearest.min(range);
                }
            }
        }
        let mut seen = Vec::new();
        for (radial, ranges) in radials.iter_mut().enumerate() {
            ranges.sort_by(f32::total_cmp);
            for &range in ranges.iter().take(SLOTS) {
                seen.push(self.seen(radial * SLOTS, SLOTS, range));
            }
        }
        for (spiral, &range) in spirals.iter().enumerate() {
            if range < f32::MAX {
                seen.push(self.seen(RADIALS * SLOTS + spiral, 1, range));
            }
        }
        // Lines of all directions early: a block of cells is given up soon if it is wrong.
        let count = seen.len();
        let leap = (count / 5).max(1);
        let mut spread = Vec::with_capacity(count);
        for first in 0..leap {
            spread.extend(seen.iter().skip(first).step_by(leap).copied());
        }
        spread
    }

    fn seen(&self, layer: usize, slots: usize, range: f32) -> Seen {
        let steps = self.steps(range);
        Seen {
            layer,
            slots,
            steps,
            errors: usize::from(steps) / WEIGHT_STEP,
        }
    }

    /// The cells with the least error under `heading`, best first, at most `most` and `apart` metres apart.
    pub fn find(
        &self,
        points: &[LinePoint],
        heading: f32,
        most: usize,
        apart: f32,
    ) -> Vec<(f32, Pose)> {
        let seen = self.sort(points, heading);
        let count = self.columns * self.rows;
        // A few scan lines say which blocks to look at first; these then say how few of the others to finish.
        let (some, rest) = seen.split_at(seen.len().min(FIRST));
        let mut blocks: Vec<(u32, usize, [u32; LANES])> = (0..count)
            .step_by(LANES)
            .map(|block| {
                let mut sums = [0; LANES];
                self.add(some, block, &mut sums);
                (sums.iter().copied().min().unwrap_or(0), block, sums)
            })
            .collect();
        blocks.sort_unstable_by_key(|&(least, block, _)| (least, block));
        let mut best = u32::MAX;
        let mut cells: Vec<(u32, usize)> = Vec::new();
        let limit = |best: u32| (best as f32 * KEPT) as u32;
        for (least, block, sums) in blocks {
            if least > limit(best) {
                break;
            }
            let Some(sums) = self.finish(rest, block, sums, limit(best)) else {
                continue;
            };
            for (&sum, cell) in sums.iter().zip(block..count) {
                if sum <= limit(best) {
                    best = best.min(sum);
                    cells.push((sum, cell));
                }
            }
        }
        cells.retain(|&(sum, _)| sum <= limit(best));
        cells.sort_unstable();
        self.distinct(&cells, heading, most, apart, seen.len())
    }

    /// The same in a square about `centre` (minho2016 VI: 4 m²), the best cell alone.
    pub fn find_near(&self, points: &[LinePoint], centre: Pose) -> Option<(f32, Pose)> {
        let seen = self.sort(points, centre.theta);
        let half = (self.config.local_half / self.config.cell) as i32;
        let middle = |at: f32, from: f32| ((at - from) / self.config.cell).round() as i32;
        let (column, row) = (middle(centre.x, self.x0), middle(centre.y, self.y0));
        let clamp = |value: i32, most: usize| value.clamp(0, most as i32 - 1) as usize;
        let first = clamp(column - half, self.columns);
        let last = clamp(column + half, self.columns);
        let mut best = (u32::MAX, 0);
        // From the middle outwards: the best is probably found early, and the rest given up soon.
        for off in (0..=half).flat_map(|off| [off, -off]) {
            let row = row + off;
            if row < 0 || row >= self.rows as i32 {
                continue;
            }
            let from = row as usize * self.columns;
            for start in (first..=last).step_by(LOCAL_LANES) {
                let none = [0; LOCAL_LANES];
                let Some(sums) = self.finish(&seen, from + start, none, best.0) else {
                    continue;
                };
                for (&sum, column) in sums.iter().zip(start..=last) {
                    best = best.min((sum, from + column));
                }
            }
        }
        (!seen.is_empty() && best.0 < u32::MAX).then(|| {
            let pose = self.pose(best.1, centre.theta);
            (best.0 as f32 / seen.len() as f32, pose)
        })
    }

    /// Adds the errors of all lines to those of a block of cells; none once all of them exceed the limit.
    fn finish<const N: usize>(
        &self,
        seen: &[Seen],
        block: usize,
        mut sums: [u32; N],
        limit: u32,
    ) -> Option<[u32; N]> {
        for lines in seen.chunks(STRIDE) {
            self.add(lines, block, &mut sums);
            if sums.iter().all(|&sum| sum > limit) {
                return None;
            }
        }
        Some(sums)
    }

    /// Adds the errors of some lines to those of a block of cells.
    fn add<const N: usize>(&self, lines: &[Seen], block: usize, sums: &mut [u32; N]) {
        for line in lines {
            let mut least = [NONE; N];
            for slot in 0..line.slots {
                let at = (line.layer + slot) * self.plane + block;
                let Some(stored) = self.layers[at..].first_chunk::<N>() else {
                    continue;
                };
                for (least, &steps) in least.iter_mut().zip(stored) {
                    *least = (*least).min(steps.abs_diff(line.steps));
                }
            }
            let errors = &self.errors[line.errors];
            for (sum, least) in sums.iter_mut().zip(least) {
                *sum += u32::from(errors[usize::from(least)]);
            }
        }
    }

    fn distinct(
        &self,
        cells: &[(u32, usize)],
        heading: f32,
        most: usize,
        apart: f32,
        lines: usize,
    ) -> Vec<(f32, Pose)> {
        let mut found: Vec<(f32, Pose)> = Vec::new();
        for &(sum, cell) in cells {
            let pose = self.pose(cell, heading);
            let far = |other: &(f32, Pose)| other.1.origin().distance_to(pose.origin()) >= apart;
            if lines > 0 && found.len() < most && found.iter().all(far) {
                found.push((sum as f32 / lines as f32, pose));
            }
        }
        found
    }

    fn pose(&self, cell: usize, heading: f32) -> Pose {
        Pose::new(
            self.x0 + (cell % self.columns) as f32 * self.config.cell,
            self.y0 + (cell / self.columns) as f32 * self.config.cell,
            heading,
        )
    }
}

/// Errors by weight class and difference in steps: eq. 5, near points weighing more.
fn errors(config: &ScanMapConfig) -> Vec<[u16; 256]> {
    let step = config.range / STEPS;
    (0..=STEPS as usize / WEIGHT_STEP)
        .map(|class| {
            let range = (class * WEIGHT_STEP) as f32 * step;
            let weight = 1.0 / (1.0 + (range / config.half_weight).powi(2));
            std::array::from_fn(|difference| {
                let t = difference as f32 * step;
                let c = config.reach;
                (1000.0 * weight * (1.0 - c * c / (c * c + t * t))) as u16
            })
        })
        .collect()
}

/// Steps of distance that share a weight.
const WEIGHT_STEP: usize = 12;

/// FNV-1a over what the distances depend on.
fn fingerprint(field: &Field, config: &ScanMapConfig) -> u64 {
    checksum(format!("{:?} {config:?}", field.markings).as_bytes())
}

fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, &byte| {
        (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
