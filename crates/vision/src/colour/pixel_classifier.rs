//! Classifies a fixed set of pixels, row by row in memory order.

use std::ops::Range;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::{ImageView, PixelFormat};

/// Classifies a fixed set of pixels.
///
/// Scan lines and rays cross many rows, which scatters their reads over memory. Sorted by rows, reads are nearly
/// sequential, and only the one-byte results are scattered.
#[derive(Debug, Clone)]
pub(crate) struct PixelClassifier {
    /// Column and row, row by row.
    pixels: Vec<[u16; 2]>,
    /// Output index of each of them.
    output_indices: Vec<u32>,
    /// Start of each row in both, and one past the last.
    row_starts: Vec<u32>,
    /// First byte of each pixel in an image of `layout` (RGB and BGR only).
    byte_offsets: Vec<u32>,
    layout: Option<(PixelFormat, usize)>,
}

/// Pixels per batch: enough for vector registers, small enough for the stack.
const BATCH: usize = 64;

impl PixelClassifier {
    /// `pixels`: column and row of each, in an image of this height.
    pub(crate) fn new(pixels: &[[u16; 2]], height_px: usize) -> Self {
        let mut sorted: Vec<([u16; 2], u32)> = pixels.iter().copied().zip(0..).collect();
        sorted.sort_by_key(|&([column, row], _)| (row, column));
        let start = |row| sorted.partition_point(|([_, v], _)| usize::from(*v) < row) as u32;
        PixelClassifier {
            row_starts: (0..=height_px).map(start).collect(),
            pixels: sorted.iter().map(|(pixel_at, _)| *pixel_at).collect(),
            output_indices: sorted.iter().map(|(_, number)| *number).collect(),
            byte_offsets: Vec::with_capacity(pixels.len()),
            layout: None,
        }
    }

    /// Classifies the pixels of these rows into `classes`, one entry per pixel. The image must have been checked.
    pub(crate) fn classify_rows(
        &mut self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        rows: &Range<usize>,
        classes: &mut [ColourClass],
    ) {
        let layout = (image.format, image.stride);
        if self.layout != Some(layout) {
            let offset = |&[u, v]: &[u16; 2]| usize::from(v) * image.stride + 3 * usize::from(u);
            let offsets = self.pixels.iter().map(|pixel_at| offset(pixel_at) as u32);
            self.byte_offsets.clear();
            self.byte_offsets.extend(offsets);
            self.layout = Some(layout);
        }
        let here = self.row_starts[rows.start] as usize..self.row_starts[rows.end] as usize;
        let outputs = &self.output_indices[here.clone()];
        match image.format {
            PixelFormat::Rgb8 => {
                let pixel = |&offset: &u32| load_three_bytes(image.data, offset as usize);
                classify(&self.byte_offsets[here], outputs, pixel, table, classes);
            }
            PixelFormat::Bgr8 => {
                let pixel =
                    |&offset: &u32| load_three_bytes(image.data, offset as usize).swap_bytes() >> 8;
                classify(&self.byte_offsets[here], outputs, pixel, table, classes);
            }
            _ => {
                let pixel = |&[u, v]: &[u16; 2]| {
                    let [a, b, c] = image.native_channels(usize::from(u), usize::from(v));
                    u32::from_le_bytes([a, b, c, 0])
                };
                classify(&self.pixels[here], outputs, pixel, table, classes);
            }
        }
    }
}

/// Classifies pixels; `pixel` returns the channels of one, the first in the lowest byte.
fn classify<P>(
    pixels: &[P],
    outputs: &[u32],
    pixel: impl Fn(&P) -> u32,
    table: &ColourLookupTable,
    classes: &mut [ColourClass],
) {
    let mut cells = [0u32; BATCH];
    for (pixels, outputs) in pixels.chunks(BATCH).zip(outputs.chunks(BATCH)) {
        for (slot, pixel_at) in cells.iter_mut().zip(pixels) {
            *slot = pixel(pixel_at);
        }
        for cell in &mut cells {
            *cell = ColourLookupTable::cell_index(*cell);
        }
        table.scatter(&cells, outputs, classes);
    }
}

/// Three bytes from an offset, the first lowest; a single load if a fourth byte exists.
#[inline]
fn load_three_bytes(data: &[u8], offset: usize) -> u32 {
    match data.get(offset..offset + 4) {
        Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        _ => u32::from_le_bytes([data[offset], data[offset + 1], data[offset + 2], 0]),
    }
}
