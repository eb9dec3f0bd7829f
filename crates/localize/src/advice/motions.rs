//! Which motions are candidates? Rotations on the spot and straight displacements, quickest first.

use std::f32::consts::PI;

use super::AdviceConfig;
use crate::frames::{RobotFrame, Tf, wrap_angle};
use crate::math;

/// A motion of the robot: from its frame before to its frame after.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    pub(super) transform: Tf<RobotFrame, RobotFrame>,
    /// Time that it takes.
    pub(super) seconds: f32,
}

/// Directions of displacements, evenly around the robot.
const DIRECTIONS: usize = 12;
/// Distances of displacements, metres.
const DISTANCES: [f32; 8] = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0];
/// Rotations to either side, degrees.
const TURNS_DEG: [f32; 4] = [30.0, 60.0, 90.0, 180.0];

/// Largest angle between displacements that go on, radians.
const SAME_DIRECTION: f32 = PI / 4.0;
/// See `Motion::reluctance`.
const RELUCTANCE: f32 = 2.0;

impl Motion {
    /// Rotation, radians.
    pub(super) fn turn(&self) -> f32 {
        self.transform.theta
    }

    /// Factor of the time of a motion that does not go on in the direction advised before.
    pub(super) fn reluctance(&self, direction: Option<f32>) -> f32 {
        let origin = self.transform.origin();
        let goes_on = direction.is_none_or(|direction| {
            origin.distance() > 0.0
                && wrap_angle(origin.bearing() - direction).abs() < SAME_DIRECTION
        });
        if goes_on { 1.0 } else { RELUCTANCE }
    }
}

impl Default for Motion {
    fn default() -> Self {
        Motion {
            transform: Tf::new(0.0, 0.0, 0.0),
            seconds: 0.0,
        }
    }
}

/// All candidates, quickest first.
pub(super) fn candidate_motions(config: &AdviceConfig) -> Vec<Motion> {
    let turns = TURNS_DEG
        .iter()
        .flat_map(|&degrees| [degrees, -degrees])
        .map(|degrees| Motion {
            transform: Tf::new(0.0, 0.0, degrees.to_radians()),
            seconds: degrees.abs() / config.turn_rate_deg,
        });
    let drives = DISTANCES
        .iter()
        .filter(|&&distance| distance <= config.distance_max)
        .flat_map(|&distance| {
            (0..DIRECTIONS).map(move |k| {
                let (sin, cos) = math::sin_cos(2.0 * PI * k as f32 / DIRECTIONS as f32);
                Motion {
                    transform: Tf::new(distance * cos, distance * sin, 0.0),
                    seconds: distance / config.speed,
                }
            })
        });
    let mut motions: Vec<Motion> = turns.chain(drives).collect();
    motions.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    motions
}
