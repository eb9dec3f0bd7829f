//! How much of a footprint is white paint or a black cable? Exact for a straight edge through a parallelogram's projection.

use std::f32::consts::FRAC_PI_2;

use localize::field::Field;

use super::cables::Cable;
use super::lanes::{BlockValues, LANES, Vector, reciprocal_sqrt, shares, splat};
use super::stroke_culling::StrokeCulling;
use super::strokes::{Area, Shape, Stroke, painted_markings};

/// Width of the optics' blur on the floor over that of a box of the footprint's size. Its variance is twice the box's.
pub(super) const PAINT_BLUR: f32 = std::f32::consts::SQRT_2;

/// Least width of a footprint, metres.
pub(super) const WIDTH_MIN: f32 = 1e-4;

/// Paint and cables on a field.
pub(super) struct Paint {
    strokes: Vec<Stroke>,
    culling: StrokeCulling,
}

/// Ground points of a block in the field frame, and their footprints.
pub(super) struct GroundBlock {
    /// Metres.
    pub(super) at: [BlockValues; 2],
    /// Directions of the rays, unit vectors, field frame.
    pub(super) direction: [BlockValues; 2],
    /// Squares of the footprint's sides along and across the direction, m².
    pub(super) along2: BlockValues,
    pub(super) across2: BlockValues,
    /// Half of the footprint's larger side, metres.
    pub(super) half_width: BlockValues,
}

impl GroundBlock {
    pub(super) fn new() -> Self {
        let zero = [[0.0; LANES]; LANES];
        GroundBlock {
            at: [zero; 2],
            direction: [zero; 2],
            along2: zero,
            across2: zero,
            half_width: zero,
        }
    }

    /// Vectors from a point of the field to a row's points.
    #[inline(always)]
    fn offsets_from(&self, row: usize, point: [f32; 2]) -> [Vector; 2] {
        [0, 1].map(|k| Vector::new(self.at[k][row]) - splat(point[k]))
    }

    /// Distances of a row's points from a point.
    #[inline(always)]
    fn distances_from(&self, row: usize, point: [f32; 2]) -> (Vector, [Vector; 2]) {
        let [dx, dy] = self.offsets_from(row, point);
        let distance = dx.mul_add(dx, dy * dy).sqrt() + splat(WIDTH_MIN);
        (distance, [dx, dy])
    }

    /// Reciprocals of the widths of a row's footprints along a direction (unit vector) and across it, 1/m.
    #[inline(always)]
    pub(super) fn per_width(&self, row: usize, nx: Vector, ny: Vector) -> [Vector; 2] {
        let [tx, ty] = [0, 1].map(|k| Vector::new(self.direction[k][row]));
        let [along2, across2] = [&self.along2, &self.across2].map(|of| Vector::new(of[row]));
        let cross = tx * ny - ty * nx;
        // The squares of both widths have the sum of the squares of both sides.
        let square = (across2 - along2).mul_add(cross * cross, along2);
        let least = splat(WIDTH_MIN * WIDTH_MIN);
        [square, along2 + across2 - square].map(|square| reciprocal_sqrt(square.fast_max(least)))
    }

    /// True if a footprint of a row may reach what is at some distances from the points.
    #[inline(always)]
    fn reaches(&self, row: usize, distances: Vector) -> bool {
        let gaps = distances - Vector::new(self.half_width[row]);
        gaps.simd_lt(splat(0.0)).any()
    }
}

impl Paint {
    pub(super) fn new(field: &Field, cables: &[Cable]) -> Self {
        let half = field.config.line_width / 2.0;
        let markings = painted_markings(field);
        let white: Vec<Stroke> = (markings.iter())
            .map(|marking| Stroke::new(marking, half, false))
            .collect();
        let (mut strokes, mut culling) = (Vec::new(), StrokeCulling::default());
        culling.add(&white, &mut strokes);
        culling.add_cables(cables, &mut strokes);
        Paint { strokes, culling }
    }

