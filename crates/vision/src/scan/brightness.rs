//! Weighted brightness of the scan lines' samples, computed from the camera's own bytes.
//!
//! Weighting a contiguous span of a row with vector instructions is faster than fetching single pixels. So whole spans
//! around the samples are weighted, and the scan lines gather their values from the cached result.

use std::ops::Range;

use crate::image::{ImageView, PixelFormat};
use crate::scan::pattern::{ScanLines, ScanPattern, ScanSample};
use crate::scan::rgb_weights::RgbWeights;

/// Computes the samples' brightness row by row.
#[derive(Debug, Clone)]
pub(crate) struct BrightnessReader {
    /// Row by row, for all scan lines, the even and the odd ones.
    spans: [Vec<RowSpan>; 3],
    /// Brightness of the spans' pixels, span after span.
    plane: Vec<u8>,
    /// Index of each sample in `plane`.
    plane_indices: Vec<u32>,
}

/// Contiguous pixels of a row.
#[derive(Debug, Clone, Copy)]
struct RowSpan {
    row: usize,
    /// First column; a multiple of [`SPAN_ALIGNMENT`].
    column: usize,
    width_px: usize,
    /// Index of its first pixel in the plane.
    plane_start: usize,
}

/// Spans are aligned so that they start at whole bytes in every format: in 4:1:1 four pixels share their chroma.
const SPAN_ALIGNMENT: usize = 4;

/// Gaps of up to this many unused pixels do not split a span: starting a new vector loop costs about as much.
const SPAN_GAP_MAX: usize = 32;

impl BrightnessReader {
    /// The pattern's samples in an image of this size.
    pub(crate) fn new(pattern: &ScanPattern, width_px: usize, height_px: usize) -> Self {
        let pixel = |sample: &ScanSample| usize::from(sample.v) * width_px + usize::from(sample.u);
        let mut spans = [ScanLines::All, ScanLines::Even, ScanLines::Odd].map(|lines| {
            let mut needed = vec![false; width_px * height_px];
            for segment in pattern.segments_of(lines) {
                for sample in &pattern.samples[segment.samples()] {
                    needed[pixel(sample)] = true;
                }
            }
            row_spans(&needed, width_px)
        });
        let mut plane_index = vec![0u32; width_px * height_px];
        let mut length = 0;
        for span in &spans[ScanLines::All as usize] {
            let start = span.row * width_px + span.column;
            for place in &mut plane_index[start..start + span.width_px] {
                *place = length;
                length += 1;
            }
        }
        // Spans of half of the lines lie within those of all: what they join, all of them join as well.
        for span in spans.iter_mut().flatten() {
            span.plane_start = plane_index[span.row * width_px + span.column] as usize;
        }
        let plane_indices = pattern
            .samples
            .iter()
            .map(|sample| plane_index[pixel(sample)])
            .collect();
        BrightnessReader {
            spans,
            plane: vec![0; length as usize],
            plane_indices,
        }
    }

