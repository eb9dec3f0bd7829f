//! What does each block see? The rays of every fourth pixel, moved with the robot, bound the blocks and carry the floor's
//! light, which changes slowly.

use vision::{Ray, RayTable};

use super::blocks::Block;
use super::field_from_robot::FieldFromRobot;
use super::floor_light::FloorLight;
use super::lanes::{BlockValues, LANES, Lanes, Vector, larger, smaller, splat};
use super::moving_rays::{RANGE_MAX, RayLanes, move_lanes};
use super::row_transform::RowTransform;
use super::spacing::{azimuth, slope};

/// Pixels between two points.
const STEP: usize = 4;
/// Points along a block's side, without the last.
const CELLS: usize = LANES / STEP;

/// Points row by row, in groups of `LANES`.
pub(super) struct Lattice {
    /// Groups in a row.
    groups: usize,
    /// Rays at rest, and the image row of each row of points: -0.5 at the top, 0.5 at the bottom.
    rest: Vec<RayLanes>,
    image_row: Vec<f32>,
    /// Largest tilt of the current image, radians.
    tilt_max: f32,
    moved: Vec<RayLanes>,
    /// Their slopes, and the lowest and highest of the square of points that starts at each point, for each row of blocks.
    slope: Vec<f32>,
    slope_bounds: [Vec<f32>; 2],
    /// Light and gloss of the floor.
    light: [Vec<Lanes>; 2],
}

/// What bounds the rays of a block in the current image, level robot frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockView {
    /// Middle direction, and cosine and sine of the largest azimuth from there; `None` for all azimuths.
    pub(super) towards: [f32; 2],
    pub(super) half_angle: Option<[f32; 2]>,
    /// Lowest and highest slope, footprints included.
    pub(super) slope: [f32; 2],
    /// Centre of a box around the ground points, and its half sides along and across `towards`, metres.
    pub(super) ground: [f32; 2],
    pub(super) ground_half: [f32; 2],
}

impl Lattice {
    pub(super) fn new(table: &RayTable) -> Self {
        let (width_px, height_px) = (table.width_px, table.height_px);
        let columns = CELLS * width_px.div_ceil(LANES) + 1;
        let rows = CELLS * height_px.div_ceil(LANES) + 1;
        let groups = columns.div_ceil(LANES);
        let mut rest = Vec::with_capacity(groups * rows);
        for row in 0..rows {
            for group in 0..groups {
                let mut lanes = RayLanes::default();
                for lane in 0..LANES {
                    let column = (group * LANES + lane) * STEP;
                    let at = [column.min(width_px - 1), (row * STEP).min(height_px - 1)];
                    if let Some(ray) = nearest_ray(table, at) {
                        let (sin, cos) = azimuth(&ray).sin_cos();
                        (0..3).for_each(|k| lanes.origin[k][lane] = ray.origin[k]);
                        (lanes.direction[0][lane], lanes.direction[1][lane]) = (cos, sin);
                        lanes.slope[lane] = slope(&ray);
                    }
                }
                rest.push(lanes);
            }
        }
        let image_row = |row: usize| ((row * STEP) as f32 + 0.5) / height_px as f32 - 0.5;
        let mut lattice = Lattice {
            groups,
            image_row: (0..rows).map(image_row).collect(),
            tilt_max: 0.0,
            moved: rest.clone(),
            slope: rest.iter().flat_map(|lanes| lanes.slope).collect(),
            slope_bounds: [0; 2].map(|_| vec![0.0; rows / CELLS * groups * LANES]),
            light: [0; 2].map(|_| vec![[0.0; LANES]; rest.len()]),
            rest,
        };
        lattice.bound_slopes();
        lattice
    }

    /// Moves the points and looks up the floor's light there.
    #[inline(never)]
    pub(super) fn update(
        &mut self,
        transform: &RowTransform,
        pose: FieldFromRobot,
        floor: &FloorLight,
    ) {
        self.tilt_max = transform.tilt_max;
        let rows = self.rest.chunks(self.groups).zip(&self.image_row);
        let moved = self.moved.chunks_mut(self.groups);
        let [light, gloss] = self.light.each_mut().map(|of| of.chunks_mut(self.groups));
        for (((rest, image_row), moved), (light, gloss)) in rows.zip(moved).zip(light.zip(gloss)) {
            let rotation = transform.rotation_at(*image_row);
            let shift = transform.shift_at(*image_row);
            for (((rest, moved), light), gloss) in (rest.iter().zip(moved)).zip(light).zip(gloss) {
                *moved = move_lanes(rest, &rotation, shift);
                let [x, y] = moved.ground_in_field(pose);
                floor.look_up(&x, &y, light, gloss);
            }
        }
        let slopes = self.slope.as_chunks_mut::<LANES>().0.iter_mut();
        for (slope, moved) in slopes.zip(&self.moved) {
            *slope = moved.slope;
        }
        self.bound_slopes();
    }

