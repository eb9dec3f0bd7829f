//! Which strokes may a block see? Compares the block's box on the floor with boxes around strokes, eight at a time, and
//! merges pieces of a cable that is far.

use super::cables::{Cable, merge};
use super::lanes::{LANES, Vector, splat};
use super::strokes::{Area, Shape, Stroke};

/// Largest displacement of a cable by merged pieces, over the smaller side of a footprint, which is some pixels wide.
const MERGE_ERROR: f32 = 0.05;
/// Half a side of what fills up the last lanes: no area touches it.
const NOWHERE: f32 = -1e9;

/// Boxes around strokes.
#[derive(Default)]
pub(super) struct StrokeCulling {
    lines: Vec<Lines>,
    rings: Vec<Rings>,
    bundles: Vec<Bundle>,
    /// Boxes around the bundles.
    around_bundles: Vec<BoxLanes>,
}

/// Neighbouring pieces of a cable, up to `LANES`, and what they are merged to: two, four and eight of them in one.
struct Bundle {
    levels: [Lines; 4],
    /// How far each level is displaced from the pieces, metres.
    errors: [f32; 4],
    /// A box around all of them.
    around: Area,
    /// The level in use.
    level: usize,
}

/// Straight strokes, the first of which has this number.
struct Lines {
    first: u32,
    boxes: BoxLanes,
}

/// Arcs, and discs as arcs without a radius.
struct Rings {
    first: u32,
    centre: [Vector; 2],
    radius: Vector,
    half: Vector,
}

/// `LANES` boxes: centres, directions of their first sides, half their sides.
struct BoxLanes {
    centre: [Vector; 2],
    axis: [Vector; 2],
    half: [Vector; 2],
}

/// An area in all lanes, and half its diagonal.
struct AreaLanes {
    centre: [Vector; 2],
    axis: [Vector; 2],
    half: [Vector; 2],
    half_diagonal: Vector,
}

impl StrokeCulling {
    /// Adds strokes to those of a list.
    pub(super) fn add(&mut self, strokes: &[Stroke], list: &mut Vec<Stroke>) {
        let (lines, rings): (Vec<Stroke>, Vec<Stroke>) =
            (strokes.iter()).partition(|stroke| matches!(stroke.shape, Shape::Line { .. }));
        self.lines
            .extend(lines.chunks(LANES).map(|lines| Lines::new(lines, list)));
        self.rings
            .extend(rings.chunks(LANES).map(|rings| Rings::new(rings, list)));
    }

    /// Adds the pieces of cables to the strokes of a list.
    pub(super) fn add_cables(&mut self, cables: &[Cable], list: &mut Vec<Stroke>) {
        for cable in cables {
            let runs = cable.runs(LANES);
            self.bundles
                .extend(runs.filter_map(|points| Bundle::new(points, cable.width, list)));
        }
        let around: Vec<Area> = self.bundles.iter().map(|bundle| bundle.around).collect();
        self.around_bundles = around.chunks(LANES).map(BoxLanes::new).collect();
    }

    /// Merges pieces of cables for a view from a point. `footprint`: the smaller side of a footprint over its distance.
    pub(super) fn merge_cables(&mut self, [x, y]: [f32; 2], footprint: f32) {
        for bundle in &mut self.bundles {
            let Area { centre, axis, half } = bundle.around;
            let (dx, dy) = (x - centre[0], y - centre[1]);
            let along = (dx * axis[0] + dy * axis[1]).abs() - half[0];
            let across = (dy * axis[0] - dx * axis[1]).abs() - half[1];
            let distance = along.max(0.0).hypot(across.max(0.0));
            let error_max = MERGE_ERROR * footprint * distance;
            let level = bundle.errors.iter().rposition(|error| *error <= error_max);
            bundle.level = level.unwrap_or(0);
        }
    }

    /// The strokes that may touch an area.
    pub(super) fn find(&self, area: &Area, found: &mut Vec<u32>) {
        found.clear();
        let [along, across] = area.half;
        let area = &AreaLanes {
            centre: area.centre.map(splat),
            axis: area.axis.map(splat),
            half: area.half.map(splat),
            half_diagonal: splat((along * along + across * across).sqrt()),
        };
        for lines in &self.lines {
            push_lanes(lines.boxes.touching(area), lines.first, found);
        }
        for rings in &self.rings {
            push_lanes(rings.touching(area), rings.first, found);
        }
        for (around, bundles) in (self.around_bundles.iter()).zip(self.bundles.chunks(LANES)) {
            let mut touching = around.touching(area);
            while touching != 0 {
                let bundle = &bundles[touching.trailing_zeros() as usize];
                let lines = &bundle.levels[bundle.level];
                push_lanes(lines.boxes.touching(area), lines.first, found);
                touching &= touching - 1;
            }
        }
    }
}

