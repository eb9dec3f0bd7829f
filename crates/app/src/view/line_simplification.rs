//! Which points of a line are needed? Those without which it would look different.

use std::f32::consts::PI;

use eframe::egui::{Pos2, Vec2};

/// Distance of a left-out point from the drawn line, pixels.
const TOLERANCE: f32 = 0.2;

/// Passes on the points that a line needs, in one pass. `pixel`: points per pixel.
///
/// From the last needed point, each further one allows a sector of directions, which the straight part must keep to. The
/// part ends where a point lies outside the sector of those before it.
pub(super) fn simplify(points: impl Iterator<Item = Pos2>, pixel: f32, mut push: impl FnMut(Pos2)) {
    let tolerance = TOLERANCE * pixel;
    let mut part: Option<Part> = None;
    for at in points {
        match &mut part {
            None => {
                push(at);
                part = Some(Part::from(at));
            }
            Some(straight) => {
                if !straight.extend(at, tolerance) {
                    push(straight.end);
                    let mut next = Part::from(straight.end);
                    next.extend(at, tolerance);
                    *straight = next;
                }
            }
        }
    }
    if let Some(part) = part.filter(|part| part.end != part.start) {
        push(part.end);
    }
}

/// A straight part of the line.
struct Part {
    start: Pos2,
    end: Pos2,
    /// Largest distance of its points from the start.
    reach: f32,
    /// Middle and half width of the allowed directions, radians. None while all are.
    sector: Option<[f32; 2]>,
}

impl Part {
    fn from(start: Pos2) -> Self {
        Part {
            start,
            end: start,
            reach: 0.0,
            sector: None,
        }
    }

    /// Takes a point; false if it does not lie on the straight part.
    fn extend(&mut self, at: Pos2, tolerance: f32) -> bool {
        let along = at - self.start;
        let distance = along.length();
        if distance <= tolerance && self.reach <= tolerance {
            self.end = at;
            return true;
        }
        if distance < self.reach {
            return false;
        }
        let (angle, width) = (Vec2::angle(along), (tolerance / distance).min(1.0).asin());
        let sector = match self.sector {
            None => [angle, width],
            Some([middle, half]) => {
                let turn = (angle - middle + PI).rem_euclid(2.0 * PI) - PI;
                if turn.abs() > half {
                    return false;
                }
                let (low, high) = ((-half).max(turn - width), half.min(turn + width));
                [middle + (low + high) / 2.0, (high - low) / 2.0]
            }
        };
        (self.sector, self.end, self.reach) = (Some(sector), at, distance);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn simplified(points: &[Pos2]) -> Vec<Pos2> {
        let mut kept = Vec::new();
        simplify(points.iter().copied(), 1.0, |at| kept.push(at));
        kept
    }

    /// Distance of a place from a line through points.
    fn distance(at: Pos2, line: &[Pos2]) -> f32 {
        let parts = line.windows(2).map(|ends| {
            let (along, to) = (ends[1] - ends[0], at - ends[0]);
            let share = (to.dot(along) / along.length_sq().max(1e-9)).clamp(0.0, 1.0);
            (to - share * along).length()
        });
        parts.fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn ends_and_corners_stay_and_points_between_go() {
        let corner = [[0.0, 0.0], [1.0, 0.0], [7.0, 0.1], [9.0, 0.0], [9.0, 5.0]];
        let kept = simplified(&corner.map(Pos2::from));
        assert_eq!(kept, [[0.0, 0.0], [9.0, 0.0], [9.0, 5.0]].map(Pos2::from));
        let spike = [[0.0, 0.0], [0.0, 5.0], [0.0, 1.0]].map(Pos2::from);
        assert_eq!(simplified(&spike), spike);
        assert_eq!(simplified(&[Pos2::ZERO]), [Pos2::ZERO]);
    }

    #[test]
    fn no_left_out_point_lies_off_the_simplified_line() {
        // Circles, waves and noise of many sizes: nothing of them is straight by construction.
        let mut state = 1u32;
        let mut noise = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        for shape in 0..60 {
            let size = 0.1 * 1.15f32.powi(shape);
            let points: Vec<Pos2> = (0..500)
                .map(|step| {
                    let angle = 0.03 * step as f32;
                    let wave = size * (7.0 * angle).sin() + 0.2 * size * noise();
                    Pos2::new(
                        size * angle.cos() + 0.1 * step as f32,
                        size * angle.sin() + wave,
                    )
                })
                .collect();
            let kept = simplified(&points);
            assert_eq!((kept.first(), kept.last()), (points.first(), points.last()));
            let worst = points
                .iter()
                .map(|at| distance(*at, &kept))
                .fold(0.0, f32::max);
            // The sector is one of directions: its chord may lie a little farther away.
            assert!(worst < 2.0 * TOLERANCE, "{worst} pixels at size {size}");
        }
    }
}
