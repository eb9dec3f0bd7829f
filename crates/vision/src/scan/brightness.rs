//! How bright is what the scan lines cross? Every sample's brightness, straight from the camera's own bytes.
//!
//! Vector registers weigh the channels of a whole stretch of a row faster than single pixels of it are fetched. So
//! the rows are weighed wherever scan lines cross them, and the lines pick their bytes from what stays in a core's
//! cache.

use std::ops::Range;

use crate::image::{ImageView, PixelFormat};

/// Brightness of the samples, by way of the rows that they lie in.
#[derive(Debug, Clone)]
pub(crate) struct BrightnessReader {
    /// Row by row.
    spans: Vec<RowSpan>,
    /// Brightness of the stretches' pixels, one stretch after the other.
    plane: Vec<u8>,
    /// Where each sample is in `plane`.
    plane_indices: Vec<u32>,
}

/// Neighbouring pixels of a row.
#[derive(Debug, Clone, Copy)]
struct RowSpan {
    row: usize,
    /// The first of them; a multiple of [`GROUP`].
    column: usize,
    width_px: usize,
    /// Where its pixels begin in the plane.
    plane_start: usize,
}

/// Stretches begin where a pixel's bytes begin in every format: four share their chroma in 4:1:1.
const SPAN_ALIGNMENT: usize = 4;

/// So many pixels that nobody asks for are weighed rather than a new stretch begun: about what a vector loop's start
/// and end cost.
const SPAN_GAP_MAX: usize = 32;

impl BrightnessReader {
    /// `places`: column and row of each sample in an image of this size.
    pub(crate) fn new(places: &[[u16; 2]], width_px: usize, height_px: usize) -> Self {
        let pixel = |&[u, v]: &[u16; 2]| usize::from(v) * width_px + usize::from(u);
        let mut wanted = vec![false; width_px * height_px];
        for place in places {
            wanted[pixel(place)] = true;
        }
        let mut stretches: Vec<RowSpan> = Vec::new();
        for (row, wanted) in wanted.chunks_exact(width_px.max(1)).enumerate() {
            let begun = stretches.len();
            for (group, wanted) in wanted.chunks(SPAN_ALIGNMENT).enumerate() {
                if !wanted.contains(&true) {
                    continue;
                }
                let (column, end) = (
                    group * SPAN_ALIGNMENT,
                    group * SPAN_ALIGNMENT + wanted.len(),
                );
                match stretches[begun..].last_mut() {
                    Some(last) if column <= last.column + last.width_px + SPAN_GAP_MAX => {
                        last.width_px = end - last.column;
                    }
                    _ => stretches.push(RowSpan {
                        row,
                        column,
                        width_px: wanted.len(),
                        plane_start: 0,
                    }),
                }
            }
        }
        let mut place_of = vec![0u32; width_px * height_px];
        let mut length = 0;
        for stretch in &mut stretches {
            stretch.plane_start = length as usize;
            let start = stretch.row * width_px + stretch.column;
            for place in &mut place_of[start..start + stretch.width_px] {
                *place = length;
                length += 1;
            }
        }
        BrightnessReader {
            spans: stretches,
            plane: vec![0; length as usize],
            plane_indices: places.iter().map(|place| place_of[pixel(place)]).collect(),
        }
    }

    /// Weighs the channels of every pixel of these rows that the samples need, weights of 256; the frame was checked.
    pub(crate) fn read(&mut self, frame: &ImageView<'_>, weights: [u32; 3], rows: &Range<usize>) {
        let sum = ChannelWeights::new(weights, frame.format);
        // Copies, since what is behind a reference would be read anew for each pixel.
        let three = move |&[r, g, b]: &[u8; 3]| sum.rgb(r, g, b);
        let yuv = move |y, u, v| sum.apply([y, u, v]);
        match frame.format {
            PixelFormat::Grey8 => {
                self.weigh(frame, sum, rows, move |&[y]: &[u8; 1]| [three(&[y; 3])])
            }
            PixelFormat::Rgb8 => self.weigh(frame, sum, rows, move |rgb| [three(rgb)]),
            PixelFormat::Bgr8 => {
                self.weigh(frame, sum, rows, move |&[b, g, r]| [three(&[r, g, b])])
            }
            PixelFormat::Yuyv => {
                self.weigh(frame, sum, rows, move |&[y, u, z, v]| {
                    [yuv(y, u, v), yuv(z, u, v)]
                });
            }
            PixelFormat::Uyvy => {
                self.weigh(frame, sum, rows, move |&[u, y, v, z]| {
                    [yuv(y, u, v), yuv(z, u, v)]
                });
            }
            PixelFormat::Yuv411 => self.weigh(frame, sum, rows, move |&[u, a, b, v, c, d]| {
                [yuv(a, u, v), yuv(b, u, v), yuv(c, u, v), yuv(d, u, v)]
            }),
            PixelFormat::Nv12 => {
                let both = |row| [row, frame.height_px + row / 2];
                let pair = move |&[y, z]: &[u8; 2], &[u, v]: &[u8; 2]| [yuv(y, u, v), yuv(z, u, v)];
                self.weigh_pairs(frame, sum, rows, both, pair);
            }
            PixelFormat::BayerRggb => {
                self.weigh_cells(frame, sum, rows, |&[r, g], &[h, b]| (r, g, h, b))
            }
            PixelFormat::BayerBggr => {
                self.weigh_cells(frame, sum, rows, |&[b, g], &[h, r]| (r, g, h, b))
            }
            PixelFormat::BayerGrbg => {
                self.weigh_cells(frame, sum, rows, |&[g, r], &[b, h]| (r, g, h, b))
            }
            PixelFormat::BayerGbrg => {
                self.weigh_cells(frame, sum, rows, |&[g, b], &[r, h]| (r, g, h, b))
            }
        }
    }

