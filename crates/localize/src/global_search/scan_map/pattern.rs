//! Where do the scan lines from a place meet markings? 72 radial lines and 72 spirals (minho2016 III and IV.A).
//!
//! The same pattern is laid over the field, for the map, and over a frame's points, for what is compared with it.

use std::f32::consts::TAU;

use super::{DISTANCE_STEPS, NO_HIT, ScanMapConfig};
use crate::field::Field;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;
use crate::synthetic::drive::intersect_ray;

/// Radial lines (every 5°), distances of each, spirals each way (every 10°).
pub(super) const RADIALS: usize = 72;
pub(super) const HITS_PER_RADIAL: usize = 4;
pub(super) const SPIRALS_PER_DIRECTION: usize = 36;
/// Scan lines of both kinds.
pub(super) const SCAN_LINES: usize = RADIALS + 2 * SPIRALS_PER_DIRECTION;
/// Distances stored per cell.
pub(super) const LAYERS: usize = RADIALS * HITS_PER_RADIAL + 2 * SPIRALS_PER_DIRECTION;

/// The distances of one scan line: its first layer and how many it has.
pub(super) fn layers(line: usize) -> (usize, usize) {
    if line < RADIALS {
        (line * HITS_PER_RADIAL, HITS_PER_RADIAL)
    } else {
        (RADIALS * HITS_PER_RADIAL + line - RADIALS, 1)
    }
}

/// A distance that a frame shows on a scan line, in steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScanHit {
    pub(super) line: usize,
    pub(super) steps: u8,
}

/// The nearest whole step.
fn steps(range: f32, config: &ScanMapConfig) -> u8 {
    (range / config.range_max * DISTANCE_STEPS).round() as u8
}

/// By how much a spiral turns per metre outwards: to the left the first half of them, to the right the others.
fn spiral_rate(spiral: usize, config: &ScanMapConfig) -> f32 {
    let turn = config.spiral_turn_deg.to_radians() / (config.range_max - config.range_min);
    if spiral < SPIRALS_PER_DIRECTION {
        turn
    } else {
        -turn
    }
}

/// Distances at which the scan lines from (x, y) meet markings, radial lines' first four (minho2016 IV.A, eqs 1 to 4).
pub(super) fn scan_field(
    field: &Field,
    distances: &DistanceField,
    [x, y]: [f32; 2],
    config: &ScanMapConfig,
) -> [u8; LAYERS] {
    let mut scan = [NO_HIT; LAYERS];
    let mut hits = Vec::new();
    for radial in 0..RADIALS {
        let (sin, cos) = (radial as f32 / RADIALS as f32 * TAU).sin_cos();
        intersect_ray(&field.markings, [x, y], [cos, sin], &mut hits);
        hits.retain(|&hit| hit > config.range_min && hit < config.range_max);
        hits.sort_by(f32::total_cmp);
        for (slot, &hit) in hits.iter().take(HITS_PER_RADIAL).enumerate() {
            scan[radial * HITS_PER_RADIAL + slot] = steps(hit, config);
        }
    }
    for spiral in 0..2 * SPIRALS_PER_DIRECTION {
        let start = (spiral % SPIRALS_PER_DIRECTION) as f32 / SPIRALS_PER_DIRECTION as f32 * TAU;
        let turn = spiral_rate(spiral, config);
        // No marking is nearer than the distance field says: as far can be gone along the spiral at once.
        let mut range = config.range_min;
        while range < config.range_max {
            let (sin, cos) = (start + turn * (range - config.range_min)).sin_cos();
            let at = distances.nearest(x + range * cos, y + range * sin);
            let free = at.signed_distance.abs();
            if free < 0.03 {
                scan[RADIALS * HITS_PER_RADIAL + spiral] = steps(range, config);
                break;
            }
            // Metres along the spiral per metre outwards.
            let along = (1.0 + (turn * range).powi(2)).sqrt();
            range += (free / along).max(0.01);
        }
    }
    scan
}

/// A frame's distances, by the scan lines that its points lie on under `heading` (radians); what no scan line of the
/// frame met is not compared.
pub(super) fn scan_points(
    points: &[LinePoint],
    heading: f32,
    config: &ScanMapConfig,
) -> Vec<ScanHit> {
    let mut radials: Vec<(usize, f32)> = Vec::with_capacity(points.len());
    let mut spirals = [f32::MAX; 2 * SPIRALS_PER_DIRECTION];
    // A remainder (`rem_euclid`) is a call of the C library; these turns are few, and the floor is one instruction.
    let turns = |angle: f32, lines: usize| {
        let turns = angle / TAU;
        (turns - turns.floor()) * lines as f32
    };
    for point in points {
        let range = point.at.distance();
        if range <= config.range_min || range >= config.range_max {
            continue;
        }
        let direction = heading + point.at.bearing();
        radials.push((turns(direction, RADIALS).round() as usize % RADIALS, range));
        for way in [0, SPIRALS_PER_DIRECTION] {
            let turned = spiral_rate(way, config) * (range - config.range_min);
            let start = turns(direction - turned, SPIRALS_PER_DIRECTION);
            // Only what lies within 2.5° of the spiral was met by it.
            if (start - start.round()).abs() <= 0.25 {
                let nearest = &mut spirals[way + start.round() as usize % SPIRALS_PER_DIRECTION];
                *nearest = nearest.min(range);
            }
        }
    }
    radials.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut seen = Vec::with_capacity(radials.len() + spirals.len());
    for of_one in radials.chunk_by(|a, b| a.0 == b.0) {
        seen.extend(
            of_one
                .iter()
                .take(HITS_PER_RADIAL)
                .map(|&(line, range)| ScanHit {
                    line,
                    steps: steps(range, config),
                }),
        );
    }
    let met = spirals
        .iter()
        .enumerate()
        .filter(|(_, range)| **range < f32::MAX);
    seen.extend(met.map(|(spiral, &range)| ScanHit {
        line: RADIALS + spiral,
        steps: steps(range, config),
    }));
    // Lines of all directions early: a block of cells is given up soon if it is wrong.
    let leap = (seen.len() / 5).max(1);
    (0..leap)
        .flat_map(|first| seen.iter().skip(first).step_by(leap).copied())
        .collect()
}
