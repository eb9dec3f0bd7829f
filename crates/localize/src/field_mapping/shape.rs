//! A line or an arc of the map.

use super::fit::{Circle, StraightLine};
use crate::math;

/// A line or an arc on the map, with standard deviations in metres.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    Line {
        from: [f32; 2],
        to: [f32; 2],
        /// Across the line, at its middle.
        std_across: f32,
        /// Of its ends, along it.
        std_along: f32,
    },
    Arc {
        centre: [f32; 2],
        radius: f32,
        /// Radians.
        start: f32,
        sweep: f32,
        /// Of centre (x, y) and radius.
        std: [f32; 3],
    },
}

impl Shape {
    pub(super) fn length(&self) -> f32 {
        match self {
            Shape::Line { from, to, .. } => math::hypot(to[0] - from[0], to[1] - from[1]),
            Shape::Arc { radius, sweep, .. } => radius * sweep,
        }
    }

    /// Distance of a point, metres.
    pub(super) fn distance(&self, at: [f32; 2]) -> f32 {
        match *self {
            Shape::Line { from, to, .. } => {
                let length = self.length().max(1e-6);
                let direction = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
                let line = StraightLine {
                    through: from,
                    direction,
                };
                let along = line.along(at);
                let beyond = (-along).max(along - length).max(0.0);
                math::hypot(line.across(at), beyond)
            }
            Shape::Arc {
                centre,
                radius,
                start,
                sweep,
                ..
            } => {
                let circle = Circle { centre, radius };
                let turned = (circle.angle(at) - start).rem_euclid(std::f32::consts::TAU);
                let beyond = (turned - sweep)
                    .max(0.0)
                    .min(std::f32::consts::TAU - turned);
                let beyond = if turned <= sweep { 0.0 } else { beyond };
                math::hypot(circle.across(at), radius * beyond)
            }
        }
    }
}