    /// The values of a range of samples in the frame that was read last, one a sample.
    pub(crate) fn gather(&self, samples: Range<usize>, values: &mut [u8]) {
        // A copy of the slice: what is behind `self` would be read anew for each sample.
        let plane = self.plane.as_slice();
        let value = |at: u32| plane[at as usize];
        let (blocks, rest) = values.as_chunks_mut::<8>();
        let (at_blocks, at_rest) = self.plane_indices[samples].as_chunks::<8>();
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
        frame: &ImageView<'_>,
        sum: ChannelWeights,
        rows: &Range<usize>,
        weigh: impl Fn(&[u8; BYTES]) -> [u8; PIXELS],
    ) {
        self.for_each_span(frame, sum, rows, |stretch, values: &mut [[u8; PIXELS]]| {
            let start = stretch.row * frame.stride + stretch.column / PIXELS * BYTES;
            let bytes = &frame.data[start..start + BYTES * values.len()];
            for (values, bytes) in values.iter_mut().zip(bytes.as_chunks().0) {
                *values = weigh(bytes);
            }
        });
    }

    /// Weighs pairs of pixels whose bytes lie in two rows of the frame's data, `both` of a row.
    fn weigh_pairs(
        &mut self,
        frame: &ImageView<'_>,
        sum: ChannelWeights,
        rows: &Range<usize>,
        both: impl Fn(usize) -> [usize; 2],
        weigh: impl Fn(&[u8; 2], &[u8; 2]) -> [u8; 2],
    ) {
        self.for_each_span(frame, sum, rows, |stretch, values: &mut [[u8; 2]]| {
            let [first, second] = both(stretch.row).map(|row| {
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
        frame: &ImageView<'_>,
        sum: ChannelWeights,
        rows: &Range<usize>,
        colours: impl Fn(&[u8; 2], &[u8; 2]) -> (u8, u8, u8, u8),
    ) {
        // The last row of an odd number has no cell of its own, see [`Frame::native`].
        let last = (frame.height_px & !1).saturating_sub(2);
        let both = |row: usize| {
            let upper = (row & !1).min(last);
            [upper, (upper + 1).min(frame.height_px - 1)]
        };
        self.weigh_pairs(frame, sum, rows, both, move |upper, lower| {
            let (r, g, h, b) = colours(upper, lower);
            let green = (u16::from(g) + u16::from(h)) / 2;
            [sum.rgb(r, green as u8, b); 2]
        });
    }

    /// Hands out each stretch of these rows with its values, `PIXELS` at a time; weighs by single pixels what is left over at the
    /// end of an odd row.
    fn for_each_span<const PIXELS: usize>(
        &mut self,
        frame: &ImageView<'_>,
        sum: ChannelWeights,
        rows: &Range<usize>,
        mut weigh: impl FnMut(&RowSpan, &mut [[u8; PIXELS]]),
    ) {
        let first = self.spans.partition_point(|it| it.row < rows.start);
        let here = self.spans[first..].iter();
        for stretch in here.take_while(|it| it.row < rows.end) {
            let values =
                &mut self.plane[stretch.plane_start..stretch.plane_start + stretch.width_px];
            let (whole, left_over) = values.as_chunks_mut();
            weigh(stretch, whole);
            let column = stretch.column + stretch.width_px - left_over.len();
            for (value, column) in left_over.iter_mut().zip(column..) {
                *value = sum.apply(frame.native_channels(column, stretch.row));
            }
        }
    }
}

/// Weighted sum of a pixel's channels as the camera has them, of 256.
#[derive(Clone, Copy)]
struct ChannelWeights {
    weights: [i32; 3],
    constant: i32,
}

impl ChannelWeights {
    /// `weights` of red, green and blue, of 256.
    fn new(weights: [u32; 3], format: PixelFormat) -> Self {
        if !format.is_yuv() {
            return ChannelWeights {
                weights: weights.map(|weight| weight as i32),
                constant: 0,
            };
        }
        // What U and V add to Y so that the sum is that of red, green and blue (BT.601).
        let [r, g, b] = weights.map(|weight| weight as f32);
        let by_u = (1.772 * b - 0.344_136 * g).round() as i32;
        let by_v = (1.402 * r - 0.714_136 * g).round() as i32;
        ChannelWeights {
            weights: [256, by_u, by_v],
            constant: -128 * (by_u + by_v),
        }
    }

    #[inline]
    fn apply(self, channels: [u8; 3]) -> u8 {
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
