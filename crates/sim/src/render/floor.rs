//! What colour is the floor? Carpet, paint and cables, and what is around the carpet.

use localize::field::Field;

use super::cables::Cable;
use super::draw_list::linear;
use super::field_from_robot::FieldFromRobot;
use super::lanes::{BlockLight, BlockValues, LANES, Vector, shares, splat};
use super::lattice::BlockView;
use super::moving_rays::{MovedBlock, RANGE_MAX};
use super::paint::{GroundBlock, PAINT_BLUR, Paint, WIDTH_MIN};
use super::strokes::Area;

/// sRGB of carpet and paint under white light.
const CARPET: [u8; 3] = [72, 130, 88];
const MARKING_RGB: [u8; 3] = [226, 230, 226];
/// Linear light that a black cable returns.
const CABLE_LIGHT: f32 = 0.012;

/// The floor of a field.
pub(super) struct Floor {
    paint: Paint,
    carpet_half: [f32; 2],
    /// Nothing is painted farther out, and there is no carpet.
    painted_half: [f32; 2],
    /// Linear colours.
    carpet: [f32; 3],
    marking: [f32; 3],
    /// Around the carpet.
    surround: [f32; 3],
    /// The smaller side of a pixel's footprint over its distance.
    footprint: f32,
    /// Strokes that the current block may see.
    strokes: Vec<u32>,
    ground: GroundBlock,
    covered: [BlockValues; 2],
}

/// What a block sees of the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FloorView {
    /// Bare floor of one colour.
    Bare { on_carpet: bool },
    /// Strokes, or the carpet's edge, of which rays that are all on the carpet see nothing.
    Edges { on_carpet: bool },
}

impl Floor {
    /// `footprint`: the smaller side of a pixel's footprint over its distance.
    pub(super) fn new(field: &Field, floor_rgb: [u8; 3], cables: &[Cable], footprint: f32) -> Self {
        let (half_x, half_y) = field.carpet_half_extent();
        let (paint, carpet_half) = (Paint::new(field, cables), [half_x, half_y]);
        let painted = paint.half_extent();
        Floor {
            paint,
            carpet_half,
            painted_half: [0, 1].map(|k| carpet_half[k].max(painted[k])),
            carpet: linear(CARPET),
            marking: linear(MARKING_RGB),
            surround: linear(floor_rgb),
            footprint,
            strokes: Vec::new(),
            ground: GroundBlock::new(),
            covered: [[[0.0; LANES]; LANES]; 2],
        }
    }

    /// Finds what a block sees, and keeps the strokes for `shade_edges`.
    #[inline(never)]
    pub(super) fn view(&mut self, pose: FieldFromRobot, view: &BlockView) -> FloorView {
        let ([x, y], [ux, uy]) = (pose.rotate(view.ground), pose.rotate(view.towards));
        let centre = [pose.x + x, pose.y + y];
        let [along, across] = view.ground_half;
        let half = [
            ux.abs() * along + uy.abs() * across,
            uy.abs() * along + ux.abs() * across,
        ];
        let reach = |sign: f32, k: usize| centre[k].abs() + sign * half[k];
        let inside = (0..2).all(|k| reach(1.0, k) < self.carpet_half[k]);
        if (0..2).any(|k| reach(-1.0, k) > self.painted_half[k]) {
            return FloorView::Bare { on_carpet: false };
        }
        let area = Area {
            centre,
            axis: [ux, uy],
            half: view.ground_half,
        };
        self.paint.find(&area, &mut self.strokes);
        let outside = (0..2).any(|k| reach(-1.0, k) > self.carpet_half[k]);
        if self.strokes.is_empty() && (inside || outside) {
            FloorView::Bare { on_carpet: inside }
        } else {
            FloorView::Edges { on_carpet: inside }
        }
    }

    /// Merges pieces of cables as far as the robot cannot tell.
    pub(super) fn merge_cables(&mut self, pose: FieldFromRobot) {
        self.paint.merge_cables([pose.x, pose.y], self.footprint);
    }

    /// Takes all strokes as those that a block sees.
    #[cfg(test)]
    pub(super) fn find_all(&mut self) {
        let everywhere = Area {
            centre: [0.0; 2],
            axis: [1.0, 0.0],
            half: [100.0; 2],
        };
        self.paint.find(&everywhere, &mut self.strokes);
    }

