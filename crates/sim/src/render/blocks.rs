//! Where do the rays of a block of pixels point? The traced rays of all pixels, and what bounds them.
//!
//! The image is drawn in blocks of 8 × 8 pixels: what a block cannot see is not asked of its rays, and a block of bare
//! floor needs no rays at all.

use std::f32::consts::PI;
use std::ops::Range;

use vision::{Ray, RayTable};

use super::lanes::{BlockValues, LANES, Lanes, Vector, from_high_bits, high_bits, splat};
use super::paint::PAINT_BLUR;
use super::spacing::{azimuth, pixel_spacing, slope};

/// Largest footprint of a pixel in elevation and in azimuth, radians. Where two parts of the mirror
/// meet, neighbouring pixels look far apart; each shows what is around its own ray.
const RISE_MAX: f32 = 0.05;
const TURN_MAX: f32 = 0.3;
/// Half width of a block beyond which it counts as seeing all azimuths, radians.
const HALF_ANGLE_MAX: f32 = 0.9;

/// The blocks that have rays, in the order of the image.
pub(super) struct Blocks {
    pub(super) blocks: Vec<Block>,
    /// Their rays.
    pub(super) rays: Vec<BlockRays>,
    /// Runs of pixels without a ray in each row of the image, by columns.
    pub(super) blank: Vec<Vec<Range<usize>>>,
    pub(super) origins: OriginBounds,
}

/// The rays of a block, robot frame. Points on a ray are `origin + s·(direction, slope)` for a horizontal distance s, metres.
pub(super) struct BlockRays {
    /// Horizontal direction, unit length.
    pub(super) direction: [BlockValues; 2],
    /// Height per horizontal metre.
    pub(super) slope: BlockValues,
    /// Azimuth and slope between neighbouring pixels' rays, times the blur of the optics.
    /// Of each number the higher half of its bits, which is exact to 0.4 %.
    pub(super) spacing: [[[u16; LANES]; LANES]; 2],
}

/// One block of pixels.
pub(super) struct Block {
    /// Place in blocks.
    pub(super) column: usize,
    pub(super) row: usize,
    /// Origins of the rays, which are almost linear over a block.
    pub(super) origin: [LinearValues; 3],
    /// Cosine and sine of the largest azimuth between the middle and a ray's footprint; `None` for all azimuths.
    pub(super) half_angle: Option<[f32; 2]>,
    /// How far slopes reach beyond those of the lattice points, footprints included: below, above.
    pub(super) slope_spare: [f32; 2],
}

/// A value that changes linearly over a block.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinearValues {
    middle: f32,
    per_column: f32,
    per_row: f32,
}

/// Where rays start, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct OriginBounds {
    /// Largest horizontal distance from the axis.
    pub(super) radius_max: f32,
    /// Largest distance between a ray's line and the axis: 0 for an upright mirror.
    pub(super) axis_offset_max: f32,
    pub(super) height_min: f32,
    pub(super) height_max: f32,
}

/// A ray and its spacing.
#[derive(Clone, Copy)]
struct PixelRay {
    origin: [f32; 3],
    direction: [f32; 2],
    slope: f32,
    spacing: [f32; 2],
}

impl LinearValues {
    /// The plane through values at columns and rows, by least squares.
    fn fit(values: &[(usize, usize, f32)]) -> Self {
        let per = 1.0 / values.len() as f32;
        let mean =
            |of: &dyn Fn(&(usize, usize, f32)) -> f32| values.iter().map(of).sum::<f32>() * per;
        let (x, y) = (mean(&|at| at.0 as f32), mean(&|at| at.1 as f32));
        let value = mean(&|at| at.2);
        let product = |of: &dyn Fn(f32, f32, f32) -> f32| {
            mean(&|at| of(at.0 as f32 - x, at.1 as f32 - y, at.2 - value))
        };
        let (xx, yy) = (product(&|x, _, _| x * x), product(&|_, y, _| y * y));
        let (xy, xv) = (product(&|x, y, _| x * y), product(&|x, _, v| x * v));
        let yv = product(&|_, y, v| y * v);
        let determinant = xx * yy - xy * xy;
        let [per_column, per_row] = if determinant > 1e-3 {
            [yy * xv - xy * yv, xx * yv - xy * xv].map(|part| part / determinant)
        } else if xx > yy {
            [xv / xx, 0.0]
        } else {
            // The values of one row, of one column, or a single one.
            [0.0, if yy > 0.0 { yv / yy } else { 0.0 }]
        };
        let middle = (LANES - 1) as f32 / 2.0;
        LinearValues {
            middle: value + per_column * (middle - x) + per_row * (middle - y),
            per_column,
            per_row,
        }
    }

