//! What do the scanned pixels show? Brightness of every sample, and classes where they are asked for, straight from
//! the camera's own bytes.
//!
//! Vector registers weigh the channels of a whole stretch of a row faster than single pixels of it are fetched. So
//! the rows are weighed wherever scan lines cross them, and the lines pick their bytes from what stays in a core's
//! cache.

use std::ops::Range;

use crate::colours::{Class, NativeTable};
use crate::image::{Frame, PixelFormat};

/// Brightness of the samples, by way of the rows that they lie in.
#[derive(Debug, Clone)]
pub(crate) struct BrightnessReader {
    stretches: Vec<Stretch>,
    /// Brightness of the stretches' pixels, one stretch after the other.
    plane: Vec<u8>,
    /// Where each sample is in `plane`.
    at: Vec<u32>,
}

/// Neighbouring pixels of a row.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    row: usize,
    /// The first of them; a multiple of [`GROUP`].
    column: usize,
    width_px: usize,
}

/// Stretches begin where a pixel's bytes begin in every format: four share their chroma in 4:1:1.
const GROUP: usize = 4;

/// So many pixels that nobody asks for are weighed rather than a new stretch begun: about what a vector loop's start
/// and end cost.
const GAP: usize = 32;

impl BrightnessReader {
    /// `places`: column and row of each sample in an image of this size.
    pub(crate) fn new(places: &[[u16; 2]], width_px: usize, height_px: usize) -> Self {
        let pixel = |&[u, v]: &[u16; 2]| usize::from(v) * width_px + usize::from(u);
        let mut wanted = vec![false; width_px * height_px];
        for place in places {
            wanted[pixel(place)] = true;
        }
        let mut stretches: Vec<Stretch> = Vec::new();
        for (row, wanted) in wanted.chunks_exact(width_px.max(1)).enumerate() {
            let begun = stretches.len();
            for (group, wanted) in wanted.chunks(GROUP).enumerate() {
                if !wanted.contains(&true) {
                    continue;
                }
                let (column, end) = (group * GROUP, group * GROUP + wanted.len());
                match stretches[begun..].last_mut() {
                    Some(last) if column <= last.column + last.width_px + GAP => {
                        last.width_px = end - last.column;
                    }
                    _ => stretches.push(Stretch {
                        row,
                        column,
                        width_px: wanted.len(),
                    }),
                }
            }
        }
        let mut place_of = vec![0u32; width_px * height_px];
        let mut length = 0;
        for stretch in &stretches {
            let start = stretch.row * width_px + stretch.column;
            for place in &mut place_of[start..start + stretch.width_px] {
                *place = length;
                length += 1;
            }
        }
        BrightnessReader {
            stretches,
            plane: vec![0; length as usize],
            at: places.iter().map(|place| place_of[pixel(place)]).collect(),
        }
    }

    /// Weighs the channels of every pixel that the samples need, weights of 256; the frame was checked.
    pub(crate) fn read(&mut self, frame: &Frame<'_>, weights: [u32; 3]) {
        let sum = Sum::new(weights, frame.format);
        // Copies, since what is behind a reference would be read anew for each pixel.
        let three = move |&[r, g, b]: &[u8; 3]| sum.rgb(r, g, b);
        let yuv = move |y, u, v| sum.of([y, u, v]);
        match frame.format {
            PixelFormat::Grey8 => self.weigh(frame, sum, move |&[y]: &[u8; 1]| [three(&[y; 3])]),
            PixelFormat::Rgb8 => self.weigh(frame, sum, move |rgb| [three(rgb)]),
            PixelFormat::Bgr8 => self.weigh(frame, sum, move |&[b, g, r]| [three(&[r, g, b])]),
            PixelFormat::Yuyv => {
                self.weigh(frame, sum, move |&[y, u, z, v]| {
                    [yuv(y, u, v), yuv(z, u, v)]
                });
            }
            PixelFormat::Uyvy => {
                self.weigh(frame, sum, move |&[u, y, v, z]| {
                    [yuv(y, u, v), yuv(z, u, v)]
                });
            }
            PixelFormat::Yuv411 => self.weigh(frame, sum, move |&[u, a, b, v, c, d]| {
                [yuv(a, u, v), yuv(b, u, v), yuv(c, u, v), yuv(d, u, v)]
            }),
            PixelFormat::Nv12 => {
                let rows = |row| [row, frame.height_px + row / 2];
                let pair = move |&[y, z]: &[u8; 2], &[u, v]: &[u8; 2]| [yuv(y, u, v), yuv(z, u, v)];
                self.weigh_pairs(frame, sum, rows, pair);
            }
            PixelFormat::BayerRggb => self.weigh_cells(frame, sum, |&[r, g], &[h, b]| (r, g, h, b)),
            PixelFormat::BayerBggr => self.weigh_cells(frame, sum, |&[b, g], &[h, r]| (r, g, h, b)),
            PixelFormat::BayerGrbg => self.weigh_cells(frame, sum, |&[g, r], &[b, h]| (r, g, h, b)),
            PixelFormat::BayerGbrg => self.weigh_cells(frame, sum, |&[g, b], &[r, h]| (r, g, h, b)),
        }
    }

