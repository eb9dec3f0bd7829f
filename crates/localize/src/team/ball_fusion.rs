//! Which ball measurements agree? The largest consistent group, fused by inverse covariances (docs/methods.md 12.2).

use nalgebra::{Matrix2, Vector2};

use super::config::TeamConfig;
use crate::frames::{At, FieldFrame};

/// One robot's ball, predicted to the current image (field frame).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallMeasurement {
    /// Number of the robot.
    pub robot: u32,
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
}

/// The team's fused ball.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamBall {
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance of the position: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Numbers of the robots whose ball was fused, our own included, sorted.
    pub inliers: Vec<u32>,
    /// Numbers of the robots whose ball disagrees, sorted.
    pub outliers: Vec<u32>,
}

/// Further measurements are ignored: there are at most 2^13 groups.
const MEASUREMENTS_MAX: usize = 13;

/// Fuses the largest group of measurements that agree pairwise; None without measurements.
///
/// Of groups of equal size the one with robot `own` is taken, then the one with the most information.
pub fn fuse_balls(
    measurements: &[BallMeasurement],
    own: u32,
    config: &TeamConfig,
) -> Option<TeamBall> {
    let measurements = &measurements[..measurements.len().min(MEASUREMENTS_MAX)];
    let covariances: Vec<Matrix2<f32>> = measurements
        .iter()
        .map(|measurement| {
            let [xx, xy, yy] = measurement.covariance;
            Matrix2::new(xx, xy, xy, yy)
                + Matrix2::identity() * config.position_std_min * config.position_std_min
        })
        .collect();
    let count = measurements.len();
    // Bit j of agreeing[i] is set if measurements i and j are consistent.
    let agreeing: Vec<u32> = (0..count)
        .map(|i| {
            let agrees = |j: usize| {
                let off = position_vector(&measurements[i]) - position_vector(&measurements[j]);
                let inverse = (covariances[i] + covariances[j]).try_inverse();
                i == j || inverse.is_some_and(|k| (off.transpose() * k * off).x <= config.gate)
            };
            (0..count).filter(|&j| agrees(j)).map(|j| 1 << j).sum()
        })
        .collect();
    let own_bits: u32 = (0..count)
        .filter(|&i| measurements[i].robot == own)
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
        let better = best.is_none_or(|(best_group, best_information)| {
            let rank = |group: u32| (group.count_ones(), group & own_bits != 0);
            rank(group) > rank(best_group)
                || rank(group) == rank(best_group)
                    && information.determinant() > best_information.determinant()
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
        at += weight * position_vector(&measurements[i]);
        velocity += weight * Vector2::from(measurements[i].velocity);
    }
    let robot_numbers = |within: bool| {
        let mut robots: Vec<u32> = (0..count)
            .filter(|i| (group >> i & 1 == 1) == within)
            .map(|i| measurements[i].robot)
            .collect();
        robots.sort_unstable();
        robots
    };
    Some(TeamBall {
        at: At::new(at.x, at.y),
        velocity: [velocity.x, velocity.y],
        covariance: [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]],
        inliers: robot_numbers(true),
        outliers: robot_numbers(false),
    })
}

fn position_vector(measurement: &BallMeasurement) -> Vector2<f32> {
    Vector2::new(measurement.at.x, measurement.at.y)
}