    /// The sum of some values with weights.
    #[inline(always)]
    pub(super) fn sum(values: &[Self; 3], weights: [f32; 3]) -> Self {
        let sum = |of: fn(&Self) -> f32| {
            let [x, y, z] = values.each_ref().map(of);
            weights[0].mul_add(x, weights[1].mul_add(y, weights[2] * z))
        };
        LinearValues {
            middle: sum(|of| of.middle),
            per_column: sum(|of| of.per_column),
            per_row: sum(|of| of.per_row),
        }
    }

    /// The values with an offset in the middle, and its change from row to row.
    #[inline(always)]
    pub(super) fn shifted(self, offset: f32, per_row: f32) -> Self {
        LinearValues {
            middle: self.middle + offset,
            per_row: self.per_row + per_row,
            ..self
        }
    }

    /// The values of a block's row.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> Lanes {
        const FROM_MIDDLE: Lanes = [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5];
        let middle = FROM_MIDDLE[row].mul_add(self.per_row, self.middle);
        splat(self.per_column)
            .mul_add(Vector::new(FROM_MIDDLE), splat(middle))
            .to_array()
    }
}

impl Blocks {
    /// The blocks of a table of rays. `lattice`: lowest and highest slope of a block's lattice points, and its middle
    /// direction, by its column and row. The blur of the optics (pixels, by the pixel's index) widens every ray.
    pub(super) fn new(
        table: &RayTable,
        lattice: impl Fn(usize, usize) -> ([f32; 2], [f32; 2]),
        blur_px: impl Fn(usize) -> f32,
    ) -> Self {
        let (width_px, height_px) = (table.width_px, table.height_px);
        let mut blocks = Blocks {
            blocks: Vec::new(),
            rays: Vec::new(),
            blank: blank_runs(table),
            origins: OriginBounds {
                radius_max: 0.0,
                axis_offset_max: 0.0,
                height_min: f32::MAX,
                height_max: 0.0,
            },
        };
        let pixel_ray = |pixel: usize, ray: &Ray| {
            let (sin, cos) = azimuth(ray).sin_cos();
            let (slope, blur) = (slope(ray), blur_px(pixel));
            let [turn, rise] = pixel_spacing(table, pixel, ray).map(|spacing| spacing * blur);
            PixelRay {
                origin: ray.origin,
                direction: [cos, sin],
                slope,
                spacing: [
                    turn.min(TURN_MAX),
                    rise.min(RISE_MAX * (1.0 + slope * slope)),
                ],
            }
        };
        for row in 0..height_px.div_ceil(LANES) {
            for column in 0..width_px.div_ceil(LANES) {
                let mut rays = [[None; LANES]; LANES];
                for (down, rays) in rays.iter_mut().enumerate().take(height_px - row * LANES) {
                    let first = (row * LANES + down) * width_px + column * LANES;
                    for (across, to) in rays.iter_mut().enumerate().take(width_px - column * LANES)
                    {
                        let ray = table.rays[first + across].as_ref();
                        *to = ray.map(|ray| pixel_ray(first + across, ray));
                    }
                }
                blocks.add([column, row], &rays, lattice(column, row));
            }
        }
        blocks
    }

    /// The smaller side of a footprint on the floor over its distance, of the median block.
    pub(super) fn footprint(&self) -> f32 {
        let mut sides: Vec<f32> = (self.rays.iter())
            .map(|rays| {
                let [turn, rise] = (rays.spacing.each_ref()).map(|of| from_high_bits(of[0][0]));
                turn.min(rise / rays.slope[0][0].abs().max(1e-3))
            })
            .collect();
        sides.sort_by(f32::total_cmp);
        sides.get(sides.len() / 2).copied().unwrap_or(0.0)
    }