    /// The values of a range of samples in the frame that was read last, one a sample.
    pub(crate) fn pick(&self, samples: Range<usize>, values: &mut [u8]) {
        // A copy of the slice: what is behind `self` would be read anew for each sample.
        let plane = self.plane.as_slice();
        let value = |at: u32| plane[at as usize];
        let (blocks, rest) = values.as_chunks_mut::<8>();
        let (at_blocks, at_rest) = self.at[samples].as_chunks::<8>();
        // Eight at a time, so that the loop itself costs nothing.
        for (block, at) in blocks.iter_mut().zip(at_blocks) {
            for (slot, &at) in block.iter_mut().zip(at) {
                *slot = value(at);
            }
        }
        for (slot, &at) in rest.iter_mut().zip(at_rest) {
            *slot = value(at);
        }
    }

    /// Weighs pixels whose bytes lie together: `PIXELS` of them in `BYTES`.
    fn weigh<const BYTES: usize, const PIXELS: usize>(
        &mut self,
        frame: &Frame<'_>,
        sum: Sum,
        weigh: impl Fn(&[u8; BYTES]) -> [u8; PIXELS],
    ) {
        self.each_stretch(frame, sum, |stretch, values: &mut [[u8; PIXELS]]| {
            let start = stretch.row * frame.stride + stretch.column / PIXELS * BYTES;
            let bytes = &frame.data[start..start + BYTES * values.len()];
            for (values, bytes) in values.iter_mut().zip(bytes.as_chunks().0) {
                *values = weigh(bytes);
            }
        });
    }

    /// Weighs pairs of pixels whose bytes lie in two rows of the frame's data.
    fn weigh_pairs(
        &mut self,
        frame: &Frame<'_>,
        sum: Sum,
        rows: impl Fn(usize) -> [usize; 2],
        weigh: impl Fn(&[u8; 2], &[u8; 2]) -> [u8; 2],
    ) {
        self.each_stretch(frame, sum, |stretch, values: &mut [[u8; 2]]| {
            let [first, second] = rows(stretch.row).map(|row| {
                let start = row * frame.stride + stretch.column;
                frame.data[start..start + 2 * values.len()].as_chunks().0
            });
            for ((values, first), second) in values.iter_mut().zip(first).zip(second) {
                *values = weigh(first, second);
            }
        });
    }

    /// Weighs the cells of a colour filter; `colours` gives a cell's red, both greens and blue.
    fn weigh_cells(
        &mut self,
        frame: &Frame<'_>,
        sum: Sum,
        colours: impl Fn(&[u8; 2], &[u8; 2]) -> (u8, u8, u8, u8),
    ) {
        // The last row of an odd number has no cell of its own, see [`Frame::native`].
        let last = (frame.height_px & !1).saturating_sub(2);
        let rows = |row: usize| {
            let upper = (row & !1).min(last);
            [upper, (upper + 1).min(frame.height_px - 1)]
        };
        self.weigh_pairs(frame, sum, rows, move |upper, lower| {
            let (r, g, h, b) = colours(upper, lower);
            let green = (u16::from(g) + u16::from(h)) / 2;
            [sum.rgb(r, green as u8, b); 2]
        });
    }

    /// Hands out each stretch with its values, `PIXELS` at a time; weighs by single pixels what is left over at the
    /// end of an odd row.
    fn each_stretch<const PIXELS: usize>(
        &mut self,
        frame: &Frame<'_>,
        sum: Sum,
        mut weigh: impl FnMut(&Stretch, &mut [[u8; PIXELS]]),
    ) {
        let mut plane = self.plane.as_mut_slice();
        for stretch in &self.stretches {
            let (values, rest) = std::mem::take(&mut plane).split_at_mut(stretch.width_px);
            plane = rest;
            let (whole, left_over) = values.as_chunks_mut();
            weigh(stretch, whole);
            let column = stretch.column + stretch.width_px - left_over.len();
            for (value, column) in left_over.iter_mut().zip(column..) {
                *value = sum.of(frame.native(column, stretch.row));
            }
        }
    }
}

