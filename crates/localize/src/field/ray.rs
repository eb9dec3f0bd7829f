//! At which distances does a ray over the field cross the markings?

use super::Marking;
use crate::math;

/// Distances (metres, unsorted) at which a ray crosses marking centre lines; `direction` is a unit vector, field frame.
pub(crate) fn intersect_ray(
    markings: &[Marking],
    from: [f32; 2],
    direction: [f32; 2],
    hits: &mut Vec<f32>,
) {
    hits.clear();
    for marking in markings {
        intersect_marking(marking, from, direction, hits);
    }
}

fn intersect_marking(marking: &Marking, [x, y]: [f32; 2], [ux, uy]: [f32; 2], hits: &mut Vec<f32>) {
    match *marking {
        Marking::Line { from, to } => {
            let (ex, ey) = (to.x - from.x, to.y - from.y);
            let cross = ux * ey - uy * ex;
            if cross.abs() < 1e-6 {
                return;
            }
            let (fx, fy) = (from.x - x, from.y - y);
            let along = (fx * ey - fy * ex) / cross;
            let part = (fx * uy - fy * ux) / cross;
            if along > 0.0 && (0.0..=1.0).contains(&part) {
                hits.push(along);
            }
        }
        Marking::Arc {
            centre,
            radius,
            start,
            sweep,
        } => {
            let (cx, cy) = (x - centre.x, y - centre.y);
            let half = cx * ux + cy * uy;
            let square = half * half - (cx * cx + cy * cy - radius * radius);
            if square <= 0.0 {
                return;
            }
            for along in [-half - square.sqrt(), -half + square.sqrt()] {
                let angle = math::atan2(cy + along * uy, cx + along * ux) - start;
                if along > 0.0 && angle.rem_euclid(std::f32::consts::TAU) <= sweep {
                    hits.push(along);
                }
            }
        }
        Marking::Spot { centre, radius } => {
            let along = (centre.x - x) * ux + (centre.y - y) * uy;
            let across = (centre.x - x) * uy - (centre.y - y) * ux;
            if along > 0.0 && across.abs() < radius {
                hits.push(along);
            }
        }
    }
}
