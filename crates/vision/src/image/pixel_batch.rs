//! Many pixels of an image at a time: what differs between formats is decided once for all of them.

use crate::image::{ImageView, PixelFormat, yuv_to_rgb};

/// Marks a pixel outside the image.
pub(crate) const OUTSIDE: [u16; 2] = [u16::MAX; 2];

/// Longest row whose offsets fit 32 bits, those of [`OUTSIDE`] included.
const STRIDE_MAX: usize = 65_000;

impl ImageView<'_> {
    /// Reads pixels (column, row) as [`ImageView::native_channels`] does, the first channel into the lowest byte. The
    /// highest byte is undefined. [`OUTSIDE`] gives 0.
    #[inline]
    pub(crate) fn read_native(&self, pixels: &[[u16; 2]], channels: &mut [u32]) {
        // A pixel outside the image lies behind the end of the data.
        let (data, stride) = (self.data, self.stride);
        match self.format {
            PixelFormat::Rgb8 => self.read_words(pixels, channels, 3, |word, _| word),
            PixelFormat::Bgr8 => {
                self.read_words(pixels, channels, 3, |word, _| word.swap_bytes() >> 8)
            }
            PixelFormat::Yuyv => self.read_words(pixels, channels, 2, |pair, odd| {
                let luma = pair >> (16 * odd) & 0xff;
                luma | pair & 0xff00 | pair >> 8 & 0xff_0000
            }),
            PixelFormat::Uyvy => self.read_words(pixels, channels, 2, |pair, odd| {
                let luma = pair >> (8 + 16 * odd) & 0xff;
                luma | (pair & 0xff) << 8 | pair & 0xff_0000
            }),
            PixelFormat::Grey8 => read_each(pixels, channels, |u, v| {
                load::<1>(data, v * stride + u) * 0x01_0101
            }),
            PixelFormat::Nv12 => {
                let chroma = self.height_px * stride;
                read_each(pixels, channels, |u, v| {
                    let luma = load::<1>(data, v * stride + u);
                    luma | load::<2>(data, chroma + v / 2 * stride + (u & !1)) << 8
                });
            }
            PixelFormat::BayerRggb => self.read_cells::<0, 3>(pixels, channels),
            PixelFormat::BayerBggr => self.read_cells::<3, 0>(pixels, channels),
            PixelFormat::BayerGrbg => self.read_cells::<1, 2>(pixels, channels),
            PixelFormat::BayerGbrg => self.read_cells::<2, 1>(pixels, channels),
            PixelFormat::Yuv411 => read_each(pixels, channels, |u, v| {
                if [u, v] == OUTSIDE.map(usize::from) {
                    return 0;
                }
                let [a, b, c] = self.native_channels(u, v);
                u32::from_le_bytes([a, b, c, 0])
            }),
        }
    }

    /// Reads pixels of three bytes, or of two where pairs share channels, as words of four; `channels_of` takes a pixel's
    /// channels from a word, and 1 if it is the second of a pair.
    ///
    /// Offsets first, many at once, so that nothing but the loads is left for one pixel at a time.
    #[inline(always)]
    fn read_words(
        &self,
        pixels: &[[u16; 2]],
        channels: &mut [u32],
        bytes: u32,
        channels_of: impl Fn(u32, u32) -> u32,
    ) {
        const BATCH: usize = 32;
        let second = u32::from(bytes == 2);
        let data = self.data;
        if self.stride > STRIDE_MAX {
            return read_each(pixels, channels, |u, v| {
                let u = u as u32;
                let start = v * self.stride + (bytes * (u & !second)) as usize;
                channels_of(load_pixel(data, start), u & second)
            });
        }
        let stride = self.stride as u32;
        for (pixels, channels) in pixels.chunks(BATCH).zip(channels.chunks_mut(BATCH)) {
            let mut offsets = [0u32; BATCH];
            for (offset, &[u, v]) in offsets.iter_mut().zip(pixels) {
                *offset = u32::from(v) * stride + bytes * (u32::from(u) & !second);
            }
            load_pixels(data, &offsets[..pixels.len()], channels);
            for (channels, &[u, _]) in channels.iter_mut().zip(pixels) {
                *channels = channels_of(*channels, u32::from(u) & second);
            }
        }
    }

    /// Reads the 2 × 2 cells of a colour filter that hold the pixels; `RED` and `BLUE`: their places in a cell, row by row.
    #[inline]
    fn read_cells<const RED: usize, const BLUE: usize>(
        &self,
        pixels: &[[u16; 2]],
        channels: &mut [u32],
    ) {
        // The last column or row of an odd size has no complete cell, see `ImageView::native_channels`.
        let last = [self.width_px, self.height_px].map(|size| (size & !1).saturating_sub(2));
        // With a single row it is both rows of its cells.
        let below = self.stride.min((self.height_px - 1) * self.stride);
        let (data, stride) = (self.data, self.stride);
        read_each(pixels, channels, |u, v| {
            if [u, v] == OUTSIDE.map(usize::from) {
                return 0;
            }
            let start = (v & !1).min(last[1]) * stride + (u & !1).min(last[0]);
            let cell = load::<2>(data, start) | load::<2>(data, start + below) << 16;
            let place = |place: usize| cell >> (8 * place) & 0xff;
            // Red and blue are at opposite corners, both greens at the other two.
            let first = usize::from(RED.is_multiple_of(3));
            let green = (place(first) + place(3 - first)) / 2;
            place(RED) | green << 8 | place(BLUE) << 16
        });
    }

    /// Reads the red, green and blue of pixels (column, row), red into the lowest byte. The highest byte is undefined.
    /// [`OUTSIDE`] gives black.
    #[inline]
    pub(crate) fn read_rgb(&self, pixels: &[[u16; 2]], colours: &mut [u32]) {
        self.read_native(pixels, colours);
        if self.format.is_yuv() {
            for (colour, &pixel) in colours.iter_mut().zip(pixels) {
                let [y, u, v, _] = colour.to_le_bytes();
                let [r, g, b] = yuv_to_rgb([y, u, v]);
                let inside = if pixel == OUTSIDE { 0 } else { u32::MAX };
                *colour = u32::from_le_bytes([r, g, b, 0]) & inside;
            }
        }
    }
}

