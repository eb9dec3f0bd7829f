//! How does the image smear while the shutter is open? Along the flow that the camera's own motion causes.
//!
//! The flow is constant in blocks of pixels, and its steps are whole pixels: the optics blur more than that. Taps lie
//! symmetrically around a pixel, so that the middle of the exposure stays the image's time.

use vision::{Ray, RayTable};

use super::row_transform::CameraMotion;

/// Side of a block, pixels.
const BLOCK: usize = 16;
/// Longest flow, pixels: a robot that rotates faster than any can.
const FLOW_MAX: f32 = 32.0;
/// Flow below which the image is sharp, pixels.
const FLOW_MIN: f32 = 0.75;
/// Distance of what rays above the horizon show, metres.
const BACKGROUND_DISTANCE: f32 = 8.0;
/// Distance between the pixels from which a block's derivatives are taken.
const STENCIL: usize = 4;

/// Linear light of a pixel: red, green, blue (4096 is white under light of level 1), unused.
pub(super) type LightPixel = [u16; 4];

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
    width_px: usize,
    height_px: usize,
    /// Blocks row by row; `None` where the mirror shows nothing.
    blocks: Vec<Option<BlockRay>>,
}

impl MotionBlur {
    pub(super) fn new(table: &RayTable) -> Self {
        let (width_px, height_px) = (table.width_px, table.height_px);
        let blocks = (0..height_px.div_ceil(BLOCK))
            .flat_map(|down| (0..width_px.div_ceil(BLOCK)).map(move |across| (across, down)))
            .map(|(across, down)| {
                let column = block_start(across, width_px) + BLOCK / 2;
                let row = block_start(down, height_px) + BLOCK / 2;
                block_ray(table, column.min(width_px - 1), row.min(height_px - 1))
            })
            .collect();
        MotionBlur {
            width_px,
            height_px,
            blocks,
        }
    }

    /// Writes the blurred image to `blurred`; false, without writing, if nothing moves by as much as a pixel.
    pub(super) fn apply(
        &self,
        motion: &CameraMotion,
        sharp: &[LightPixel],
        blurred: &mut Vec<LightPixel>,
    ) -> bool {
        if self.width_px < BLOCK || self.height_px < BLOCK {
            return false;
        }
        let flows: Vec<[f32; 2]> = self
            .blocks
            .iter()
            .map(|block| block.map_or([0.0; 2], |block| block.flow(motion)))
            .collect();
        if flows.iter().all(|flow| tap_count(*flow) == 1) {
            return false;
        }
        blurred.resize(sharp.len(), [0; 4]);
        let columns = self.width_px.div_ceil(BLOCK);
        for (index, flow) in flows.into_iter().enumerate() {
            let left = block_start(index % columns, self.width_px);
            let top = block_start(index / columns, self.height_px);
            self.blur_block(left, top, flow, sharp, blurred);
        }
        true
    }

    fn blur_block(
        &self,
        left: usize,
        top: usize,
        flow: [f32; 2],
        sharp: &[LightPixel],
        blurred: &mut [LightPixel],
    ) {
        let taps = tap_count(flow);
        if taps == 1 {
            for row in top..top + BLOCK {
                let run = row * self.width_px + left..row * self.width_px + left + BLOCK;
                blurred[run.clone()].copy_from_slice(&sharp[run]);
            }
            return;
        }
        let moved = |from: usize, by: isize, most: usize| {
            (from as isize + by).clamp(0, most as isize) as usize
        };
        // Columns and rows that the taps add; `moved` keeps them within the image.
        let offsets: [(usize, isize); TAPS_MAX] = std::array::from_fn(|tap| {
            let part = (tap as f32 + 0.5) / taps as f32 - 0.5;
            let [across, down] = flow.map(|pixels| (part * pixels).round() as isize);
            (moved(left, across, self.width_px - BLOCK), down)
        });
        for row in top..top + BLOCK {
            let mut runs = [&[0; 4 * BLOCK]; TAPS_MAX];
            for (run, (column, down)) in runs[..taps].iter_mut().zip(&offsets) {
                let from = moved(row, *down, self.height_px - 1) * self.width_px + column;
                if let Some(pixels) = sharp[from..].as_flattened().first_chunk() {
                    *run = pixels;
                }
            }
            let to = row * self.width_px + left;
            let Some(out) = blurred[to..].as_flattened_mut().first_chunk_mut() else {
                continue;
            };
            match taps {
                2 => average_taps::<2>(&runs, out),
                4 => average_taps::<4>(&runs, out),
                8 => average_taps::<8>(&runs, out),
                _ => average_taps::<TAPS_MAX>(&runs, out),
            }
        }
    }
}

/// Averages a row of a block over `TAPS` (a power of two) runs of pixels.
fn average_taps<const TAPS: usize>(
    runs: &[&[u16; 4 * BLOCK]; TAPS_MAX],
    out: &mut [u16; 4 * BLOCK],
) {
    /// Values that are added at once, so that sums stay in registers.
    const GROUP: usize = 16;
    for (group, out) in out.as_chunks_mut::<GROUP>().0.iter_mut().enumerate() {
        let mut sums = [0u32; GROUP];
        for run in &runs[..TAPS] {
            let run = &run.as_chunks::<GROUP>().0[group];
            for k in 0..GROUP {
                sums[k] += u32::from(run[k]);
            }
        }
        for k in 0..GROUP {
            out[k] = (sums[k] >> TAPS.trailing_zeros()) as u16;
        }
    }
}

/// Most taps: one for each other pixel of the longest flow.
const TAPS_MAX: usize = 16;

/// Number of taps of a flow, a power of two.
fn tap_count([across, down]: [f32; 2]) -> usize {
    let length = across.hypot(down);
    if length < FLOW_MIN {
        return 1;
    }
    ((length + 1.0).ceil() as usize)
        .next_power_of_two()
        .min(TAPS_MAX)
}

/// First pixel of a block; the last block of a row ends with it.
fn block_start(block: usize, size_px: usize) -> usize {
    (block * BLOCK).min(size_px.saturating_sub(BLOCK))
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
        let length = flow[0].hypot(flow[1]);
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

fn azimuth(ray: &Ray) -> f32 {
    ray.direction[1].atan2(ray.direction[0])
}

fn slope(ray: &Ray) -> f32 {
    ray.direction[2] / ray.direction[0].hypot(ray.direction[1]).max(1e-6)
}
