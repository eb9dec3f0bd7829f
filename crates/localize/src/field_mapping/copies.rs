//! Does a map contradict itself? Two nearly parallel lines close beside one another are mostly one line, mapped twice.

use super::fit::StraightLine;
use super::shape::Shape;

/// Distance below which parallel lines are taken for copies, metres: floors have few lines so close together.
const DISTANCE_MAX: f32 = 0.6;
/// Least cosine between their directions.
const PARALLEL_MIN: f32 = 0.97;
/// Least length over which they lie beside one another, metres.
const BESIDE_MIN: f32 = 0.5;

/// Number of lines with a longer one close beside them.
pub(super) fn count(shapes: &[Shape]) -> usize {
    let is_copy = |shape: &&Shape| {
        let mut longer = shapes
            .iter()
            .filter(|other| other.length() > shape.length());
        longer.any(|other| lies_beside(shape, other))
    };
    shapes.iter().filter(is_copy).count()
}

fn lies_beside(shape: &Shape, other: &Shape) -> bool {
    let (
        Shape::Line { from, to, .. },
        Shape::Line {
            from: through,
            to: end,
            ..
        },
    ) = (shape, other)
    else {
        return false;
    };
    let (length, own) = (other.length().max(1e-6), shape.length().max(1e-6));
    let direction = [0, 1].map(|k: usize| (end[k] - through[k]) / length);
    let line = StraightLine {
        through: *through,
        direction,
    };
    let [a, b] = [line.along(*from), line.along(*to)];
    let beside = a.max(b).min(length) - a.min(b).max(0.0);
    let distance = 0.5 * (line.across(*from) + line.across(*to)).abs();
    beside >= BESIDE_MIN && (b - a).abs() >= PARALLEL_MIN * own && distance <= DISTANCE_MAX
}