    /// Bounds the slopes of the squares of `CELLS + 1` × `CELLS + 1` points.
    fn bound_slopes(&mut self) {
        let stride = self.groups * LANES;
        let [low, high] = self.slope_bounds.each_mut().map(|of| of.chunks_mut(stride));
        for (block_row, (low, high)) in low.zip(high).enumerate() {
            let rows = &self.slope[block_row * CELLS * stride..][..(CELLS + 1) * stride];
            low.fill(f32::MAX);
            high.fill(f32::MIN);
            for down in 0..=CELLS {
                for across in 0..=CELLS {
                    let slopes = &rows[down * stride..][across..stride];
                    for ((low, high), slope) in low.iter_mut().zip(&mut *high).zip(slopes) {
                        (*low, *high) = (smaller(*low, *slope), larger(*high, *slope));
                    }
                }
            }
        }
    }

    fn point(&self, column: usize, row: usize) -> (usize, usize) {
        (row * self.groups + column / LANES, column % LANES)
    }

    /// Lowest and highest slope of a block's points at rest, and the direction of its middle.
    pub(super) fn rest_view(&self, column: usize, row: usize) -> ([f32; 2], [f32; 2]) {
        let (group, lane) = self.point(CELLS * column + 1, CELLS * row + 1);
        let middle = self.rest[group].direction.map(|of| of[lane]);
        (self.slopes(column, row), middle)
    }

    /// Lowest and highest slope of a block's points.
    fn slopes(&self, column: usize, row: usize) -> [f32; 2] {
        let at = row * self.groups * LANES + CELLS * column;
        self.slope_bounds.each_ref().map(|of| of[at])
    }

    /// What a block sees in the current image.
    #[inline(never)]
    pub(super) fn view(&self, block: &Block) -> BlockView {
        let [low, high] = self.slopes(block.column, block.row);
        // Tilt stretches slopes, and turns the azimuths of steep rays more than those of others.
        let steepest = low.abs().max(high.abs());
        let stretch = 1.05 + 3.0 * self.tilt_max * steepest;
        let [below, above] = block.slope_spare.map(|spare| stretch * spare);
        let [low, high] = [low - below, high + above];
        let turn = 1.2 * self.tilt_max * (high - low);
        let half_angle = block.half_angle.and_then(|[cos, sin]| {
            let wider = [cos - turn * sin, sin + turn * cos];
            (turn < 0.5 && wider[0] > 0.3).then_some(wider)
        });
        let (group, lane) = self.point(CELLS * block.column + 1, CELLS * block.row + 1);
        let rays = &self.moved[group];
        let towards = rays.direction.map(|of| of[lane]);
        let [x, y, z] = rays.origin.map(|of| of[lane]);
        // Origins differ by some millimetres within a block.
        let distance = |slope: f32| (z / (-slope).max(z / RANGE_MAX)).min(RANGE_MAX);
        let (near, far) = (0.994 * distance(low) - 0.01, 1.006 * distance(high) + 0.01);
        let (near, far, across) = match half_angle {
            Some([cos, sin]) => (near * cos, far, far * sin),
            None => (-far, far, far),
        };
        let middle = (near + far) / 2.0;
        BlockView {
            towards,
            half_angle,
            slope: [low, high],
            ground: [x + middle * towards[0], y + middle * towards[1]],
            ground_half: [(far - near) / 2.0, across],
        }
    }

    /// Light and gloss of the floor on each pixel of a block.
    pub(super) fn light(&self, block: &Block, glossy: bool, out: &mut [BlockValues; 2]) {
        self.interpolate(&self.light[0], block, &mut out[0]);
        if glossy {
            self.interpolate(&self.light[1], block, &mut out[1]);
        }
    }

    #[inline(always)]
    fn interpolate(&self, values: &[Lanes], block: &Block, out: &mut BlockValues) {
        /// Places of a row's pixels between two points.
        const PARTS: Lanes = [0.0, 0.25, 0.5, 0.75, 0.0, 0.25, 0.5, 0.75];
        let stride = self.groups * LANES;
        let first = CELLS * (block.row * stride + block.column);
        let values = values.as_flattened();
        // Along each row of points first.
        let rows: [Vector; CELLS + 1] = std::array::from_fn(|down| {
            let at: &[f32; CELLS + 1] = values[first + down * stride..]
                .first_chunk()
                .unwrap_or(&[0.0; CELLS + 1]);
            let left = Vector::new(std::array::from_fn(|lane| at[lane / STEP]));
            let right = Vector::new(std::array::from_fn(|lane| at[lane / STEP + 1]));
            Vector::new(PARTS).mul_add(right - left, left)
        });
        for (row, out) in out.iter_mut().enumerate() {
            let (above, below) = (rows[row / STEP], rows[row / STEP + 1]);
            *out = splat(PARTS[row]).mul_add(below - above, above).to_array();
        }
    }
}

/// The ray of a pixel, or of the first one that has a ray on the way to the image's middle.
fn nearest_ray(table: &RayTable, [column, row]: [usize; 2]) -> Option<Ray> {
    let (middle_u, middle_v) = (table.width_px / 2, table.height_px / 2);
    let steps = column.abs_diff(middle_u).max(row.abs_diff(middle_v));
    let between = |from: usize, to: usize, step: usize| {
        let moved = from * (steps - step) + to * step;
        moved.checked_div(steps).unwrap_or(from)
    };
    (0..=steps).find_map(|step| {
        let (column, row) = (
            between(column, middle_u, step),
            between(row, middle_v, step),
        );
        table.rays[row * table.width_px + column]
    })
}
