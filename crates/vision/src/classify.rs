//! What class has each of chosen pixels? Read row by row, as the camera's bytes lie in memory.

use std::ops::Range;

use crate::colours::{Class, NativeTable};
use crate::image::{Frame, PixelFormat};

/// Classes of chosen pixels.
///
/// Scan lines and rays run across an image's rows, and a step to the next row is one to another part of memory. Sorted
/// by rows the same pixels are fetched from where the core just was; only their classes, a byte each, are strewn.
#[derive(Debug, Clone)]
pub(crate) struct ClassReader {
    /// Column and row, row by row.
    places: Vec<[u16; 2]>,
    /// Which of the places asked for each of them is.
    numbers: Vec<u32>,
    /// Where each row begins in both, and one past the last.
    row_starts: Vec<u32>,
    /// First byte of each place in a frame of `layout`, where a pixel has bytes of its own.
    offsets: Vec<u32>,
    layout: Option<(PixelFormat, usize)>,
}

/// So many are classified at a time: wide enough for vector registers, small enough for the stack.
const BATCH: usize = 64;

impl ClassReader {
    /// `places`: column and row of each pixel in an image of this height.
    pub(crate) fn new(places: &[[u16; 2]], height_px: usize) -> Self {
        let mut sorted: Vec<([u16; 2], u32)> = places.iter().copied().zip(0..).collect();
        sorted.sort_by_key(|&([column, row], _)| (row, column));
        let start = |row| sorted.partition_point(|([_, v], _)| usize::from(*v) < row) as u32;
        ClassReader {
            row_starts: (0..=height_px).map(start).collect(),
            places: sorted.iter().map(|(place, _)| *place).collect(),
            numbers: sorted.iter().map(|(_, number)| *number).collect(),
            offsets: Vec::with_capacity(places.len()),
            layout: None,
        }
    }

    /// Puts the classes of the places in these rows into `classes`, one a place; the frame was checked.
    pub(crate) fn read(
        &mut self,
        frame: &Frame<'_>,
        table: &NativeTable,
        rows: &Range<usize>,
        classes: &mut [Class],
    ) {
        let layout = (frame.format, frame.stride);
        if self.layout != Some(layout) {
            let offset = |&[u, v]: &[u16; 2]| usize::from(v) * frame.stride + 3 * usize::from(u);
            let offsets = self.places.iter().map(|place| offset(place) as u32);
            self.offsets.clear();
            self.offsets.extend(offsets);
            self.layout = Some(layout);
        }
        let here = self.row_starts[rows.start] as usize..self.row_starts[rows.end] as usize;
        let numbers = &self.numbers[here.clone()];
        match frame.format {
            PixelFormat::Rgb8 => {
                let pixel = |&offset: &u32| three(frame.data, offset as usize);
                classify(&self.offsets[here], numbers, pixel, table, classes);
            }
            PixelFormat::Bgr8 => {
                let pixel = |&offset: &u32| three(frame.data, offset as usize).swap_bytes() >> 8;
                classify(&self.offsets[here], numbers, pixel, table, classes);
            }
            _ => {
                let pixel = |&[u, v]: &[u16; 2]| {
                    let [a, b, c] = frame.native(usize::from(u), usize::from(v));
                    u32::from_le_bytes([a, b, c, 0])
                };
                classify(&self.places[here], numbers, pixel, table, classes);
            }
        }
    }
}

/// Classifies places; `pixel` gives the channels at one, the first in the lowest byte.
fn classify<P>(
    places: &[P],
    numbers: &[u32],
    pixel: impl Fn(&P) -> u32,
    table: &NativeTable,
    classes: &mut [Class],
) {
    let mut cells = [0u32; BATCH];
    for (places, numbers) in places.chunks(BATCH).zip(numbers.chunks(BATCH)) {
        for (slot, place) in cells.iter_mut().zip(places) {
            *slot = pixel(place);
        }
        for cell in &mut cells {
            *cell = NativeTable::cell(*cell);
        }
        table.strew(&cells, numbers, classes);
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