impl Bundle {
    /// The pieces between some points of a cable of a width, added to a list.
    fn new(points: &[[f32; 2]], width: f32, list: &mut Vec<Stroke>) -> Option<Self> {
        let half = width / 2.0;
        let mut errors = [0.0f32; 4];
        let levels = [0, 1, 2, 3].map(|level| {
            let starts = (0..points.len() - 1).step_by(1 << level);
            let pieces: Vec<Stroke> = starts
                .map(|first| {
                    let last = (first + (1 << level)).min(points.len() - 1);
                    let (line, error) = merge(&points[first..=last]);
                    errors[level] = errors[level].max(error);
                    Stroke::new(&line, half, true)
                })
                .collect();
            Lines::new(&pieces, list)
        });
        let (line, error) = merge(points);
        Some(Bundle {
            levels,
            errors,
            around: Stroke::new(&line, half + error, true).area()?,
            level: 0,
        })
    }
}

impl Lines {
    /// Adds lines to a list.
    fn new(lines: &[Stroke], list: &mut Vec<Stroke>) -> Self {
        let first = list.len() as u32;
        list.extend_from_slice(lines);
        let areas: Vec<Area> = lines.iter().filter_map(Stroke::area).collect();
        Lines {
            first,
            boxes: BoxLanes::new(&areas),
        }
    }
}

impl Rings {
    /// Adds arcs and discs to a list.
    fn new(rings: &[Stroke], list: &mut Vec<Stroke>) -> Self {
        let first = list.len() as u32;
        list.extend_from_slice(rings);
        let circle = |stroke: &Stroke| match stroke.shape {
            Shape::Arc { centre, radius, .. } => (centre, radius),
            Shape::Disc { centre } => (centre, 0.0),
            Shape::Line { middle, .. } => (middle, 0.0),
        };
        Rings {
            first,
            centre: [0, 1].map(|k| lanes_of(rings, |stroke| circle(stroke).0[k], 0.0)),
            radius: lanes_of(rings, |stroke| circle(stroke).1, 0.0),
            half: lanes_of(rings, |stroke| stroke.half, NOWHERE),
        }
    }

    /// Bits of those that may touch an area.
    #[inline(always)]
    fn touching(&self, area: &AreaLanes) -> u32 {
        let [dx, dy] = [0, 1].map(|k| area.centre[k] - self.centre[k]);
        let [ux, uy] = area.axis;
        let distance = dx.mul_add(dx, dy * dy).sqrt().fast_max(splat(1e-6));
        let (on_axis, off_axis) = (
            dx.mul_add(ux, dy * uy).abs(),
            dy.mul_add(ux, -(dx * uy)).abs(),
        );
        // The area lies between two lines across the direction to its centre; within them, points off that
        // direction are farther from the arc's centre.
        let reach = area.half[0].mul_add(on_axis, area.half[1] * off_axis) / distance;
        let outside = self.radius + self.half - (distance - reach);
        let inside = distance + area.half_diagonal - (self.radius - self.half);
        positive_lanes(outside.fast_min(inside))
    }
}

impl BoxLanes {
    fn new(areas: &[Area]) -> Self {
        BoxLanes {
            centre: [0, 1].map(|k| lanes_of(areas, |area| area.centre[k], 0.0)),
            axis: [0, 1].map(|k| lanes_of(areas, |area| area.axis[k], 0.0)),
            half: [0, 1].map(|k| lanes_of(areas, |area| area.half[k], NOWHERE)),
        }
    }

    /// Bits of the boxes that an area touches: no side of either separates them.
    #[inline(always)]
    fn touching(&self, area: &AreaLanes) -> u32 {
        let [dx, dy] = [0, 1].map(|k| area.centre[k] - self.centre[k]);
        let ([ax, ay], [along, across]) = (area.axis, area.half);
        let ([ux, uy], [half_u, half_v]) = (self.axis, self.half);
        let (cos, sin) = (
            ax.mul_add(ux, ay * uy).abs(),
            ay.mul_add(ux, -(ax * uy)).abs(),
        );
        let overlap = |offset: Vector, half: Vector, first: Vector, second: Vector| {
            cos.mul_add(first, sin.mul_add(second, half)) - offset.abs()
        };
        positive_lanes(
            overlap(dx.mul_add(ux, dy * uy), half_u, along, across)
                .fast_min(overlap(dy.mul_add(ux, -(dx * uy)), half_v, across, along))
                .fast_min(overlap(dx.mul_add(ax, dy * ay), along, half_u, half_v))
                .fast_min(overlap(dy.mul_add(ax, -(dx * ay)), across, half_v, half_u)),
        )
    }
}