    /// Light of bare floor.
    pub(super) fn shade_bare(
        &self,
        on_carpet: bool,
        [lit, gloss]: &[BlockValues; 2],
        light: &mut BlockLight,
    ) {
        let colour = if on_carpet {
            self.carpet
        } else {
            self.surround
        };
        for (plane, colour) in light.iter_mut().zip(colour) {
            for (light, (lit, gloss)) in plane.iter_mut().zip(lit.iter().zip(gloss)) {
                for i in 0..LANES {
                    light[i] = lit[i].mul_add(colour, gloss[i]);
                }
            }
        }
    }

    /// Light of a floor with paint, cables or the carpet's edge.
    #[inline(never)]
    pub(super) fn shade_edges(
        &mut self,
        pose: FieldFromRobot,
        on_carpet: bool,
        rays: &MovedBlock,
        [lit, gloss]: &[BlockValues; 2],
        light: &mut BlockLight,
    ) {
        self.ground.set(pose, rays);
        self.paint
            .cover(&self.strokes, &self.ground, &mut self.covered);
        let inside = if on_carpet {
            [[1.0; LANES]; LANES]
        } else {
            self.ground.inside(self.carpet_half)
        };
        let [white, black] = &self.covered;
        for row in 0..LANES {
            let [white, black, inside] = [white, black, &inside].map(|of| Vector::new(of[row]));
            let [lit, gloss] = [lit, gloss].map(|of| Vector::new(of[row]));
            for (k, plane) in light.iter_mut().enumerate() {
                let [carpet, paint, floor] =
                    [self.carpet[k], self.marking[k], self.surround[k]].map(splat);
                let painted = white.mul_add(paint - carpet, carpet);
                let carpet = black.mul_add(splat(CABLE_LIGHT) - painted, painted);
                let colour = inside.mul_add(carpet - floor, floor);
                plane[row] = lit.mul_add(colour, gloss).to_array();
            }
        }
    }
}

impl GroundBlock {
    /// Ground points and footprints of a block's rays, for the robot at a pose.
    fn set(&mut self, pose: FieldFromRobot, rays: &MovedBlock) {
        let [sin, cos, x, y] = [pose.sin, pose.cos, pose.x, pose.y].map(splat);
        for (row, of_row) in rays.rows.iter().enumerate() {
            let [ox, oy, height] = of_row.origin.map(Vector::new);
            let [tx, ty] = of_row.direction.map(Vector::new);
            let [turn, rise] = rays.spacing.each_ref().map(|of| Vector::new(of[row]));
            let per_fall = splat(1.0) / of_row.fall();
            let distance = (height * per_fall).fast_min(splat(RANGE_MAX));
            let (ground_x, ground_y) = (distance.mul_add(tx, ox), distance.mul_add(ty, oy));
            let across = splat(PAINT_BLUR) * distance * turn;
            let along = (distance * per_fall * rise).fast_min(splat(RANGE_MAX));
            let along = splat(PAINT_BLUR) * along;
            self.at[0][row] = cos.mul_add(ground_x, x - sin * ground_y).to_array();
            self.at[1][row] = sin.mul_add(ground_x, cos.mul_add(ground_y, y)).to_array();
            self.direction[0][row] = (cos * tx - sin * ty).to_array();
            self.direction[1][row] = sin.mul_add(tx, cos * ty).to_array();
            self.along2[row] = (along * along).to_array();
            self.across2[row] = (across * across).to_array();
            let half_width = splat(0.5).mul_add(along.fast_max(across), splat(WIDTH_MIN));
            self.half_width[row] = half_width.to_array();
        }
    }

    /// The share of each footprint within ± half of the field's axes.
    fn inside(&self, half: [f32; 2]) -> BlockValues {
        let half = half.map(splat);
        std::array::from_fn(|row| {
            let per_width = self.per_width(row, splat(1.0), splat(0.0));
            let [x, y] = [0, 1].map(|k| {
                let from_edge = half[k] - Vector::new(self.at[k][row]).abs();
                shares(from_edge.mul_add(per_width[k], splat(0.5)))
            });
            (x * y).to_array()
        })
    }
}
