//! Classifies a fixed set of pixels, row by row in memory order.

use std::ops::Range;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::{ImageView, PixelFormat, load_pixels};

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
    /// Channels, then cells of the table, of the pixels that are being classified.
    cells: Vec<u32>,
}

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
            cells: Vec::new(),
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
        let cells = &mut self.cells;
        cells.resize(here.len(), 0);
        // One step for all of them after the other: a vector cannot be read back until its parts have left the core's buffers.
        match image.format {
            PixelFormat::Rgb8 => load_pixels(image.data, &self.byte_offsets[here], cells),
            _ => image.read_native(&self.pixels[here], cells),
        }
        for cell in &mut *cells {
            *cell = ColourLookupTable::cell_index(*cell);
        }
        table.scatter(cells, outputs, classes);
    }
}
