//! How far does the carpet reach where something on it ends a ray's view of it? A field's carpet is convex, so it fills the
//! convex hull of the ends that other rays see.

use std::f32::consts::TAU;

use localize::math;

/// Rays on each side of a ray that must agree with its end: through a net or beside a wall, single rays go astray.
const SUPPORT: usize = 2;
/// Fewest ends among these rays.
const ENDS_MIN: usize = 3;

/// An end of the carpet: its ray, counted on beyond a whole turn, and the inverse of its range. Where ranges are inverted,
/// a chord is a weighted mean of its ends.
type InverseEnd = (usize, f32);

/// Table of the angles between rays.
#[derive(Debug, Clone)]
pub(crate) struct CarpetHull {
    /// Sine of the angle of each number of rays.
    sines: Vec<f32>,
}

impl CarpetHull {
    /// For evenly spaced rays.
    pub(crate) fn new(ray_count: usize) -> Self {
        let sine = |rays: usize| math::sin(TAU * rays as f32 / ray_count as f32);
        CarpetHull {
            sines: (0..ray_count).map(sine).collect(),
        }
    }

    /// Range of the carpet's convex hull along each ray, metres; not nearer than the carpet's end.
    ///
    /// `carpet_end`: range of the end along each ray, infinite where none is seen.
    pub(crate) fn ranges(&self, carpet_end: &[f32]) -> Vec<f32> {
        let count = carpet_end.len();
        let mut ranges = carpet_end.to_vec();
        let ends: Vec<InverseEnd> = (0..count)
            .filter_map(|ray| Some((ray, 1.0 / supported_end(carpet_end, ray)?)))
            .collect();
        let farthest = (0..ends.len()).min_by(|&a, &b| ends[a].1.total_cmp(&ends[b].1));
        let Some(farthest) = farthest else {
            return ranges;
        };
        // Once around from the farthest end, which is a corner of the hull, and back to it.
        let turned = ends[farthest..].iter().copied();
        let wrapped = ends[..=farthest].iter();
        let wrapped = wrapped.map(|&(ray, inverse)| (ray + count, inverse));
        let mut corners: Vec<InverseEnd> = Vec::with_capacity(ends.len() + 1);
        for end in turned.chain(wrapped) {
            while let [.., before, last] = corners[..]
                && self
                    .chord(before, end, last.0)
                    .is_some_and(|chord| chord <= last.1)
            {
                corners.pop();
            }
            corners.push(end);
        }
        for &[before, after] in corners.array_windows() {
            for ray in before.0..=after.0 {
                if let Some(chord) = self.chord(before, after, ray) {
                    let range = &mut ranges[ray % count];
                    *range = range.max(1.0 / chord);
                }
            }
        }
        ranges
    }

    /// Inverse range at which a ray crosses the chord between two ends. None if they are half a turn apart or more: nothing
    /// is known of the carpet between them.
    fn chord(&self, before: InverseEnd, after: InverseEnd, ray: usize) -> Option<f32> {
        let between = after.0 - before.0;
        let is_known = between > 0 && 2 * between < self.sines.len();
        let sine = |rays: usize| self.sines[rays];
        is_known.then(|| {
            (before.1 * sine(after.0 - ray) + after.1 * sine(ray - before.0)) / sine(between)
        })
    }
}

/// The median of the ends that are seen about a ray. None if too few are.
fn supported_end(carpet_end: &[f32], ray: usize) -> Option<f32> {
    let count = carpet_end.len();
    let mut ends = [f32::INFINITY; 2 * SUPPORT + 1];
    for (offset, end) in ends.iter_mut().enumerate() {
        *end = carpet_end[(ray + count + offset - SUPPORT) % count];
    }
    let seen = ends.iter().filter(|end| end.is_finite()).count();
    ends.sort_unstable_by(f32::total_cmp);
    (seen >= ENDS_MIN && ends[(seen - 1) / 2] > 0.0).then(|| ends[(seen - 1) / 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT: usize = 180;

    fn hull_of(carpet_end: &[f32]) -> Vec<f32> {
        CarpetHull::new(carpet_end.len()).ranges(carpet_end)
    }

    /// Ends of a rectangle's sides at distances ahead, left, behind and right, metres.
    fn rectangle([ahead, left, behind, right]: [f32; 4]) -> Vec<f32> {
        let end = |ray: usize| {
            let (sin, cos) = math::sin_cos(TAU * ray as f32 / COUNT as f32);
            let along = if cos > 0.0 { ahead } else { behind } / cos;
            let across = if sin > 0.0 { left } else { right } / sin;
            along.abs().min(across.abs())
        };
        (0..COUNT).map(end).collect()
    }

    #[test]
    fn carpet_behind_an_obstacle_is_in_the_hull() {
        let whole = rectangle([3.0, 2.0, 5.0, 4.0]);
        let mut hidden = whole.clone();
        hidden[20..30].fill(0.8);
        hidden[95..100].fill(f32::INFINITY);
        let hull = hull_of(&hidden);
        for ray in 20..30 {
            assert!(
                (hull[ray] / whole[ray] - 1.0).abs() < 0.02,
                "{ray}: {} of {}",
                hull[ray],
                whole[ray]
            );
        }
        assert!(hull[95..100].iter().all(|range| range.is_infinite()));
    }

    #[test]
    fn hull_of_an_unhidden_carpet_is_its_border() {
        let whole = rectangle([3.0, 2.0, 5.0, 4.0]);
        for (hull, end) in hull_of(&whole).iter().zip(&whole) {
            assert!((hull / end - 1.0).abs() < 0.01, "{hull} of {end}");
        }
    }

    #[test]
    fn single_ray_beyond_the_carpet_does_not_extend_the_hull() {
        let whole = rectangle([3.0, 2.0, 5.0, 4.0]);
        let mut astray = whole.clone();
        (astray[40], astray[120]) = (9.0, 9.0);
        for (ray, (hull, end)) in hull_of(&astray).iter().zip(&whole).enumerate() {
            assert!(
                ray == 40 || ray == 120 || (hull / end - 1.0).abs() < 0.05,
                "{ray}: {hull} of {end}"
            );
        }
    }

    #[test]
    fn hull_says_nothing_of_half_a_turn_without_an_end() {
        let mut open = vec![2.0; COUNT];
        open[10..105].fill(f32::INFINITY);
        open[50] = 0.7;
        let hull = hull_of(&open);
        assert_eq!(hull[50], 0.7);
        assert!(hull[5] > 1.99 && hull[5] < 2.01);
        assert_eq!(hull_of(&[f32::INFINITY; 4]), [f32::INFINITY; 4]);
    }
}
