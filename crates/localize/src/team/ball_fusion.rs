//! Which of the balls are one? The largest group of witnesses who agree, merged by their covariances.

use nalgebra::{Matrix2, Vector2};

use super::TeamConfig;
use crate::frames::{At, FieldFrame};

/// Where one robot says the ball is now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallMeasurement {
    /// Who says so.
    pub robot: u32,
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
}

/// What the witnesses say together.
#[derive(Debug, Clone, PartialEq)]
pub struct FusedBall {
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Who agrees, by number.
    pub inliers: Vec<u32>,
    /// Who does not, by number.
    pub outliers: Vec<u32>,
}

/// More witnesses than this are not compared: 2^13 groups at most.
const MEASUREMENTS_MAX: usize = 13;

/// Merges the largest group of witnesses of whom each two agree; none where there are no witnesses.
///
/// Of groups of one size the one with `own` in it is taken, then the one that knows best.
pub fn fuse_balls(
    witnesses: &[BallMeasurement],
    own: u32,
    config: &TeamConfig,
) -> Option<FusedBall> {
    let witnesses = &witnesses[..witnesses.len().min(MEASUREMENTS_MAX)];
    let covariances: Vec<Matrix2<f32>> = witnesses
        .iter()
        .map(|witness| {
            let [xx, xy, yy] = witness.covariance;
            Matrix2::new(xx, xy, xy, yy)
                + Matrix2::identity() * config.position_std_min * config.position_std_min
        })
        .collect();
    let count = witnesses.len();
    // Bit j of agreeing[i]: do i and j see one ball?
    let agreeing: Vec<u32> = (0..count)
        .map(|i| {
            let with = |j: usize| {
                let off = position_vector(&witnesses[i]) - position_vector(&witnesses[j]);
                let inverse = (covariances[i] + covariances[j]).try_inverse();
                i == j || inverse.is_some_and(|k| (off.transpose() * k * off).x <= config.gate)
            };
            (0..count).filter(|&j| with(j)).map(|j| 1 << j).sum()
        })
        .collect();
    let ours: u32 = (0..count)
        .filter(|&i| witnesses[i].robot == own)
        .map(|i| 1 << i)
        .sum();
    let mut best: Option<(u32, Matrix2<f32>)> = None;
    for group in 1_u32..1 << count {
        let members = || (0..count).filter(move |i| group >> i & 1 == 1);
        if members().any(|i| agreeing[i] & group != group) {
            continue;
        }
        let information = members()
            .filter_map(|i| covariances[i].try_inverse())
            .sum::<Matrix2<f32>>();
        let better = best.is_none_or(|(known, known_information)| {
            let rank = |group: u32| (group.count_ones(), group & ours != 0);
            rank(group) > rank(known)
                || rank(group) == rank(known)
                    && information.determinant() > known_information.determinant()
        });
        if better {
            best = Some((group, information));
        }
    }
    let (group, information) = best?;
    let covariance = information.try_inverse()?;
    let (mut at, mut velocity) = (Vector2::zeros(), Vector2::zeros());
    for i in (0..count).filter(|i| group >> i & 1 == 1) {
        let weight = covariance * covariances[i].try_inverse()?;
        at += weight * position_vector(&witnesses[i]);
        velocity += weight * Vector2::from(witnesses[i].velocity);
    }
    let named = |within: bool| {
        let mut robots: Vec<u32> = (0..count)
            .filter(|i| (group >> i & 1 == 1) == within)
            .map(|i| witnesses[i].robot)
            .collect();
        robots.sort_unstable();
        robots
    };
    Some(FusedBall {
        at: At::new(at.x, at.y),
        velocity: [velocity.x, velocity.y],
        covariance: [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]],
        inliers: named(true),
        outliers: named(false),
    })
}

fn position_vector(witness: &BallMeasurement) -> Vector2<f32> {
    Vector2::new(witness.at.x, witness.at.y)
}