    /// Weights the channels of the lines' spans in these rows; weights of 256. The image must have been checked.
    pub(crate) fn read(
        &mut self,
        image: &ImageView<'_>,
        weights: [u32; 3],
        lines: ScanLines,
        rows: &Range<usize>,
    ) {
        let sum = ChannelWeights::new(weights, image.format);
        let selection = &Selection { lines, rows };
        let [r, g, b] = weights.map(|weight| weight as u16);
        // Captured by value: a reference would be reloaded for each pixel.
        let yuv = move |y, u, v| sum.apply([y, u, v]);
        match image.format {
            PixelFormat::Grey8 => self.weigh(image, sum, selection, move |&[y]: &[u8; 1]| {
                [sum.rgb(y, y, y)]
            }),
            PixelFormat::Rgb8 => self.weigh_rgb(image, sum, selection, [r, g, b]),
            PixelFormat::Bgr8 => {
                self.weigh_rgb(image, sum, selection, [b, g, r]);
            }
            PixelFormat::Yuyv => {
                self.weigh(image, sum, selection, move |&[y, u, z, v]| {
                    [yuv(y, u, v), yuv(z, u, v)]
                });
            }
            PixelFormat::Uyvy => {
                self.weigh(image, sum, selection, move |&[u, y, v, z]| {
                    [yuv(y, u, v), yuv(z, u, v)]
                });
            }
            PixelFormat::Yuv411 => self.weigh(image, sum, selection, move |&[u, a, b, v, c, d]| {
                [yuv(a, u, v), yuv(b, u, v), yuv(c, u, v), yuv(d, u, v)]
            }),
            PixelFormat::Nv12 => {
                let both = |row| [row, image.height_px + row / 2];
                let pair = move |&[y, z]: &[u8; 2], &[u, v]: &[u8; 2]| [yuv(y, u, v), yuv(z, u, v)];
                self.weigh_pairs(image, sum, selection, both, pair);
            }
            PixelFormat::BayerRggb => {
                self.weigh_cells(image, sum, selection, |&[r, g], &[h, b]| BayerCell {
                    r,
                    g,
                    h,
                    b,
                })
            }
            PixelFormat::BayerBggr => {
                self.weigh_cells(image, sum, selection, |&[b, g], &[h, r]| BayerCell {
                    r,
                    g,
                    h,
                    b,
                })
            }
            PixelFormat::BayerGrbg => {
                self.weigh_cells(image, sum, selection, |&[g, r], &[b, h]| BayerCell {
                    r,
                    g,
                    h,
                    b,
                })
            }
            PixelFormat::BayerGbrg => {
                self.weigh_cells(image, sum, selection, |&[g, b], &[r, h]| BayerCell {
                    r,
                    g,
                    h,
                    b,
                })
            }
        }
    }

    /// Brightness of a range of samples in the last image read; their scan line must have been among those read.
    pub(crate) fn gather(&self, samples: Range<usize>, values: &mut [u8]) {
        // A local slice: `self` would be reloaded for each sample.
        let plane = self.plane.as_slice();
        let value = |at: u32| plane[at as usize];
        let (blocks, rest) = values.as_chunks_mut::<8>();
        let (at_blocks, at_rest) = self.plane_indices[samples].as_chunks::<8>();
        // Eight at a time, to amortise the loop overhead.
        for (block, at) in blocks.iter_mut().zip(at_blocks) {
            for (slot, &at) in block.iter_mut().zip(at) {
                *slot = value(at);
            }
        }
        for (slot, &at) in rest.iter_mut().zip(at_rest) {
            *slot = value(at);
        }
    }

    /// Weights pixels of three bytes; `weights`: of the bytes in their order, of 256.
    fn weigh_rgb(
        &mut self,
        image: &ImageView<'_>,
        sum: ChannelWeights,
        selection: &Selection<'_>,
        weights: [u16; 3],
    ) {
        let weights = RgbWeights::new(weights);
        self.for_each_span(image, sum, selection, |span, values: &mut [[u8; 1]]| {
            let start = span.row * image.stride + 3 * span.column;
            let bytes = &image.data[start..start + 3 * values.len()];
            weights.weigh(bytes, values.as_flattened_mut());
        });
    }

    /// Weights formats that pack `PIXELS` pixels into `BYTES` bytes.
    fn weigh<const BYTES: usize, const PIXELS: usize>(
        &mut self,
        image: &ImageView<'_>,
        sum: ChannelWeights,
        selection: &Selection<'_>,
        weigh: impl Fn(&[u8; BYTES]) -> [u8; PIXELS],
    ) {
        self.for_each_span(
            image,
            sum,
            selection,
            |span, values: &mut [[u8; PIXELS]]| {
                let start = span.row * image.stride + span.column / PIXELS * BYTES;
                let bytes = &image.data[start..start + BYTES * values.len()];
                for (values, bytes) in values.iter_mut().zip(bytes.as_chunks().0) {
                    *values = weigh(bytes);
                }
            },
        );
    }

    /// Weights pairs of pixels whose bytes are in two rows of the data; `both` returns these rows.
    fn weigh_pairs(
        &mut self,
        image: &ImageView<'_>,
        sum: ChannelWeights,
        selection: &Selection<'_>,
        both: impl Fn(usize) -> [usize; 2],
        weigh: impl Fn(&[u8; 2], &[u8; 2]) -> [u8; 2],
    ) {
        self.for_each_span(image, sum, selection, |span, values: &mut [[u8; 2]]| {
            let [first, second] = both(span.row).map(|row| {
                let start = row * image.stride + span.column;
                image.data[start..start + 2 * values.len()].as_chunks().0
            });
            for ((values, first), second) in values.iter_mut().zip(first).zip(second) {
                *values = weigh(first, second);
            }
        });
    }