    /// Half sides of a box around the field's centre that holds all strokes.
    pub(super) fn half_extent(&self) -> [f32; 2] {
        let corners = self.strokes.iter().flat_map(Stroke::bounds);
        corners.fold([0.0; 2], |half: [f32; 2], corner| {
            [0, 1].map(|k| half[k].max(corner[k].abs()))
        })
    }

    /// Merges pieces of cables for a view from a point. `footprint`: the smaller side of a footprint over its distance.
    pub(super) fn merge_cables(&mut self, from: [f32; 2], footprint: f32) {
        self.culling.merge_cables(from, footprint);
    }

    /// Finds the strokes that may touch an area.
    pub(super) fn find(&self, area: &Area, found: &mut Vec<u32>) {
        self.culling.find(area, found);
    }

    /// The shares of each footprint that some strokes cover: white paint, and black cables on it.
    pub(super) fn cover(
        &self,
        found: &[u32],
        ground: &GroundBlock,
        covered: &mut [BlockValues; 2],
    ) {
        *covered = [[[0.0; LANES]; LANES]; 2];
        for stroke in found {
            let stroke = &self.strokes[*stroke as usize];
            let covered = &mut covered[usize::from(stroke.is_cable)];
            match &stroke.shape {
                Shape::Line { .. } => stroke.cover_line(ground, covered),
                Shape::Arc { .. } => stroke.cover_arc(ground, covered),
                Shape::Disc { .. } => stroke.cover_disc(ground, covered),
            }
        }
    }
}

impl Stroke {
    fn cover_line(&self, ground: &GroundBlock, covered: &mut BlockValues) {
        let Shape::Line {
            middle,
            along,
            half_length,
        } = self.shape
        else {
            return;
        };
        let [ux, uy] = along.map(splat);
        for (row, covered) in covered.iter_mut().enumerate() {
            let [dx, dy] = ground.offsets_from(row, middle);
            let (across, along) = (dy * ux - dx * uy, dx.mul_add(ux, dy * uy));
            let past_side = across.abs() - splat(self.half);
            let past_end = along.abs() - splat(half_length);
            if !ground.reaches(row, past_side.fast_max(past_end)) {
                continue;
            }
            let [per_wide, per_long] = ground.per_width(row, -uy, ux);
            let within = interval(past_side, self.half, per_wide);
            let part = within * interval(past_end, half_length, per_long);
            // Where markings overlap, the larger coverage counts.
            *covered = Vector::new(*covered).fast_max(part).to_array();
        }
    }

    fn cover_arc(&self, ground: &GroundBlock, covered: &mut BlockValues) {
        let Shape::Arc {
            centre,
            radius,
            ends,
        } = self.shape
        else {
            return;
        };
        for (row, covered) in covered.iter_mut().enumerate() {
            let (distance, [dx, dy]) = ground.distances_from(row, centre);
            let past_side = (distance - splat(radius)).abs() - splat(self.half);
            if !ground.reaches(row, past_side) {
                continue;
            }
            let per = splat(1.0) / distance;
            let [nx, ny] = [dx * per, dy * per];
            let [per_wide, per_long] = ground.per_width(row, nx, ny);
            let mut part = interval(past_side, self.half, per_wide);
            if let Some((ends, is_short)) = ends {
                // Distances inwards from the radii at both ends.
                let [after, before] = ends.map(|[x, y]| splat(x) * dy - splat(y) * dx);
                let inside = if is_short {
                    after.fast_min(-before)
                } else {
                    after.fast_max(-before)
                };
                part *= shares(inside.mul_add(per_long, splat(0.5)));
            }
            *covered = Vector::new(*covered).fast_max(part).to_array();
        }
    }

