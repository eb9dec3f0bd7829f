//! How does the image smear while the shutter is open? Along the flow that the camera's own motion causes.
//!
//! The flow is constant in blocks of pixels, and its steps are whole pixels: the optics blur more than that. Taps lie
//! symmetrically around a pixel, so that the middle of the exposure stays the image's time.

use vision::{Ray, RayTable};
use wide::u16x16;

use super::image::{BORDER, LightImage, SIDE as BLOCK};
use super::row_transform::CameraMotion;
use super::spacing::{azimuth, slope};

/// Longest flow, pixels: a robot that rotates faster than any can. Half of it stays within the image's border.
const FLOW_MAX: f32 = 2.0 * BORDER as f32;
/// Flow below which the image is sharp, pixels.
const FLOW_MIN: f32 = 0.75;
/// Distance of what rays above the horizon show, metres.
const BACKGROUND_DISTANCE: f32 = 8.0;
/// Distance between the pixels from which a block's derivatives are taken.
const STENCIL: usize = 4;

/// The ray of a block's centre, and how far the image moves when it turns.
#[derive(Clone, Copy)]
struct BlockRay {
    origin: [f32; 3],
    direction: [f32; 2],
    slope: f32,
    pixels_per_azimuth: [f32; 2],
    pixels_per_slope: [f32; 2],
}

/// Blurs the images of one camera.
pub(super) struct MotionBlur {
    /// Blocks in a row.
    columns: usize,
    /// Blocks row by row; `None` where the mirror shows nothing.
    blocks: Vec<Option<BlockRay>>,
    /// The taps of each block in the current image.
    taps: Vec<BlockTaps>,
}

/// Where a block takes its pixels from.
#[derive(Debug, Clone, Copy, Default)]
struct BlockTaps {
    /// A power of two; 1 for the block itself.
    count: usize,
    /// Pixels from the first one of a row, `BORDER` rows above, to the block's run.
    offsets: [u32; TAPS_MAX],
}

impl MotionBlur {
    pub(super) fn new(table: &RayTable) -> Self {
        let (columns, rows) = (
            table.width_px.div_ceil(BLOCK),
            table.height_px.div_ceil(BLOCK),
        );
        let blocks: Vec<Option<BlockRay>> = (0..rows)
            .flat_map(|down| (0..columns).map(move |across| (across, down)))
            .map(|(across, down)| {
                let column = across * BLOCK + BLOCK / 2;
                let row = down * BLOCK + BLOCK / 2;
                block_ray(
                    table,
                    column.min(table.width_px - 1),
                    row.min(table.height_px - 1),
                )
            })
            .collect();
        MotionBlur {
            columns,
            taps: vec![BlockTaps::default(); blocks.len()],
            blocks,
        }
    }

    /// Prepares an image; false if nothing moves by as much as a pixel.
    pub(super) fn set_motion(&mut self, motion: &CameraMotion) -> bool {
        let stride = self.columns * BLOCK;
        let mut smeared = false;
        for (index, (taps, block)) in self.taps.iter_mut().zip(&self.blocks).enumerate() {
            let flow = block.as_ref().map_or([0.0; 2], |block| block.flow(motion));
            taps.set(index % self.columns * BLOCK, stride, flow);
            smeared |= taps.count > 1;
        }
        smeared
    }

    /// A row of the blurred image, whose pixels measure two colours in even and odd columns.
    pub(super) fn blur_row(
        &self,
        image: &LightImage,
        row: usize,
        colours: [usize; 2],
        out: &mut [u16],
    ) {
        let [even, odd] = colours.map(|colour| image.bordered_plane(colour));
        // One length, so that one check serves both.
        let planes = [even, &odd[..even.len()]];
        let first = row / BLOCK * self.columns;
        let blocks = self.taps[first..first + self.columns].iter();
        let above = row * image.stride;
        for (out, taps) in out.as_chunks_mut::<BLOCK>().0.iter_mut().zip(blocks) {
            let run = |tap: usize| sites(planes, above + taps.offsets[tap] as usize);
            *out = match taps.count {
                1 => run(0),
                2 => mean(&run(0), &run(1)),
                4 => mean_of_4([0, 1, 2, 3].map(run)),
                8 => mean_of_8([0, 1, 2, 3, 4, 5, 6, 7].map(run)),
                _ => {
                    let halves = [0, 8]
                        .map(|half| mean_of_8([0, 1, 2, 3, 4, 5, 6, 7].map(|tap| run(half + tap))));
                    mean(&halves[0], &halves[1])
                }
            };
        }
    }
}

type Run = [u16; BLOCK];

/// All bits set in even pixels, none in odd ones.
const EVEN: Run = [!0, 0, !0, 0, !0, 0, !0, 0, !0, 0, !0, 0, !0, 0, !0, 0];

/// A run of one plane at the even pixels of a block, of another at the odd ones.
#[inline(always)]
fn sites([even, odd]: [&[u16]; 2], from: usize) -> Run {
    let [even, odd] = [even, odd].map(|plane| {
        let pixels = plane.get(from..).and_then(|pixels| pixels.first_chunk());
        u16x16::new(*pixels.unwrap_or(&[0; BLOCK]))
    });
    // Bits of the odd run, replaced where the even one counts.
    (odd ^ ((even ^ odd) & u16x16::new(EVEN))).to_array()
}

/// Mean of two runs of pixels, rounded up at halves.
#[inline(always)]
fn mean(a: &Run, b: &Run) -> Run {
    let mut out = [0; BLOCK];
    for k in 0..BLOCK {
        out[k] = ((u32::from(a[k]) + u32::from(b[k]) + 1) >> 1) as u16;
    }
    out
}

