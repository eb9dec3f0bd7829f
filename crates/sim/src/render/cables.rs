//! Where do cables lie on the carpet? From an edge across it, in random curves.

use std::f32::consts::{PI, TAU};

use localize::field::Marking;
use localize::frames::At;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::environment::EnvironmentConfig;

/// Length of a straight piece, metres.
const STEP: f32 = 0.12;
/// Standard deviation of the change of curvature from piece to piece, 1/m, and the share of curvature that is kept.
const CURVATURE_CHANGE: f32 = 0.35;
const CURVATURE_KEPT: f32 = 0.9;
/// Most pieces of a cable.
const PIECES_MAX: usize = 120;

/// A cable, field frame.
pub(super) struct Cable {
    pub(super) width: f32,
    points: Vec<[f32; 2]>,
}

impl Cable {
    /// Its points in runs of up to `steps` pieces. The last point of a run is the first one of the next.
    pub(super) fn runs(&self, steps: usize) -> impl Iterator<Item = &[[f32; 2]]> {
        let last = self.points.len() - 1;
        (0..last)
            .step_by(steps)
            .map(move |first| &self.points[first..=(first + steps).min(last)])
    }
}

/// The straight line in place of pieces through some points, and its largest distance from these, metres.
pub(super) fn merge(points: &[[f32; 2]]) -> (Marking, f32) {
    let (from, to) = (points[0], points[points.len() - 1]);
    let [dx, dy] = [0, 1].map(|k| to[k] - from[k]);
    let length = dx.hypot(dy).max(1e-6);
    let normal = [-dy / length, dx / length];
    let (mut low, mut high) = (0.0f32, 0.0f32);
    for point in points {
        let off = (point[0] - from[0]) * normal[0] + (point[1] - from[1]) * normal[1];
        (low, high) = (low.min(off), high.max(off));
    }
    let middle = (low + high) / 2.0;
    let at = |end: [f32; 2]| At::new(end[0] + middle * normal[0], end[1] + middle * normal[1]);
    let line = Marking::Line {
        from: at(from),
        to: at(to),
    };
    (line, (high - low) / 2.0)
}

/// The cables of a hall on a carpet of ± half metres.
pub(super) fn lay_cables(
    environment: &EnvironmentConfig,
    half: [f32; 2],
    rng: &mut ChaCha8Rng,
) -> Vec<Cable> {
    (0..environment.cables)
        .map(|_| Cable {
            width: environment.cable_width,
            points: lay_cable(half, rng),
        })
        .collect()
}

/// Walks inwards from a random point of the carpet's edge, until it leaves the carpet or is long enough.
fn lay_cable([half_x, half_y]: [f32; 2], rng: &mut ChaCha8Rng) -> Vec<[f32; 2]> {
    let bearing = TAU * rng.random::<f32>() - PI;
    let (sin, cos) = bearing.sin_cos();
    let scale = (half_x / cos.abs().max(1e-3)).min(half_y / sin.abs().max(1e-3));
    let mut at = [0.999 * scale * cos, 0.999 * scale * sin];
    // Towards the middle, up to 60° to either side.
    let mut heading = bearing + PI + (rng.random::<f32>() - 0.5) * (TAU / 3.0);
    let mut curvature = 0.0;
    let mut points = vec![at];
    let pieces = PIECES_MAX / 3 + rng.random_range(0..PIECES_MAX * 2 / 3);
    while points.len() < pieces {
        curvature =
            CURVATURE_KEPT * curvature + CURVATURE_CHANGE * localize::random::standard_normal(rng);
        heading += curvature * STEP;
        at = [at[0] + STEP * heading.cos(), at[1] + STEP * heading.sin()];
        if at[0].abs() > half_x || at[1].abs() > half_y {
            break;
        }
        points.push(at);
    }
    points
}
