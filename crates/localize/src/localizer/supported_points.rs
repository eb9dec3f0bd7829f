//! Which line points have others beside them? Markings give rows of points, clutter single ones.
//!
//! A search that knows no pose counts what supports a place. A few single points on markings that the image does not show
//! would fix a direction that the others leave open (docs/methods.md 9.2).

use crate::sample::LinePoint;

/// A point has support if its second neighbour is nearer than this multiple of the median over all points.
const SPACING_RATIO: f32 = 3.0;

/// The points with support.
pub(super) fn supported_points(points: &[LinePoint]) -> Vec<LinePoint> {
    let spacing: Vec<f32> = points
        .iter()
        .map(|point| second_neighbour_squared(point, points))
        .collect();
    let mut sorted = spacing.clone();
    sorted.sort_by(f32::total_cmp);
    let Some(median) = sorted.get(sorted.len() / 2) else {
        return Vec::new();
    };
    let limit = SPACING_RATIO * SPACING_RATIO * median;
    points
        .iter()
        .zip(&spacing)
        .filter(|(_, spacing)| **spacing <= limit)
        .map(|(point, _)| *point)
        .collect()
}

/// Squared distance from a point to the second nearest other one, m².
fn second_neighbour_squared(point: &LinePoint, points: &[LinePoint]) -> f32 {
    // The point itself is the nearest.
    let mut nearest = [f32::INFINITY; 3];
    for other in points {
        let (dx, dy) = (other.at.x - point.at.x, other.at.y - point.at.y);
        let mut squared = dx * dx + dy * dy;
        for place in &mut nearest {
            if squared < *place {
                std::mem::swap(place, &mut squared);
            }
        }
    }
    nearest[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::At;

    fn point(x: f32, y: f32) -> LinePoint {
        LinePoint {
            at: At::new(x, y),
            std_radial: 0.04,
            std_tangential: 0.04,
        }
    }

    #[test]
    fn rows_of_points_are_kept_and_single_points_are_not() {
        let mut points: Vec<LinePoint> = (0..30).map(|k| point(2.0, 0.1 * k as f32)).collect();
        points.extend([point(-1.0, 0.5), point(0.5, -2.0), point(-0.5, 2.0)]);
        let supported = supported_points(&points);
        assert_eq!(supported.len(), 30);
        assert!(supported.iter().all(|point| point.at.x == 2.0));
    }

    #[test]
    fn sparse_points_support_each_other() {
        let points: Vec<LinePoint> = (0..8).map(|k| point(1.0, 0.8 * k as f32)).collect();
        assert_eq!(supported_points(&points).len(), 8);
        assert!(supported_points(&[]).is_empty());
        assert_eq!(supported_points(&points[..1]).len(), 1);
    }
}