    /// Weights the cells of a colour filter; `colours` orders a cell's bytes.
    fn weigh_cells(
        &mut self,
        image: &ImageView<'_>,
        sum: ChannelWeights,
        selection: &Selection<'_>,
        colours: impl Fn(&[u8; 2], &[u8; 2]) -> BayerCell,
    ) {
        // The last row of an odd height has no complete cell, see `ImageView::native_channels`.
        let last = (image.height_px & !1).saturating_sub(2);
        let both = |row: usize| {
            let upper = (row & !1).min(last);
            [upper, (upper + 1).min(image.height_px - 1)]
        };
        self.weigh_pairs(image, sum, selection, both, move |upper, lower| {
            let BayerCell { r, g, h, b } = colours(upper, lower);
            let green = (u16::from(g) + u16::from(h)) / 2;
            [sum.rgb(r, green as u8, b); 2]
        });
    }

    /// Calls `weigh` with each selected span and its values, `PIXELS` at a time; weights the remaining pixels of
    /// an odd row one by one.
    fn for_each_span<const PIXELS: usize>(
        &mut self,
        image: &ImageView<'_>,
        sum: ChannelWeights,
        &Selection { lines, rows }: &Selection<'_>,
        mut weigh: impl FnMut(&RowSpan, &mut [[u8; PIXELS]]),
    ) {
        let spans = &self.spans[lines as usize];
        let first = spans.partition_point(|it| it.row < rows.start);
        let here = spans[first..].iter();
        for span in here.take_while(|it| it.row < rows.end) {
            let values = &mut self.plane[span.plane_start..span.plane_start + span.width_px];
            let (whole, left_over) = values.as_chunks_mut();
            weigh(span, whole);
            let column = span.column + span.width_px - left_over.len();
            for (value, column) in left_over.iter_mut().zip(column..) {
                *value = sum.apply(image.native_channels(column, span.row));
            }
        }
    }
}

/// What is read at once.
struct Selection<'a> {
    lines: ScanLines,
    rows: &'a Range<usize>,
}

/// Spans around the needed pixels, row by row. `plane_start` is not set yet.
fn row_spans(needed: &[bool], width_px: usize) -> Vec<RowSpan> {
    let mut spans: Vec<RowSpan> = Vec::new();
    for (row, needed) in needed.chunks_exact(width_px.max(1)).enumerate() {
        let row_start = spans.len();
        for (group, needed) in needed.chunks(SPAN_ALIGNMENT).enumerate() {
            if !needed.contains(&true) {
                continue;
            }
            let (column, end) = (
                group * SPAN_ALIGNMENT,
                group * SPAN_ALIGNMENT + needed.len(),
            );
            match spans[row_start..].last_mut() {
                Some(last) if column <= last.column + last.width_px + SPAN_GAP_MAX => {
                    last.width_px = end - last.column;
                }
                _ => spans.push(RowSpan {
                    row,
                    column,
                    width_px: needed.len(),
                    plane_start: 0,
                }),
            }
        }
    }
    spans
}

/// Red, both greens and blue of a 2 × 2 cell of the colour filter.
struct BayerCell {
    r: u8,
    g: u8,
    h: u8,
    b: u8,
}

/// Weights of the camera's own channels, of 256.
#[derive(Clone, Copy)]
struct ChannelWeights {
    weights: [i32; 3],
    constant: i32,
}

impl ChannelWeights {
    /// `weights`: of red, green and blue, of 256.
    fn new(weights: [u32; 3], format: PixelFormat) -> Self {
        if !format.is_yuv() {
            return ChannelWeights {
                weights: weights.map(|weight| weight as i32),
                constant: 0,
            };
        }
        // Weights of U and V that make the sum equal to that of red, green and blue (BT.601).
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

    /// Same for RGB in 16-bit arithmetic, which suffices since the weights sum to 256.
    #[inline]
    fn rgb(self, r: u8, g: u8, b: u8) -> u8 {
        let [by_r, by_g, by_b] = self.weights.map(|weight| weight as u16);
        let sum = by_r * u16::from(r) + by_g * u16::from(g) + by_b * u16::from(b);
        (sum >> 8) as u8
    }
}
