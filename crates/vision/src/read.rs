//! What do the scanned pixels show? Brightness and class of every sample, straight from the camera's own bytes.

use crate::colours::{Class, NativeTable};
use crate::image::{Frame, PixelFormat};

/// The samples' places, packed for the one loop that touches every scanned pixel.
#[derive(Debug, Clone)]
pub(crate) struct Reader {
    places: Vec<[u16; 2]>,
    /// Byte of each sample in a frame of `layout`.
    offsets: Vec<u32>,
    layout: Option<(PixelFormat, usize)>,
}

impl Reader {
    /// `places`: column and row of each sample.
    pub(crate) fn new(places: Vec<[u16; 2]>) -> Self {
        Reader {
            places,
            offsets: Vec::new(),
            layout: None,
        }
    }

    /// Fills one value (weighted channels, weights of 256) and one class a sample; the frame was checked.
    pub(crate) fn read(
        &mut self,
        frame: &Frame<'_>,
        table: &NativeTable,
        weights: [u32; 3],
        values: &mut [u8],
        classes: &mut [Class],
    ) {
        let layout = (frame.format, frame.stride);
        if self.layout != Some(layout) {
            let pixel = frame.format.row_bytes(1);
            self.offsets = self
                .places
                .iter()
                .map(|&[u, v]| (usize::from(v) * frame.stride + pixel * usize::from(u)) as u32)
                .collect();
            self.layout = Some(layout);
        }
        let [wa, wb, wc] = weights;
        let outputs = values.iter_mut().zip(classes);
        let samples = self.offsets.iter().zip(outputs);
        match frame.format {
            PixelFormat::Rgb8 => {
                for (&offset, (value, class)) in samples {
                    let [a, b, c] = three(frame.data, offset as usize);
                    *value = weigh([wa, wb, wc], [a, b, c]);
                    *class = table.class([a, b, c]);
                }
            }
            PixelFormat::Bgr8 => {
                for (&offset, (value, class)) in samples {
                    let [c, b, a] = three(frame.data, offset as usize);
                    *value = weigh([wa, wb, wc], [a, b, c]);
                    *class = table.class([a, b, c]);
                }
            }
            PixelFormat::Grey8 => {
                for (&offset, (value, class)) in samples {
                    let grey = frame.data[offset as usize];
                    *value = grey;
                    *class = table.class([grey; 3]);
                }
            }
        }
    }
}

/// Three bytes from an offset; one load where a fourth byte follows.
#[inline]
fn three(data: &[u8], offset: usize) -> [u8; 3] {
    match data.get(offset..offset + 4) {
        Some(&[a, b, c, _]) => [a, b, c],
        _ => [data[offset], data[offset + 1], data[offset + 2]],
    }
}

#[inline]
fn weigh(weights: [u32; 3], channels: [u8; 3]) -> u8 {
    let sum: u32 = weights
        .iter()
        .zip(channels)
        .map(|(weight, channel)| weight * u32::from(channel))
        .sum();
    (sum >> 8) as u8
}
