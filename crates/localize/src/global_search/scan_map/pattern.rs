//! Where do the scan lines from a position cross markings? 72 radial lines and 72 spirals (minho2016 III and IV.A).
//!
//! The same pattern is applied to the field, for the map, and to an image's line points, for the comparison.

use std::f32::consts::TAU;

use super::config::{DISTANCE_STEPS, NO_HIT, ScanMapConfig};
use crate::field::Field;
use crate::field::ray::intersect_ray;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::sample::LinePoint;

/// Radial lines (every 5°), distances per line, spirals per direction (every 10°).
pub(super) const RADIALS: usize = 72;
pub(super) const HITS_PER_RADIAL: usize = 4;
pub(super) const SPIRALS_PER_DIRECTION: usize = 36;
/// Scan lines of both kinds.
pub(super) const SCAN_LINES: usize = RADIALS + 2 * SPIRALS_PER_DIRECTION;
/// Distances stored per cell.
pub(super) const LAYERS: usize = RADIALS * HITS_PER_RADIAL + 2 * SPIRALS_PER_DIRECTION;

/// The layers of one scan line: the first, and their number.
pub(super) fn layers(line: usize) -> (usize, usize) {
    if line < RADIALS {
        (line * HITS_PER_RADIAL, HITS_PER_RADIAL)
    } else {
        (RADIALS * HITS_PER_RADIAL + line - RADIALS, 1)
    }
}

/// A measured distance on a scan line, in steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScanHit {
    pub(super) line: usize,
    pub(super) steps: u8,
}

/// A distance in steps, rounded.
fn steps(range: f32, config: &ScanMapConfig) -> u8 {
    (range / config.range_max * DISTANCE_STEPS).round() as u8
}

/// Rotation of a spiral per metre of range, rad/m: to the left for the first half of the spirals, else to the right.
fn spiral_rate(spiral: usize, config: &ScanMapConfig) -> f32 {
    let turn = config.spiral_turn_deg.to_radians() / (config.range_max - config.range_min);
    if spiral < SPIRALS_PER_DIRECTION {
        turn
    } else {
        -turn
    }
}

/// Distances at which the scan lines from (x, y) cross markings, up to four per radial line (minho2016 IV.A, eqs 1 to 4).
pub(super) fn scan_field(
    field: &Field,
    distances: &DistanceField,
    [x, y]: [f32; 2],
    config: &ScanMapConfig,
) -> [u8; LAYERS] {
    let mut scan = [NO_HIT; LAYERS];
    let mut hits = Vec::new();
    for radial in 0..RADIALS {
        let (sin, cos) = math::sin_cos(radial as f32 / RADIALS as f32 * TAU);
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
        // No marking is nearer than the distance field states, so that the step along the spiral can be that long.
        let mut range = config.range_min;
        while range < config.range_max {
            let (sin, cos) = math::sin_cos(start + turn * (range - config.range_min));
            let at = distances.nearest(x + range * cos, y + range * sin);
            let free = at.signed_distance.abs();
            if free < 0.03 {
                scan[RADIALS * HITS_PER_RADIAL + spiral] = steps(range, config);
                break;
            }
            // Arc length of the spiral per metre of range.
            let along = (1.0 + (turn * range).powi(2)).sqrt();
            range += (free / along).max(0.01);
        }
    }
    scan
}

/// An image's distances, assigned to the scan lines that its points lie on under `heading` (radians).
pub(super) fn scan_points(
    points: &[LinePoint],
    heading: f32,
    config: &ScanMapConfig,
) -> Vec<ScanHit> {
    let mut radials: Vec<(usize, f32)> = Vec::with_capacity(points.len());
    let mut spirals = [f32::MAX; 2 * SPIRALS_PER_DIRECTION];
    // `rem_euclid` calls the C library; `floor` is one instruction.
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
        for first in [0, SPIRALS_PER_DIRECTION] {
            let turned = spiral_rate(first, config) * (range - config.range_min);
            let start = turns(direction - turned, SPIRALS_PER_DIRECTION);
            // A spiral crosses only points within 2.5° of it.
            if (start - start.round()).abs() <= 0.25 {
                let nearest = &mut spirals[first + start.round() as usize % SPIRALS_PER_DIRECTION];
                *nearest = nearest.min(range);
            }
        }
    }
    radials.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut scan_hits = Vec::with_capacity(radials.len() + spirals.len());
    for line_hits in radials.chunk_by(|a, b| a.0 == b.0) {
        scan_hits.extend(
            line_hits
                .iter()
                .take(HITS_PER_RADIAL)
                .map(|&(line, range)| ScanHit {
                    line,
                    steps: steps(range, config),
                }),
        );
    }
    let crossed = spirals
        .iter()
        .enumerate()
        .filter(|(_, range)| **range < f32::MAX);
    scan_hits.extend(crossed.map(|(spiral, &range)| ScanHit {
        line: RADIALS + spiral,
        steps: steps(range, config),
    }));
    // All directions come early, so that a wrong block of cells is rejected after few comparisons.
    let stride = (scan_hits.len() / 5).max(1);
    (0..stride)
        .flat_map(|first| scan_hits.iter().skip(first).step_by(stride).copied())
        .collect()
}
