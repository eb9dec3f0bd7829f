//! Where is the light of an image kept? In one plane per colour, whose sides are multiples of a block's.

use std::ops::Range;

use wide::i16x8;

use super::lanes::{BlockLight, LANES, Lanes, Vector, larger, smaller, splat};
use crate::image_sensor::TONES;

/// Sides are multiples of it.
pub(super) const SIDE: usize = 16;

/// Linear light outside the mirror, where the camera's hood is.
const HOOD: [f32; 3] = [0.0005, 0.0010, 0.0035];

/// Linear light by colour, row by row: `TONES` is white under light of level 1.
pub(super) struct LightImage {
    pub(super) stride: usize,
    pub(super) rows: usize,
    /// With `BORDER` rows of the hood above and below.
    planes: [Vec<u16>; 3],
}

/// Rows of each plane above and below the image.
pub(super) const BORDER: usize = 16;

impl LightImage {
    /// An image of the hood.
    pub(super) fn new(width_px: usize, height_px: usize) -> Self {
        let (stride, rows) = (
            width_px.next_multiple_of(SIDE),
            height_px.next_multiple_of(SIDE),
        );
        LightImage {
            stride,
            rows,
            planes: hood().map(|light| vec![light; stride * (rows + 2 * BORDER)]),
        }
    }

    /// The plane of a colour from the first row on, and what is beyond the last row.
    pub(super) fn plane(&self, colour: usize) -> &[u16] {
        &self.planes[colour][BORDER * self.stride..]
    }

    /// The same with the rows above: `BORDER` rows.
    pub(super) fn bordered_plane(&self, colour: usize) -> &[u16] {
        &self.planes[colour]
    }

    /// Sets pixels of a plane, by their index from the first row on.
    pub(super) fn fill(&mut self, pixels: Range<usize>, light: [u16; 3]) {
        let from = BORDER * self.stride;
        for (plane, light) in self.planes.iter_mut().zip(light) {
            plane[from + pixels.start..from + pixels.end].fill(light);
        }
    }

    /// Writes a block.
    #[inline(never)]
    pub(super) fn write(&mut self, [column, row]: [usize; 2], light: &BlockLight) {
        // In runs of a block's width.
        let stride = self.stride / LANES;
        let first = (BORDER + row * LANES) * stride + column;
        for (plane, light) in self.planes.iter_mut().zip(light) {
            let runs = plane.as_chunks_mut::<LANES>().0;
            for (row, light) in light.iter().enumerate() {
                runs[first + row * stride] = tones_of_row(light);
            }
        }
    }
}

/// A pixel that shows the hood.
pub(super) fn hood() -> [u16; 3] {
    HOOD.map(tones)
}

/// Linear light as fixed-point numbers: limited as signed numbers, then moved up by half of their range.
#[inline(always)]
fn tones_of_row(light: &Lanes) -> [u16; LANES] {
    let moved = Vector::new(*light).mul_add(splat(TONES as f32), splat(-32_768.0));
    let limited = i16x8::from_i32x8_saturate(moved.fast_round_int());
    limited.to_array().map(|tone| tone as u16 ^ 0x8000)
}

/// Linear light as a fixed-point number.
#[inline(always)]
pub(super) fn tones(light: f32) -> u16 {
    // Adding 2²³ leaves the rounded value in the lowest bits, without the NaN check of a cast.
    (smaller(larger(light * TONES as f32, 0.0), 65_535.0) + 8_388_608.0).to_bits() as u16
}