    /// Pixels without a ray in blocks that have rays, in an image of rows of `stride` pixels.
    pub(super) fn rim(&self, stride: usize) -> Vec<Range<usize>> {
        let mut rim = Vec::new();
        for block in &self.blocks {
            let columns = block.column * LANES..(block.column + 1) * LANES;
            for row in block.row * LANES..(block.row + 1) * LANES {
                let Some(runs) = self.blank.get(row) else {
                    continue;
                };
                for run in runs {
                    let (from, to) = (run.start.max(columns.start), run.end.min(columns.end));
                    if from < to {
                        rim.push(row * stride + from..row * stride + to);
                    }
                }
            }
        }
        rim
    }

    /// Adds a block if it has a ray. Pixels without one get their nearest neighbour's.
    fn add(
        &mut self,
        [column, row]: [usize; 2],
        rays: &[[Option<PixelRay>; LANES]; LANES],
        (slopes, middle): ([f32; 2], [f32; 2]),
    ) {
        let own: Vec<(usize, usize, PixelRay)> = (rays.iter().enumerate())
            .flat_map(|(row, rays)| {
                let rays = rays.iter().enumerate();
                rays.filter_map(move |(column, ray)| ray.map(|ray| (column, row, ray)))
            })
            .collect();
        if own.is_empty() {
            return;
        }
        let filled: [[PixelRay; LANES]; LANES] = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let distance = |at: &&(usize, usize, PixelRay)| {
                    at.0.abs_diff(column).pow(2) + at.1.abs_diff(row).pow(2)
                };
                let nearest = own.iter().min_by_key(distance);
                nearest.map_or(own[0].2, |nearest| nearest.2)
            })
        });
        let values = |of: &dyn Fn(&PixelRay) -> f32| -> BlockValues {
            filled.each_ref().map(|row| row.each_ref().map(of))
        };
        for (_, _, ray) in &own {
            self.origins.include(ray);
        }
        let (mut low, mut high, mut half) = (f32::MAX, f32::MIN, 0f32);
        for (_, _, ray) in &own {
            let reach = PAINT_BLUR / 2.0;
            low = low.min(ray.slope - reach * ray.spacing[1]);
            high = high.max(ray.slope + reach * ray.spacing[1]);
            let [x, y] = ray.direction;
            let turn = (middle[0] * y - middle[1] * x).atan2(middle[0] * x + middle[1] * y);
            half = half.max(turn.abs() + reach * ray.spacing[0]);
        }
        let half = (1.02 * half + 1e-3).min(PI);
        self.blocks.push(Block {
            column,
            row,
            origin: [0, 1, 2].map(|k| {
                let of_own = own
                    .iter()
                    .map(|(column, row, ray)| (*column, *row, ray.origin[k]));
                LinearValues::fit(&of_own.collect::<Vec<_>>())
            }),
            half_angle: (half < HALF_ANGLE_MAX).then(|| [half.cos(), half.sin()]),
            slope_spare: [slopes[0] - low, high - slopes[1]].map(|spare| spare.max(0.0) + 1e-4),
        });
        self.rays.push(BlockRays {
            direction: [0, 1].map(|k| values(&|ray| ray.direction[k])),
            slope: values(&|ray| ray.slope),
            spacing: [0, 1].map(|k| values(&|ray| ray.spacing[k]).map(|row| row.map(high_bits))),
        });
    }
}

impl OriginBounds {
    fn include(&mut self, ray: &PixelRay) {
        let ([x, y, z], [cos, sin]) = (ray.origin, ray.direction);
        self.radius_max = self.radius_max.max(x.hypot(y));
        self.axis_offset_max = self.axis_offset_max.max((x * sin - y * cos).abs());
        self.height_min = self.height_min.min(z);
        self.height_max = self.height_max.max(z);
    }
}

/// Runs of pixels without a ray, row by row.
fn blank_runs(table: &RayTable) -> Vec<Vec<Range<usize>>> {
    let rows = table.rays.chunks(table.width_px.max(1));
    rows.map(|row| {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (column, _) in row.iter().enumerate().filter(|(_, ray)| ray.is_none()) {
            match runs.last_mut() {
                Some(run) if run.end == column => run.end += 1,
                _ => runs.push(column..column + 1),
            }
        }
        runs
    })
    .collect()
}
