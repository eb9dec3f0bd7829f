//! How much of an object is visible? The share of its directions in which nothing is in front of it.
//!
//! Vision detects only the first obstacle of each direction, so occluded objects are not scored.

use std::f32::consts::TAU;

use localize::frames::{At, RobotFrame};
use localize::math;
use sim::Sector;

/// Number of directions. Their spacing, 0.25°, is 2 cm at 4 m.
const DIRECTIONS: usize = 1440;

/// Footprint of an upright object on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Its centre.
    pub at: At<RobotFrame>,
    /// Its outline.
    pub outline: BodyOutline,
}

/// A body's outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BodyOutline {
    /// Radius in metres.
    Circle(f32),
    /// Half its side in metres, and its heading in radians, robot frame.
    Square(f32, f32),
}

/// The visible part of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility {
    /// Share of its directions in which nothing is in front of it.
    pub visible_fraction: f32,
    /// Distance of the nearest visible point, metres; infinite if none is.
    pub nearest_distance: f32,
}

impl Body {
    /// Length of a ray from the robot to the body. None if it misses.
    fn ray_distance(&self, [x, y]: [f32; 2]) -> Option<f32> {
        match self.outline {
            BodyOutline::Circle(radius) => {
                let along = self.at.x * x + self.at.y * y;
                let across = self.at.x * y - self.at.y * x;
                let half2 = radius * radius - across * across;
                (half2 >= 0.0 && along > 0.0).then(|| (along - half2.sqrt()).max(0.0))
            }
            BodyOutline::Square(half, heading) => {
                let (sin, cos) = math::sin_cos(heading);
                let in_body = |x: f32, y: f32| [cos * x + sin * y, cos * y - sin * x];
                let (to, towards) = (in_body(self.at.x, self.at.y), in_body(x, y));
                let (mut enters, mut leaves) = (0.0f32, f32::INFINITY);
                for (to, towards) in to.into_iter().zip(towards) {
                    // Avoids a division by zero for a ray parallel to a side.
                    let towards = towards.abs().max(1e-6).copysign(towards);
                    let sides = [(to - half) / towards, (to + half) / towards];
                    enters = enters.max(sides[0].min(sides[1]));
                    leaves = leaves.min(sides[0].max(sides[1]));
                }
                (enters <= leaves).then_some(enters)
            }
        }
    }
}

/// The visible part of each body. `covered`: covered sectors.
pub fn body_visibilities(bodies: &[Body], covered: &[Sector]) -> Vec<Visibility> {
    let mut spans = vec![(0u32, 0u32); bodies.len()];
    let mut nearest = vec![f32::INFINITY; bodies.len()];
    for direction in 0..DIRECTIONS {
        let angle = TAU * direction as f32 / DIRECTIONS as f32;
        let (sin, cos) = math::sin_cos(angle);
        let ranges: Vec<f32> = bodies
            .iter()
            .map(|body| body.ray_distance([cos, sin]).unwrap_or(f32::INFINITY))
            .collect();
        let first = ranges.iter().copied().fold(f32::INFINITY, f32::min);
        let hidden = covered.iter().any(|sector| sector.contains(angle));
        for (index, &range) in ranges
            .iter()
            .enumerate()
            .filter(|(_, range)| range.is_finite())
        {
            let visible = range <= first && !hidden;
            spans[index].0 += u32::from(visible);
            spans[index].1 += 1;
            if visible {
                nearest[index] = nearest[index].min(range);
            }
        }
    }
    let share = |(visible, all): (u32, u32)| visible as f32 / all.max(1) as f32;
    spans
        .into_iter()
        .zip(nearest)
        .map(|(span, nearest)| Visibility {
            visible_fraction: share(span),
            nearest_distance: nearest,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f32, y: f32) -> Body {
        Body {
            at: At::new(x, y),
            outline: BodyOutline::Square(0.25, 0.0),
        }
    }

    #[test]
    fn only_the_robot_behind_another_is_occluded() {
        let visibilities =
            body_visibilities(&[square(1.0, 0.0), square(3.0, 0.0), square(0.0, 2.0)], &[]);
        assert_eq!(
            [
                visibilities[0].visible_fraction,
                visibilities[1].visible_fraction,
                visibilities[2].visible_fraction
            ],
            [1.0, 0.0, 1.0]
        );
        assert!(
            (visibilities[0].nearest_distance - 0.75).abs() < 1e-3
                && (visibilities[2].nearest_distance - 1.75).abs() < 1e-3
        );
        assert!(visibilities[1].nearest_distance.is_infinite());
    }

    #[test]
    fn partially_occluded_robot_is_half_visible() {
        let visibilities = body_visibilities(&[square(2.0, 0.25), square(4.0, 0.0)], &[]);
        assert!(
            (0.3..0.7).contains(&visibilities[1].visible_fraction),
            "{}",
            visibilities[1].visible_fraction
        );
    }

    #[test]
    fn occluded_sector_hides_bodies_and_a_corner_is_the_nearest_point() {
        let turned = Body {
            outline: BodyOutline::Square(0.25, std::f32::consts::FRAC_PI_4),
            ..square(2.0, 0.0)
        };
        assert_eq!(
            body_visibilities(
                &[turned],
                &[Sector {
                    centre: 0.1,
                    width: 1.0
                }]
            )[0]
            .visible_fraction,
            0.0
        );
        let corner = body_visibilities(&[turned], &[])[0].nearest_distance;
        assert!(
            (corner - (2.0 - 0.25 * 2f32.sqrt())).abs() < 0.01,
            "{corner}"
        );
    }
}