/// Mean of four runs; rounding down in the second step balances that of the first.
#[inline(always)]
fn mean_of_4([a, b, c, d]: [Run; 4]) -> Run {
    let (low, high) = (mean(&a, &b), mean(&c, &d));
    let mut out = [0; BLOCK];
    for k in 0..BLOCK {
        out[k] = (low[k] & high[k]) + ((low[k] ^ high[k]) >> 1);
    }
    out
}

#[inline(always)]
fn mean_of_8([a, b, c, d, e, f, g, h]: [Run; 8]) -> Run {
    mean(&mean_of_4([a, b, c, d]), &mean_of_4([e, f, g, h]))
}

/// Most taps: one for each other pixel of the longest flow.
const TAPS_MAX: usize = 16;

/// Number of taps of a flow, a power of two.
fn tap_count([across, down]: [f32; 2]) -> usize {
    let length = (across * across + down * down).sqrt();
    if length < FLOW_MIN {
        return 1;
    }
    ((length + 1.0).ceil() as usize)
        .next_power_of_two()
        .min(TAPS_MAX)
}

impl BlockTaps {
    /// Sets the taps of the block at a column of an image of rows of `stride` pixels.
    fn set(&mut self, left: usize, stride: usize, flow: [f32; 2]) {
        self.count = tap_count(flow);
        let per = 1.0 / self.count as f32;
        let (left, stride) = (left as i32, stride as i32);
        // Those beyond the last tap, too, so that the loop becomes one of vectors.
        for (tap, offset) in self.offsets.iter_mut().enumerate() {
            let part = (tap as f32 + 0.5) * per - 0.5;
            let [across, down] = flow.map(|pixels| round_to_i32(part * pixels));
            let column = (left + across).max(0).min(stride - BLOCK as i32);
            *offset = ((BORDER as i32 + down) * stride + column) as u32;
        }
    }
}

/// The nearest integer of a number within ± 4 million, without the checks of a cast.
#[inline(always)]
fn round_to_i32(number: f32) -> i32 {
    // Adding 1.5·2²³ leaves the rounded value in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    (number + ROUND).to_bits() as i32 - ROUND.to_bits() as i32
}

impl BlockRay {
    /// Movement of the image here while the shutter is open, pixels to the right and downwards.
    fn flow(&self, motion: &CameraMotion) -> [f32; 2] {
        let ([ox, oy, oz], [tx, ty]) = (self.origin, self.direction);
        let distance = if self.slope < 0.0 {
            (oz / -self.slope).min(BACKGROUND_DISTANCE)
        } else {
            BACKGROUND_DISTANCE
        };
        // A point at rest moves against the robot; the vertical u changes by u × ω.
        let (wx, wy, wz) = (motion.tilt_rate[1], -motion.tilt_rate[0], motion.yaw_rate);
        let (x, y, z) = (
            ox + distance * tx,
            oy + distance * ty,
            oz + distance * self.slope,
        );
        let vx = -motion.velocity[0] - (wy * z - wz * y);
        let vy = -motion.velocity[1] - (wz * x - wx * z);
        let vz = -(wx * y - wy * x);
        let azimuth = (tx * vy - ty * vx) / distance * motion.shutter;
        let slope = (vz - self.slope * (tx * vx + ty * vy)) / distance * motion.shutter;
        let flow =
            [0, 1].map(|k| azimuth * self.pixels_per_azimuth[k] + slope * self.pixels_per_slope[k]);
        let length = (flow[0] * flow[0] + flow[1] * flow[1]).sqrt();
        flow.map(|part| part * (FLOW_MAX / length.max(FLOW_MAX)))
    }
}

fn block_ray(table: &RayTable, column: usize, row: usize) -> Option<BlockRay> {
    let at = |column: usize, row: usize| {
        table
            .rays
            .get(row * table.width_px + column)
            .copied()
            .flatten()
    };
    let ray = at(column, row)?;
    // Azimuth and slope per pixel, from neighbours on both sides or on one.
    let derivative = |before: Option<Ray>, after: Option<Ray>| {
        let steps = u8::from(before.is_some()) + u8::from(after.is_some());
        let (before, after) = (before.unwrap_or(ray), after.unwrap_or(ray));
        let per = 1.0 / (f32::from(steps) * STENCIL as f32);
        let turn = localize::frames::wrap_angle(azimuth(&after) - azimuth(&before));
        (steps > 0).then_some([turn * per, (slope(&after) - slope(&before)) * per])
    };
    let [az_u, sl_u] = derivative(
        column
            .checked_sub(STENCIL)
            .and_then(|column| at(column, row)),
        (column + STENCIL < table.width_px)
            .then(|| at(column + STENCIL, row))
            .flatten(),
    )?;
    let [az_v, sl_v] = derivative(
        row.checked_sub(STENCIL).and_then(|row| at(column, row)),
        (row + STENCIL < table.height_px)
            .then(|| at(column, row + STENCIL))
            .flatten(),
    )?;
    let determinant = az_u * sl_v - az_v * sl_u;
    if determinant.abs() < 1e-9 {
        return None;
    }
    Some(BlockRay {
        origin: ray.origin,
        direction: [azimuth(&ray).cos(), azimuth(&ray).sin()],
        slope: slope(&ray),
        pixels_per_azimuth: [sl_v / determinant, -sl_u / determinant],
        pixels_per_slope: [-az_v / determinant, az_u / determinant],
    })
}
