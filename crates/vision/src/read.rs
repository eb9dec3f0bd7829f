//! What do the scanned pixels show? Brightness and class of every sample, straight from the camera's own bytes.
//!
//! Scan lines cross the image's rows, so reading along them would fetch almost every sample from a cache line of its
//! own. Samples are read in the order of the rows instead, and each reading is put where its sample belongs.

use crate::colours::{Class, NativeTable};
use crate::image::{Frame, PixelFormat};

/// The samples' places, packed for the one loop that touches every scanned pixel.
#[derive(Debug, Clone)]
pub(crate) struct Reader {
    /// Column and row, row by row.
    places: Vec<[u16; 2]>,
    /// Which sample each place is.
    samples: Vec<u32>,
    /// First byte of each place in a frame of `layout`.
    offsets: Vec<u32>,
    layout: Option<(PixelFormat, usize)>,
    /// Value and class, one a sample.
    readings: Vec<(u8, Class)>,
}

/// Samples are weighed and classified so many at a time: wide enough for vector registers, small enough for the stack.
const BATCH: usize = 64;

impl Reader {
    /// `places`: column and row of each sample.
    pub(crate) fn new(places: &[[u16; 2]]) -> Self {
        let mut samples: Vec<u32> = (0..places.len() as u32).collect();
        samples.sort_by_key(|&sample| {
            let [u, v] = places[sample as usize];
            (v, u)
        });
        Reader {
            places: samples.iter().map(|&s| places[s as usize]).collect(),
            readings: vec![(0, Class::OTHER); places.len()],
            samples,
            offsets: Vec::new(),
            layout: None,
        }
    }

    /// One value (weighted channels, weights of 256) and one class a sample; the frame was checked.
    pub(crate) fn read(
        &mut self,
        frame: &Frame<'_>,
        table: &NativeTable,
        weights: [u32; 3],
    ) -> &[(u8, Class)] {
        let layout = (frame.format, frame.stride);
        if self.layout != Some(layout) {
            // Used where a pixel has bytes of its own.
            self.offsets = self
                .places
                .iter()
                .map(|&[u, v]| (usize::from(v) * frame.stride + 3 * usize::from(u)) as u32)
                .collect();
            self.layout = Some(layout);
        }
        let sum = Sum::new(weights, frame.format);
        let (samples, readings) = (&self.samples, &mut self.readings);
        match frame.format {
            PixelFormat::Rgb8 => {
                let pixel = |&offset: &u32| three(frame.data, offset as usize);
                read(&self.offsets, samples, pixel, &sum, table, readings);
            }
            PixelFormat::Bgr8 => {
                let pixel = |&offset: &u32| three(frame.data, offset as usize).swap_bytes() >> 8;
                read(&self.offsets, samples, pixel, &sum, table, readings);
            }
            _ => {
                let pixel = |&[u, v]: &[u16; 2]| {
                    let [a, b, c] = frame.native(usize::from(u), usize::from(v));
                    u32::from_le_bytes([a, b, c, 0])
                };
                read(&self.places, samples, pixel, &sum, table, readings);
            }
        }
        &self.readings
    }
}

/// Reads all places; `pixel` gives the channels at a place, the first in the lowest byte.
fn read<P>(
    places: &[P],
    samples: &[u32],
    pixel: impl Fn(&P) -> u32,
    sum: &Sum,
    table: &NativeTable,
    readings: &mut [(u8, Class)],
) {
    let mut pixels = [0u32; BATCH];
    for (places, samples) in places.chunks(BATCH).zip(samples.chunks(BATCH)) {
        for (slot, place) in pixels.iter_mut().zip(places) {
            *slot = pixel(place);
        }
        let values = pixels.map(|pixel| sum.of(pixel));
        let cells = pixels.map(NativeTable::cell);
        for ((&sample, value), cell) in samples.iter().zip(values).zip(cells) {
            readings[sample as usize] = (value, table.at(cell));
        }
    }
}

/// Weighted sum of a pixel's channels as the camera has them, of 256.
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
    fn of(&self, pixel: u32) -> u8 {
        let channel = |shift: u32| (pixel >> shift & 255) as i32;
        let [a, b, c] = self.weights;
        let sum = a * channel(0) + b * channel(8) + c * channel(16) + self.constant;
        (sum >> 8).clamp(0, 255) as u8
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
