//! Classifies a fixed set of pixels, row by row in memory order.

use std::ops::Range;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::{ImageView, PixelFormat, load_pixel};

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
    /// First byte of each pixel in an image of `layout` (RGB only).
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
                let offsets = &self.byte_offsets[here];
                classify(offsets, outputs, table, classes, |offsets, cells| {
                    for (cell, &offset) in cells.iter_mut().zip(offsets) {
                        *cell = load_pixel(image.data, offset as usize);
                    }
                });
            }
            _ => {
                let pixels = &self.pixels[here];
                classify(pixels, outputs, table, classes, |pixels, cells| {
                    image.read_native(pixels, cells);
                });
            }
        }
    }
}

/// Classifies pixels; `read` reads the channels of a batch, the first in the lowest byte.
fn classify<P>(
    pixels: &[P],
    outputs: &[u32],
    table: &ColourLookupTable,
    classes: &mut [ColourClass],
    read: impl Fn(&[P], &mut [u32; BATCH]),
) {
    let mut cells = [0u32; BATCH];
    for (pixels, outputs) in pixels.chunks(BATCH).zip(outputs.chunks(BATCH)) {
        read(pixels, &mut cells);
        for cell in &mut cells {
            *cell = ColourLookupTable::cell_index(*cell);
        }
        table.scatter(&cells, outputs, classes);
    }
}
