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
    /// The straight pieces, as markings of the cable's width.
    pub(super) fn segments(&self) -> impl Iterator<Item = Marking> + '_ {
        self.points.windows(2).map(|pair| Marking::Line {
            from: At::new(pair[0][0], pair[0][1]),
            to: At::new(pair[1][0], pair[1][1]),
        })
    }
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
