//! Where do lines end? At the centre of the line that they meet.

use super::shape::Shape;
use crate::math;

/// Both ends of a line, and its standard deviation across it, metres.
type Ends = ([f32; 2], [f32; 2], f32);

/// Distance over which a line's end is moved to the line that it meets, metres.
const JOIN_DISTANCE: f32 = 0.25;

/// Moves the ends of lines to the lines that they meet: a painted line ends at another's centre.
pub(super) fn join_ends(shapes: &mut [Shape]) {
    let lines: Vec<Option<Ends>> = shapes
        .iter()
        .map(|shape| match *shape {
            Shape::Line {
                from,
                to,
                std_across,
                ..
            } => Some((from, to, std_across)),
            Shape::Arc { .. } => None,
        })
        .collect();
    for (index, shape) in shapes.iter_mut().enumerate() {
        let Shape::Line {
            from,
            to,
            std_along,
            ..
        } = shape
        else {
            continue;
        };
        let others = || {
            let others = lines
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != index);
            others.filter_map(|(_, line)| *line)
        };
        let ends = [(*from, *to), (*to, *from)].map(|(end, opposite)| {
            others()
                .filter_map(|(a, b, std)| Some((meeting_point(end, opposite, a, b)?, std)))
                .min_by(|(a, _), (b, _)| {
                    let off = |p: &[f32; 2]| math::hypot(p[0] - end[0], p[1] - end[1]);
                    off(a).total_cmp(&off(b))
                })
        });
        if let Some((at, _)) = ends[0] {
            *from = at;
        }
        if let Some((at, _)) = ends[1] {
            *to = at;
        }
        if let [Some((_, a)), Some((_, b))] = ends {
            *std_along = a.max(b);
        }
    }
}

/// Where a line's end meets another line, if it is near.
fn meeting_point(end: [f32; 2], opposite: [f32; 2], a: [f32; 2], b: [f32; 2]) -> Option<[f32; 2]> {
    let (ux, uy) = (end[0] - opposite[0], end[1] - opposite[1]);
    let (vx, vy) = (b[0] - a[0], b[1] - a[1]);
    let (u, v) = (math::hypot(ux, uy), math::hypot(vx, vy));
    let cross = ux * vy - uy * vx;
    if cross.abs() < 0.5 * u * v {
        return None;
    }
    let (dx, dy) = (a[0] - opposite[0], a[1] - opposite[1]);
    let along = (dx * vy - dy * vx) / cross;
    let at = [opposite[0] + along * ux, opposite[1] + along * uy];
    let on_other = ((at[0] - a[0]) * vx + (at[1] - a[1]) * vy) / v;
    let near = math::hypot(at[0] - end[0], at[1] - end[1]) <= JOIN_DISTANCE
        && (-JOIN_DISTANCE..=v + JOIN_DISTANCE).contains(&on_other);
    near.then_some(at)
}