/// Classes of chosen pixels.
#[derive(Debug, Clone)]
pub(crate) struct ClassReader {
    /// Column and row.
    places: Vec<[u16; 2]>,
    /// First byte of each place in a frame of `layout`, where a pixel has bytes of its own.
    offsets: Vec<u32>,
    layout: Option<(PixelFormat, usize)>,
}

/// So many are classified at a time: wide enough for vector registers, small enough for the stack.
pub(crate) const BATCH: usize = 64;

impl ClassReader {
    /// `places`: column and row of each pixel.
    pub(crate) fn new(places: Vec<[u16; 2]>) -> Self {
        ClassReader {
            offsets: Vec::with_capacity(places.len()),
            places,
            layout: None,
        }
    }

    /// One class a place of a range of them; the frame was checked.
    pub(crate) fn read(
        &mut self,
        frame: &Frame<'_>,
        table: &NativeTable,
        range: Range<usize>,
        classes: &mut [Class],
    ) {
        let layout = (frame.format, frame.stride);
        if self.layout != Some(layout) {
            let offset = |&[u, v]: &[u16; 2]| usize::from(v) * frame.stride + 3 * usize::from(u);
            self.offsets.clear();
            self.offsets
                .extend(self.places.iter().map(|place| offset(place) as u32));
            self.layout = Some(layout);
        }
        match frame.format {
            PixelFormat::Rgb8 => {
                let pixel = |&offset: &u32| three(frame.data, offset as usize);
                read_classes(&self.offsets[range], pixel, table, classes);
            }
            PixelFormat::Bgr8 => {
                let pixel = |&offset: &u32| three(frame.data, offset as usize).swap_bytes() >> 8;
                read_classes(&self.offsets[range], pixel, table, classes);
            }
            _ => {
                let pixel = |&[u, v]: &[u16; 2]| {
                    let [a, b, c] = frame.native(usize::from(u), usize::from(v));
                    u32::from_le_bytes([a, b, c, 0])
                };
                read_classes(&self.places[range], pixel, table, classes);
            }
        }
    }

    /// Column and row of each.
    pub(crate) fn places(&self) -> &[[u16; 2]] {
        &self.places
    }

    /// How many places there are.
    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }
}

/// Reads all places; `pixel` gives the channels at a place, the first in the lowest byte.
fn read_classes<P>(
    places: &[P],
    pixel: impl Fn(&P) -> u32,
    table: &NativeTable,
    classes: &mut [Class],
) {
    let mut pixels = [0u32; BATCH];
    for (places, classes) in places.chunks(BATCH).zip(classes.chunks_mut(BATCH)) {
        for (slot, place) in pixels.iter_mut().zip(places) {
            *slot = pixel(place);
        }
        let cells = pixels.map(NativeTable::cell);
        table.fetch(&cells[..classes.len()], classes);
    }
}

/// Weighted sum of a pixel's channels as the camera has them, of 256.
#[derive(Clone, Copy)]
struct Sum {
    weights: [i32; 3],
    constant: i32,
}

impl Sum {
    /// `weights` of red, green and blue, of 256.
    fn new(weights: [u32; 3], format: PixelFormat) -> Self {
        if !format.is_yuv() {
            return Sum {
                weights: weights.map(|weight| weight as i32),
                constant: 0,
            };
        }
        // What U and V add to Y so that the sum is that of red, green and blue (BT.601).
        let [r, g, b] = weights.map(|weight| weight as f32);
        let by_u = (1.772 * b - 0.344_136 * g).round() as i32;
        let by_v = (1.402 * r - 0.714_136 * g).round() as i32;
        Sum {
            weights: [256, by_u, by_v],
            constant: -128 * (by_u + by_v),
        }
    }

    #[inline]
    fn of(self, channels: [u8; 3]) -> u8 {
        let [a, b, c] = self.weights;
        let [x, y, z] = channels.map(i32::from);
        let sum = a * x + b * y + c * z + self.constant;
        (sum >> 8).clamp(0, 255) as u8
    }

    /// The same for red, green and blue in half the width, since their weights sum to 256.
    #[inline]
    fn rgb(self, r: u8, g: u8, b: u8) -> u8 {
        let [by_r, by_g, by_b] = self.weights.map(|weight| weight as u16);
        let sum = by_r * u16::from(r) + by_g * u16::from(g) + by_b * u16::from(b);
        (sum >> 8) as u8
    }
}

/// Three bytes from an offset, the first lowest; one load where a fourth byte follows.
#[inline]
fn three(data: &[u8], offset: usize) -> u32 {
    match data.get(offset..offset + 4) {
        Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        _ => u32::from_le_bytes([data[offset], data[offset + 1], data[offset + 2], 0]),
    }
}
