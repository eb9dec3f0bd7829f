//! Least squares fits of a straight line and of a circle to elements.

use nalgebra::{Matrix3, Vector3};

use super::elements::{BLOCKS, Element};
use crate::math;

/// A straight line without ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct StraightLine {
    pub(super) through: [f32; 2],
    /// Unit vector.
    pub(super) direction: [f32; 2],
}

/// A whole circle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Circle {
    pub(super) centre: [f32; 2],
    pub(super) radius: f32,
}

impl StraightLine {
    /// Coordinate along the line, metres.
    pub(super) fn along(&self, [x, y]: [f32; 2]) -> f32 {
        (x - self.through[0]) * self.direction[0] + (y - self.through[1]) * self.direction[1]
    }

    /// Signed distance, metres.
    pub(super) fn across(&self, [x, y]: [f32; 2]) -> f32 {
        (y - self.through[1]) * self.direction[0] - (x - self.through[0]) * self.direction[1]
    }

    /// The point at a coordinate.
    pub(super) fn at(&self, along: f32) -> [f32; 2] {
        [
            self.through[0] + along * self.direction[0],
            self.through[1] + along * self.direction[1],
        ]
    }

    /// The line with the least squared distances. None for fewer than two elements.
    pub(super) fn fit<'a>(elements: impl Iterator<Item = &'a Element>) -> Option<Self> {
        let [mut count, mut x, mut y, mut xx, mut xy, mut yy] = [0.0_f64; 6];
        for element in elements {
            let weight = f64::from(element.weight);
            let [ex, ey] = element.at.map(f64::from);
            count += weight;
            x += weight * ex;
            y += weight * ey;
            xx += weight * ex * ex;
            xy += weight * ex * ey;
            yy += weight * ey * ey;
        }
        if !(count > 0.0) {
            return None;
        }
        let (x, y) = (x / count, y / count);
        let (xx, xy, yy) = (xx / count - x * x, xy / count - x * y, yy / count - y * y);
        let (sin, cos) = math::sin_cos(0.5 * math::atan2(2.0 * xy, xx - yy));
        (xx + yy > 0.0).then_some(StraightLine {
            through: [x as f32, y as f32],
            direction: [cos as f32, sin as f32],
        })
    }
}

/// Steps of the fit of a circle.
const CIRCLE_STEPS: usize = 10;

impl Circle {
    /// The circle through two elements with these normals. None if they are parallel or the distances disagree.
    pub(super) fn through(a: &Element, b: &Element) -> Option<Self> {
        let ([ax, ay], [bx, by]) = (a.normal, b.normal);
        let cross = ax * by - ay * bx;
        if cross.abs() < 0.25 {
            return None;
        }
        let (dx, dy) = (b.at[0] - a.at[0], b.at[1] - a.at[1]);
        let along = (dx * by - dy * bx) / cross;
        let centre = [a.at[0] + along * ax, a.at[1] + along * ay];
        let radii =
            [a, b].map(|element| math::hypot(element.at[0] - centre[0], element.at[1] - centre[1]));
        let radius = 0.5 * (radii[0] + radii[1]);
        ((radii[0] - radii[1]).abs() < 0.1 * radius).then_some(Circle { centre, radius })
    }

    /// Signed distance outwards, metres.
    pub(super) fn across(&self, [x, y]: [f32; 2]) -> f32 {
        math::hypot(x - self.centre[0], y - self.centre[1]) - self.radius
    }

    /// Direction from the centre, radians.
    pub(super) fn angle(&self, [x, y]: [f32; 2]) -> f32 {
        math::atan2(y - self.centre[1], x - self.centre[0])
    }

    /// The circle with the least squared distances, from this one on, and the inverse of its normal matrix per element.
    pub(super) fn fit(mut self, elements: &[&Element]) -> Option<(Self, Matrix3<f64>)> {
        let mut inverse = Matrix3::zeros();
        for _ in 0..CIRCLE_STEPS {
            let mut normal = Matrix3::zeros();
            let mut gradient = Vector3::zeros();
            let total: f64 = elements
                .iter()
                .map(|element| f64::from(element.weight))
                .sum();
            for element in elements {
                let [x, y] = element.at;
                let distance = math::hypot(x - self.centre[0], y - self.centre[1]).max(1e-3);
                let row = Vector3::new(
                    f64::from(-(x - self.centre[0]) / distance),
                    f64::from(-(y - self.centre[1]) / distance),
                    -1.0,
                );
                let weight = f64::from(element.weight) / total;
                normal += weight * row * row.transpose();
                gradient += weight * f64::from(distance - self.radius) * row;
            }
            inverse = normal.try_inverse()?;
            let step = inverse * gradient;
            self.centre = [
                self.centre[0] - step[0] as f32,
                self.centre[1] - step[1] as f32,
            ];
            self.radius -= step[2] as f32;
        }
        (self.radius > 0.0).then_some((self, inverse))
    }
}

/// Standard deviation of a shape's place across it as one part of the drive has it, metres, and the number of parts.
///
/// The poses of successive keyframes share errors, so the parts count, not the points.
pub(super) fn std_of_parts(elements: &[&Element], across: impl Fn([f32; 2]) -> f32) -> (f32, f32) {
    let mut sums = [[0.0_f32; 2]; BLOCKS];
    for element in elements {
        for (sum, &[count, x, y]) in sums.iter_mut().zip(&element.blocks) {
            if count > 0.0 {
                sum[0] += count;
                sum[1] += count * across([x / count, y / count]);
            }
        }
    }
    let means: Vec<f32> = sums
        .iter()
        .filter(|[count, _]| *count >= 8.0)
        .map(|[count, sum]| sum / count)
        .collect();
    let count = means.len() as f32;
    if means.len() < 2 {
        return (UNKNOWN_STD, 1.0);
    }
    let mean = means.iter().sum::<f32>() / count;
    let squares: f32 = means
        .iter()
        .map(|value| (value - mean) * (value - mean))
        .sum();
    // A few parts may agree by chance.
    let prior = UNKNOWN_STD * UNKNOWN_STD;
    (((squares + prior) / count).sqrt(), count)
}

/// Standard deviation of a shape that one part of the drive saw, metres.
const UNKNOWN_STD: f32 = 0.03;