    fn cover_disc(&self, ground: &GroundBlock, covered: &mut BlockValues) {
        let Shape::Disc { centre } = self.shape else {
            return;
        };
        for (row, covered) in covered.iter_mut().enumerate() {
            let (distance, [dx, dy]) = ground.distances_from(row, centre);
            let past_edge = distance - splat(self.half);
            if !ground.reaches(row, past_edge) {
                continue;
            }
            let per = splat(1.0) / distance;
            let [nx, ny] = [dx * per, dy * per];
            let [per_wide, per_across] = ground.per_width(row, nx, ny);
            // A footprint larger than the disc holds its area: π r² in place of 2 r times the width.
            let small = (splat(FRAC_PI_2 * self.half) * per_across).fast_min(splat(1.0));
            let part = small * interval(past_edge, self.half, per_wide);
            *covered = Vector::new(*covered).fast_max(part).to_array();
        }
    }
}

/// Shares of footprints within ± half, by how far their middles are past it.
#[inline(always)]
fn interval(past: Vector, half: f32, per_width: Vector) -> Vector {
    let inside = past.mul_neg_add(per_width, splat(0.5));
    let most = (splat(2.0 * half) * per_width).fast_min(splat(1.0));
    inside.fast_min(most).fast_max(splat(0.0))
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use localize::field::Marking;
    use localize::frames::At;

    use super::*;

    /// Coverage of footprints of `width` at a point.
    fn coverage(strokes: &[Stroke], x: f32, y: f32, width: f32) -> f32 {
        let all = |value: f32| [[value; LANES]; LANES];
        let ground = GroundBlock {
            at: [all(x), all(y)],
            direction: [all(0.6), all(0.8)],
            along2: all(width * width),
            across2: all(width * width),
            half_width: all(width),
        };
        let paint = Paint {
            strokes: strokes.to_vec(),
            culling: StrokeCulling::default(),
        };
        let found: Vec<u32> = (0..strokes.len() as u32).collect();
        let mut covered = [all(0.0); 2];
        paint.cover(&found, &ground, &mut covered);
        covered[0][3][5]
    }

    #[test]
    fn walls_replace_boundary_lines_except_at_goal_mouths() {
        let text = include_str!("../../../../config/fields/msl_2001.toml");
        let field = Field::new(toml::from_str(text).expect("a field")).expect("a field");
        let strokes: Vec<Stroke> = painted_markings(&field)
            .iter()
            .map(|marking| Stroke::new(marking, 0.025, false))
            .collect();
        let white = |x, y| coverage(&strokes, x, y, 0.01);
        assert_eq!([white(2.0, 2.24), white(4.49, 2.0)], [0.0, 0.0]);
        assert!(white(4.5, 0.5) > 0.999 && white(0.0, 2.2) > 0.999);
    }

    #[test]
    fn narrow_line_covers_its_fraction_of_the_footprint() {
        let line = Marking::Line {
            from: At::new(-5.0, 0.0),
            to: At::new(5.0, 0.0),
        };
        let line = [Stroke::new(&line, 0.05, false)];
        assert!((coverage(&line, 0.0, 0.1, 0.5) - 0.2).abs() < 1e-3);
        assert!((coverage(&line, 0.0, 0.05, 0.02) - 0.5).abs() < 1e-3);
        assert_eq!(coverage(&line, 0.0, 0.2, 0.02), 0.0);
    }

    #[test]
    fn quarter_arc_ends_at_its_radii_and_a_far_disc_covers_its_area() {
        let arc = Marking::Arc {
            centre: At::new(0.0, 0.0),
            radius: 1.0,
            start: 0.0,
            sweep: FRAC_PI_2,
        };
        let arc = [Stroke::new(&arc, 0.05, false)];
        let at = |angle: f32| coverage(&arc, angle.cos(), angle.sin(), 0.02);
        assert!(at(0.5) > 0.999 && at(1.5) > 0.999);
        assert_eq!([at(-0.1), at(1.7), at(3.0), at(-2.0)], [0.0; 4]);
        let disc = Marking::Spot {
            centre: At::new(0.0, 0.0),
            radius: 0.05,
        };
        let disc = [Stroke::new(&disc, 0.05, false)];
        assert!(coverage(&disc, 0.0, 0.01, 0.02) > 0.999);
        let share = PI * 0.05 * 0.05 / (0.5 * 0.5);
        assert!((coverage(&disc, 0.1, 0.0, 0.5) / share - 1.0).abs() < 0.01);
    }
}
