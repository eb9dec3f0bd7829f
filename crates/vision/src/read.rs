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
            // Used where a pixel has bytes of its own.
            self.offsets = self
                .places
                .iter()
                .map(|&[u, v]| (usize::from(v) * frame.stride + 3 * usize::from(u)) as u32)
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
            _ => {
                let chroma = frame.format.is_yuv().then(|| chroma_weights(weights));
                for (&[u, v], (_, (value, class))) in self.places.iter().zip(samples) {
                    let native = frame.native(usize::from(u), usize::from(v));
                    *value = match chroma {
                        Some([by_u, by_v]) => {
                            let [y, u, v] = native.map(i32::from);
                            let shift = by_u * (u - 128) + by_v * (v - 128);
                            (y + (shift >> 8)).clamp(0, 255) as u8
                        }
                        None => weigh(weights, native),
                    };
                    *class = table.class(native);
                }
            }
        }
    }
}

/// What U and V add to Y so that the sum is the weighted sum of red, green and blue (BT.601), of 256.
fn chroma_weights([r, g, b]: [u32; 3]) -> [i32; 2] {
    let [r, g, b] = [r, g, b].map(|weight| weight as f32);
    [
        (1.772 * b - 0.344_136 * g).round() as i32,
        (1.402 * r - 0.714_136 * g).round() as i32,
    ]
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
