//! What class has each of chosen pixels? Read row by row, as the camera's bytes lie in memory.

use std::ops::Range;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::{ImageView, PixelFormat};

/// Classes of chosen pixels.
///
/// Scan lines and rays run across an image's rows, and a step to the next row is one to another part of memory. Sorted
/// by rows the same pixels are fetched from where the core just was; only their classes, a byte each, are strewn.
#[derive(Debug, Clone)]
pub(crate) struct PixelClassifier {
    /// Column and row, row by row.
    pixels: Vec<[u16; 2]>,
    /// Which of the places asked for each of them is.
    output_indices: Vec<u32>,
    /// Where each row begins in both, and one past the last.
    row_starts: Vec<u32>,
    /// First byte of each place in a frame of `layout`, where a pixel has bytes of its own.
    byte_offsets: Vec<u32>,
    layout: Option<(PixelFormat, usize)>,
}

/// So many are classified at a time: wide enough for vector registers, small enough for the stack.
const BATCH: usize = 64;

impl PixelClassifier {
    /// `places`: column and row of each pixel in an image of this height.
    pub(crate) fn new(places: &[[u16; 2]], height_px: usize) -> Self {
        let mut sorted: Vec<([u16; 2], u32)> = places.iter().copied().zip(0..).collect();
        sorted.sort_by_key(|&([column, row], _)| (row, column));
        let start = |row| sorted.partition_point(|([_, v], _)| usize::from(*v) < row) as u32;
        PixelClassifier {
            row_starts: (0..=height_px).map(start).collect(),
            pixels: sorted.iter().map(|(place, _)| *place).collect(),
            output_indices: sorted.iter().map(|(_, number)| *number).collect(),
            byte_offsets: Vec::with_capacity(places.len()),
            layout: None,
        }
    }

    /// Puts the classes of the places in these rows into `classes`, one a place; the frame was checked.
    pub(crate) fn classify_rows(
        &mut self,
        frame: &ImageView<'_>,
        table: &ColourLookupTable,
        rows: &Range<usize>,
        classes: &mut [ColourClass],
    ) {
        let layout = (frame.format, frame.stride);
        if self.layout != Some(layout) {
            let offset = |&[u, v]: &[u16; 2]| usize::from(v) * frame.stride + 3 * usize::from(u);
            let offsets = self.pixels.iter().map(|place| offset(place) as u32);
            self.byte_offsets.clear();
            self.byte_offsets.extend(offsets);
            self.layout = Some(layout);
        }
        let here = self.row_starts[rows.start] as usize..self.row_starts[rows.end] as usize;
        let numbers = &self.output_indices[here.clone()];
        match frame.format {
            PixelFormat::Rgb8 => {
                let pixel = |&offset: &u32| load_three_bytes(frame.data, offset as usize);
                classify(&self.byte_offsets[here], numbers, pixel, table, classes);
            }
            PixelFormat::Bgr8 => {
                let pixel =
                    |&offset: &u32| load_three_bytes(frame.data, offset as usize).swap_bytes() >> 8;
                classify(&self.byte_offsets[here], numbers, pixel, table, classes);
            }
            _ => {
                let pixel = |&[u, v]: &[u16; 2]| {
                    let [a, b, c] = frame.native_channels(usize::from(u), usize::from(v));
                    u32::from_le_bytes([a, b, c, 0])
                };
                classify(&self.pixels[here], numbers, pixel, table, classes);
            }
        }
    }
}

/// Classifies places; `pixel` gives the channels at one, the first in the lowest byte.
fn classify<P>(
    places: &[P],
    numbers: &[u32],
    pixel: impl Fn(&P) -> u32,
    table: &ColourLookupTable,
    classes: &mut [ColourClass],
) {
    let mut cells = [0u32; BATCH];
    for (places, numbers) in places.chunks(BATCH).zip(numbers.chunks(BATCH)) {
        for (slot, place) in cells.iter_mut().zip(places) {
            *slot = pixel(place);
        }
        for cell in &mut cells {
            *cell = ColourLookupTable::cell_index(*cell);
        }
        table.scatter(&cells, numbers, classes);
    }
}

/// Three bytes from an offset, the first lowest; one load where a fourth byte follows.
#[inline]
fn load_three_bytes(data: &[u8], offset: usize) -> u32 {
    match data.get(offset..offset + 4) {
        Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        _ => u32::from_le_bytes([data[offset], data[offset + 1], data[offset + 2], 0]),
    }
}