/// A value of each item; beyond the last one the same value.
fn lanes_of<T>(items: &[T], of: impl Fn(&T) -> f32, beyond: f32) -> Vector {
    Vector::new(std::array::from_fn(|lane| {
        items.get(lane).map_or(beyond, &of)
    }))
}

#[inline(always)]
fn positive_lanes(of: Vector) -> u32 {
    of.simd_gt(splat(0.0)).to_bitmask()
}

/// Appends the numbers of the set lanes.
#[inline(always)]
fn push_lanes(mut lanes: u32, first: u32, found: &mut Vec<u32>) {
    while lanes != 0 {
        found.push(first + lanes.trailing_zeros());
        lanes &= lanes - 1;
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::cables::lay_cables;
    use super::*;
    use crate::environment::EnvironmentConfig;

    /// Cables on a field of 18 × 12 m.
    fn cables() -> (StrokeCulling, Vec<Stroke>) {
        let environment = EnvironmentConfig {
            cables: 8,
            ..EnvironmentConfig::default()
        };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut culling, mut list) = (StrokeCulling::default(), Vec::new());
        culling.add_cables(&lay_cables(&environment, [10.0, 7.0], &mut rng), &mut list);
        (culling, list)
    }

    /// Distance of a point from a stroke's middle line.
    fn distance(stroke: &Stroke, [x, y]: [f32; 2]) -> f32 {
        let Area { centre, axis, half } = stroke.area().expect("a line");
        let (dx, dy) = (x - centre[0], y - centre[1]);
        let along = dx * axis[0] + dy * axis[1];
        let past_end = (along.abs() - half[0]).max(0.0);
        past_end.hypot(dy * axis[0] - dx * axis[1])
    }

    #[test]
    fn strokes_are_found_at_all_points_of_areas_that_they_cover() {
        let (culling, list) = cables();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut found, mut covered) = (Vec::new(), 0);
        for _ in 0..2000 {
            let mut random = |from: f32, to: f32| from + (to - from) * rng.random::<f32>();
            let (sin, cos) = random(-3.0, 3.0).sin_cos();
            let area = Area {
                centre: [random(-10.0, 10.0), random(-7.0, 7.0)],
                axis: [cos, sin],
                half: [random(0.01, 2.0), random(0.01, 0.4)],
            };
            culling.find(&area, &mut found);
            let [u, v] = area.half.map(|half| random(-half, half));
            let point = [
                area.centre[0] + u * cos - v * sin,
                area.centre[1] + u * sin + v * cos,
            ];
            for bundle in &culling.bundles {
                let end = bundle.levels[1].first;
                for stroke in bundle.levels[0].first..end {
                    let inside = distance(&list[stroke as usize], point) < 0.01;
                    covered += usize::from(inside);
                    assert!(!inside || found.contains(&stroke), "{area:?}");
                }
            }
        }
        assert!(covered > 10, "{covered}");
    }

    #[test]
    fn merged_cables_are_fewer_pieces_displaced_by_less_than_a_tenth_of_a_footprint() {
        let (mut culling, list) = cables();
        let everywhere = Area {
            centre: [0.0; 2],
            axis: [1.0, 0.0],
            half: [100.0; 2],
        };
        let (mut pieces, mut merged) = (Vec::new(), Vec::new());
        culling.find(&everywhere, &mut pieces);
        let (robot, footprint) = ([3.0, -2.0], 0.012);
        culling.merge_cables(robot, footprint);
        culling.find(&everywhere, &mut merged);
        assert!(
            3 * merged.len() < 2 * pieces.len(),
            "{} of {}",
            merged.len(),
            pieces.len()
        );
        for piece in pieces {
            let [x, y] = list[piece as usize].area().expect("a line").centre;
            let strokes = merged.iter().map(|stroke| &list[*stroke as usize]);
            let off = strokes.fold(f32::MAX, |least, stroke| {
                least.min(distance(stroke, [x, y]))
            });
            let range = (x - robot[0]).hypot(y - robot[1]);
            assert!(off <= 0.1 * footprint * range, "{off} m at {range} m");
        }
    }
}
