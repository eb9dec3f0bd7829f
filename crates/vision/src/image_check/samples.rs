//! Samples of the rows of an image, each one word: one load and one store read it.

use crate::image::{ImageView, PixelFormat};

/// Columns between two samples of a row: 480 rows then have about 20,000 samples.
pub(super) const COLUMN_STEP: usize = 8;

/// The channels of a pixel as the camera orders them, and a zero. Blue, green, red becomes red, green, blue.
pub(super) type ChannelSample = [u8; 4];

/// Luminance, of three colours about it: JPEG keeps half of the rows of the colours, so that in one colour alone each
/// blurred edge steps sharply at every other row. Red and blue weigh the same, in either order.
pub(super) fn brightness(yuv: bool, [a, b, c, _]: ChannelSample) -> u8 {
    if yuv {
        return a;
    }
    let [a, b, c] = [a, b, c].map(u16::from);
    ((a + 2 * b + c) / 4) as u8
}

pub(super) fn sample_at(image: &ImageView<'_>, column: usize, row: usize) -> ChannelSample {
    let [a, b, c] = image.native_channels(column, row);
    [a, b, c, 0]
}

/// Reads the samples of a row.
pub(super) fn read_samples(image: &ImageView<'_>, row: usize, samples: &mut [ChannelSample]) {
    match image.format {
        PixelFormat::Rgb8 => {
            read_packed::<{ 3 * COLUMN_STEP }>(image, row, samples, |word| word & 0xff_ffff);
        }
        PixelFormat::Bgr8 => {
            read_packed::<{ 3 * COLUMN_STEP }>(image, row, samples, |word| word.swap_bytes() >> 8);
        }
        PixelFormat::Yuyv => read_packed::<{ 2 * COLUMN_STEP }>(image, row, samples, |word| {
            word & 0xffff | word >> 8 & 0xff_0000
        }),
        PixelFormat::Uyvy => read_packed::<{ 2 * COLUMN_STEP }>(image, row, samples, |word| {
            word >> 8 & 0xff | (word & 0xff) << 8 | word & 0xff_0000
        }),
        _ => {
            for (number, sample) in samples.iter_mut().enumerate() {
                *sample = sample_at(image, number * COLUMN_STEP, row);
            }
        }
    }
}

/// Reads the samples of a row whose pixels follow each other; `BYTES` from sample to sample. `channels` puts the channels
/// of the first pixel among four bytes into the lowest three.
fn read_packed<const BYTES: usize>(
    image: &ImageView<'_>,
    row: usize,
    samples: &mut [ChannelSample],
    channels: impl Fn(u32) -> u32,
) {
    let (pixels, _) = image.data[row * image.stride..].as_chunks::<BYTES>();
    for (sample, bytes) in samples.iter_mut().zip(pixels) {
        let word = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        *sample = channels(word).to_le_bytes();
    }
    // The last row may end before its last sample's neighbours do.
    for (number, sample) in samples.iter_mut().enumerate().skip(pixels.len()) {
        *sample = sample_at(image, number * COLUMN_STEP, row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In every format whose pixels are read as words, rows with padding and the last row's end included.
    #[test]
    fn samples_are_the_channels_of_their_pixels() {
        const ROWS: usize = 3;
        for format in [
            PixelFormat::Rgb8,
            PixelFormat::Bgr8,
            PixelFormat::Yuyv,
            PixelFormat::Uyvy,
        ] {
            for (width_px, padding) in [(18, 0), (24, 0), (34, 5)] {
                let stride = format.row_bytes(width_px) + padding;
                let length = stride * (ROWS - 1) + format.row_bytes(width_px);
                let data: Vec<u8> = (0..length)
                    .map(|index| (index * index * 37 % 251) as u8)
                    .collect();
                let image = ImageView {
                    width_px,
                    height_px: ROWS,
                    format,
                    stride,
                    data: &data,
                };
                for row in 0..ROWS {
                    let mut samples = vec![[9; 4]; width_px.div_ceil(COLUMN_STEP)];
                    read_samples(&image, row, &mut samples);
                    for (number, sample) in samples.iter().enumerate() {
                        let expected = sample_at(&image, number * COLUMN_STEP, row);
                        assert_eq!(*sample, expected, "{format:?} {width_px} {row} {number}");
                    }
                }
            }
        }
    }
}