#[inline(always)]
fn read_each(pixels: &[[u16; 2]], channels: &mut [u32], read: impl Fn(usize, usize) -> u32) {
    for (channels, &[u, v]) in channels.iter_mut().zip(pixels) {
        *channels = read(usize::from(u), usize::from(v));
    }
}

/// Pixels at byte offsets, as [`load_pixel`] loads them.
#[inline(always)]
pub(crate) fn load_pixels(data: &[u8], offsets: &[u32], pixels: &mut [u32]) {
    // Eight at a time, to amortise the loop overhead.
    let (blocks, rest) = offsets.as_chunks::<8>();
    let (pixel_blocks, pixel_rest) = pixels.as_chunks_mut::<8>();
    for (pixels, offsets) in pixel_blocks.iter_mut().zip(blocks) {
        for (pixel, &offset) in pixels.iter_mut().zip(offsets) {
            *pixel = load_pixel(data, offset as usize);
        }
    }
    for (pixel, &offset) in pixel_rest.iter_mut().zip(rest) {
        *pixel = load_pixel(data, offset as usize);
    }
}

/// Three bytes from an offset, the first lowest: a single load wherever a fourth byte follows. 0 behind the data's end.
#[inline(always)]
fn load_pixel(data: &[u8], offset: usize) -> u32 {
    match data.get(offset..offset + 4) {
        Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        _ => load_last_pixel(data, offset),
    }
}

#[cold]
fn load_last_pixel(data: &[u8], offset: usize) -> u32 {
    match data.get(offset..offset + 3) {
        Some(&[a, b, c]) => u32::from_le_bytes([a, b, c, 0]),
        _ => 0,
    }
}

/// Up to four bytes from an offset, the first lowest. 0 behind the data's end.
#[inline(always)]
fn load<const BYTES: usize>(data: &[u8], offset: usize) -> u32 {
    let mut word = [0; 4];
    if let Some(bytes) = data.get(offset..offset + BYTES) {
        word[..BYTES].copy_from_slice(bytes);
    }
    u32::from_le_bytes(word)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORMATS: [PixelFormat; 11] = [
        PixelFormat::Rgb8,
        PixelFormat::Bgr8,
        PixelFormat::Grey8,
        PixelFormat::Yuyv,
        PixelFormat::Uyvy,
        PixelFormat::Yuv411,
        PixelFormat::Nv12,
        PixelFormat::BayerRggb,
        PixelFormat::BayerBggr,
        PixelFormat::BayerGrbg,
        PixelFormat::BayerGbrg,
    ];

    /// Every pixel of an image of random bytes, padded rows and odd sizes included, against the reading of one pixel.
    #[test]
    fn many_pixels_are_what_single_ones_are_in_every_format() {
        let mut state = 1u32;
        let data: Vec<u8> = (0..600_000)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect();
        for format in FORMATS {
            // Offsets of the last size do not fit 32 bits.
            let sizes = [
                (8usize, 6usize, 0),
                (7, 5, 0),
                (8, 5, 3),
                (8, 6, STRIDE_MAX),
            ];
            for (width_px, height_px, padding) in sizes {
                let stride = format.row_bytes(width_px) + padding;
                let rows = match format {
                    PixelFormat::Nv12 => height_px + height_px.div_ceil(2),
                    _ => height_px,
                };
                // Not a byte more than the image has.
                let length = stride * (rows - 1) + format.row_bytes(width_px);
                let image = ImageView {
                    width_px,
                    height_px,
                    format,
                    stride,
                    data: &data[..length],
                };
                image.check(width_px, height_px).expect("a whole image");
                let mut pixels: Vec<[u16; 2]> = (0..height_px as u16)
                    .flat_map(|v| (0..width_px as u16).map(move |u| [u, v]))
                    .collect();
                pixels.push(OUTSIDE);
                let mut read = [vec![0; pixels.len()], vec![0; pixels.len()]];
                image.read_native(&pixels, &mut read[0]);
                image.read_rgb(&pixels, &mut read[1]);
                let [native, rgb] = &read;
                let colour =
                    |word: u32| -> [u8; 3] { std::array::from_fn(|k| word.to_le_bytes()[k]) };
                for (index, &pixel) in pixels.iter().enumerate() {
                    let [u, v] = pixel.map(usize::from);
                    let (single, single_rgb) = match pixel {
                        OUTSIDE => ([0; 3], [0; 3]),
                        _ => (image.native_channels(u, v), image.rgb(u, v)),
                    };
                    assert_eq!(colour(native[index]), single, "{format:?} {pixel:?}");
                    assert_eq!(colour(rgb[index]), single_rgb, "{format:?} {pixel:?}");
                }
            }
        }
    }
}
