//! Images: borrowed in the camera's own pixel format, and owned RGB images from files.

mod orientation;
mod pixel_batch;
mod prefetch;

use std::io::Cursor;
use std::path::Path;

use image::metadata::Orientation as Transform;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader};
use localize::input_file;

use crate::error::VisionError;
use crate::output_file::{OutputFile, ensure_can_create};

pub use orientation::{CommonOrientation, Orientation};
pub(crate) use pixel_batch::{OUTSIDE, load_pixels};

/// Largest accepted image or map, pixels. Larger ones are refused before they are unpacked.
pub const PIXELS_MAX: usize = 64 * 1024 * 1024;

/// Largest file of an image: the pixels in three colours, and some text.
const FILE_BYTES_MAX: u64 = 3 * PIXELS_MAX as u64 + (1 << 20);
/// Largest accepted width or height, pixels. Decoders are slow on millions of short rows.
const SIDE_MAX: u32 = 32_768;

/// Layout of a pixel's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    /// Red, green, blue; 8 bits each.
    Rgb8,
    /// Blue, green, red; 8 bits each (OpenCV's order).
    Bgr8,
    /// Brightness alone, 8 bits.
    Grey8,
    /// Y U Y V for two pixels (4:2:2).
    Yuyv,
    /// U Y V Y for two pixels (4:2:2).
    Uyvy,
    /// U Y Y V Y Y for four pixels (4:1:1, as IEEE 1394 cameras send it).
    Yuv411,
    /// A plane of Y, then a plane of U V at half the columns and rows (4:2:0), rows of the same stride.
    Nv12,
    /// Colour filter with red in the first row's first column.
    BayerRggb,
    /// Colour filter with blue in the first row's first column.
    BayerBggr,
    /// Colour filter with green first, red second in the first row.
    BayerGrbg,
    /// Colour filter with green first, blue second in the first row.
    BayerGbrg,
}

impl PixelFormat {
    /// Minimum bytes of a row of `width_px` pixels.
    pub fn row_bytes(self, width_px: usize) -> usize {
        match self {
            PixelFormat::Rgb8 | PixelFormat::Bgr8 => 3 * width_px,
            PixelFormat::Yuyv | PixelFormat::Uyvy => 4 * width_px.div_ceil(2),
            PixelFormat::Yuv411 => 6 * width_px.div_ceil(4),
            // Chroma comes in pairs, even for the last column of an odd width.
            PixelFormat::Nv12 => 2 * width_px.div_ceil(2),
            PixelFormat::Grey8
            | PixelFormat::BayerRggb
            | PixelFormat::BayerBggr
            | PixelFormat::BayerGrbg
            | PixelFormat::BayerGbrg => width_px,
        }
    }

    /// True if the camera's channels are brightness and two chroma.
    pub fn is_yuv(self) -> bool {
        matches!(
            self,
            PixelFormat::Yuyv | PixelFormat::Uyvy | PixelFormat::Yuv411 | PixelFormat::Nv12
        )
    }
}

/// Red, green, blue of Y, U, V (ITU-R BT.601, full range, as JPEG and USB cameras send it).
#[inline]
pub fn yuv_to_rgb([y, u, v]: [u8; 3]) -> [u8; 3] {
    let (y, u, v) = (f32::from(y), f32::from(u) - 128.0, f32::from(v) - 128.0);
    [
        y + 1.402 * v,
        y - 0.344_136 * u - 0.714_136 * v,
        y + 1.772 * u,
    ]
    .map(|channel| channel.round().clamp(0.0, 255.0) as u8)
}

/// Y, U, V of red, green, blue; the inverse of [`yuv_to_rgb`].
pub fn rgb_to_yuv([r, g, b]: [u8; 3]) -> [u8; 3] {
    let [r, g, b] = [r, g, b].map(f32::from);
    [
        0.299 * r + 0.587 * g + 0.114 * b,
        128.0 - 0.168_736 * r - 0.331_264 * g + 0.5 * b,
        128.0 + 0.5 * r - 0.418_688 * g - 0.081_312 * b,
    ]
    .map(|channel| channel.round().clamp(0.0, 255.0) as u8)
}

/// An image whose bytes are borrowed.
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Pixel format of `data`.
    pub format: PixelFormat,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// Row by row from the top.
    pub data: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// An image without padding between rows.
    pub fn packed(width_px: usize, height_px: usize, format: PixelFormat, data: &'a [u8]) -> Self {
        ImageView {
            width_px,
            height_px,
            format,
            stride: format.row_bytes(width_px),
            data,
        }
    }

    /// Errors if the size differs or bytes are missing.
    pub fn check(&self, width_px: usize, height_px: usize) -> Result<(), VisionError> {
        if (self.width_px, self.height_px) != (width_px, height_px) {
            return Err(VisionError::ImageSize {
                actual_width_px: self.width_px,
                actual_height_px: self.height_px,
                expected_width_px: width_px,
                expected_height_px: height_px,
            });
        }
        let row = self.format.row_bytes(width_px);
        let rows = match self.format {
            PixelFormat::Nv12 => height_px + height_px.div_ceil(2),
            _ => height_px,
        };
        let expected = self.stride.max(row) * rows.saturating_sub(1) + row;
        if self.data.len() < expected || self.stride < row {
            return Err(VisionError::Truncated {
                actual_bytes: self.data.len(),
                expected_bytes: expected,
            });
        }
        Ok(())
    }

    /// Red, green and blue of a pixel inside the image.
    #[inline(always)]
    pub fn rgb(&self, column: usize, row: usize) -> [u8; 3] {
        if self.format == PixelFormat::Rgb8 {
            return self.native_channels(column, row);
        }
        self.rgb_of_format(column, row)
    }

    /// As [`ImageView::rgb`]; separate, so that callers inline only the common RGB case.
    fn rgb_of_format(&self, column: usize, row: usize) -> [u8; 3] {
        let native = self.native_channels_of_format(column, row);
        if self.format.is_yuv() {
            yuv_to_rgb(native)
        } else {
            native
        }
    }

    /// A pixel's channels as the camera has them: Y, U, V of YUV formats, red, green, blue of all others.
    #[inline(always)]
    pub fn native_channels(&self, column: usize, row: usize) -> [u8; 3] {
        if self.format == PixelFormat::Rgb8 {
            let start = row * self.stride + 3 * column;
            let bytes = &self.data[start..start + 3];
            return [bytes[0], bytes[1], bytes[2]];
        }
        self.native_channels_of_format(column, row)
    }

    /// As [`ImageView::native_channels`]; separate, so that callers inline only the common RGB case.
    fn native_channels_of_format(&self, column: usize, row: usize) -> [u8; 3] {
        let start = row * self.stride;
        let at = |offset: usize| self.data[start + offset];
        match self.format {
            PixelFormat::Rgb8 => [at(3 * column), at(3 * column + 1), at(3 * column + 2)],
            PixelFormat::Bgr8 => [at(3 * column + 2), at(3 * column + 1), at(3 * column)],
            PixelFormat::Grey8 => [at(column); 3],
            PixelFormat::Yuyv => {
                let pair = 4 * (column / 2);
                [at(2 * column), at(pair + 1), at(pair + 3)]
            }
            PixelFormat::Uyvy => {
                let pair = 4 * (column / 2);
                [at(2 * column + 1), at(pair), at(pair + 2)]
            }
            PixelFormat::Yuv411 => {
                let four = 6 * (column / 4);
                let place = [1, 2, 4, 5][column % 4];
                [at(four + place), at(four), at(four + 3)]
            }
            PixelFormat::Nv12 => {
                let chroma = (self.height_px + row / 2) * self.stride + (column & !1);
                [at(column), self.data[chroma], self.data[chroma + 1]]
            }
            PixelFormat::BayerRggb => self.bayer(column, row, [0, 1, 2, 3]),
            PixelFormat::BayerBggr => self.bayer(column, row, [3, 1, 2, 0]),
            PixelFormat::BayerGrbg => self.bayer(column, row, [1, 0, 3, 2]),
            PixelFormat::BayerGbrg => self.bayer(column, row, [2, 0, 3, 1]),
        }
    }

    /// Red, green, blue of the 2 × 2 cell that holds a pixel; `order`: positions of red, both greens and blue in the cell.
    fn bayer(&self, column: usize, row: usize, order: [usize; 4]) -> [u8; 3] {
        // The last column or row of an odd size has no complete cell: use the one before it.
        let first = |at: usize, size: usize| (at & !1).min((size & !1).saturating_sub(2));
        let (column, row) = (first(column, self.width_px), first(row, self.height_px));
        let at = |place: usize| {
            let below = (row + place / 2).min(self.height_px - 1);
            self.data[below * self.stride + (column + place % 2).min(self.width_px - 1)]
        };
        let green = u16::from(at(order[1])) + u16::from(at(order[2]));
        [at(order[0]), (green / 2) as u8, at(order[3])]
    }
}

/// An image that owns its bytes: red, green, blue, row by row, packed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// `3 · width_px · height_px` bytes.
    pub rgb: Vec<u8>,
}

/// True if the end mark is missing: decoders fill the missing part with grey and report no error.
fn is_truncated_jpeg(bytes: &[u8]) -> bool {
    // Some writers pad after the end mark.
    let tail = &bytes[bytes.len().saturating_sub(4096)..];
    bytes.starts_with(&[0xff, 0xd8]) && !tail.windows(2).any(|pair| pair == [0xff, 0xd9])
}

impl Image {
    /// Decodes a PNG or JPEG file, turned as its EXIF orientation demands.
    pub fn load(path: &Path) -> Result<Self, VisionError> {
        Ok(Image::load_with_orientation(path)?.0)
    }

    /// As [`Image::load`], with the orientation that was applied.
    pub fn load_with_orientation(path: &Path) -> Result<(Self, Orientation), VisionError> {
        let refuse = |reason: String| VisionError::ReadImage {
            path: path.to_owned(),
            reason,
        };
        let bytes =
            input_file::read(path, FILE_BYTES_MAX).map_err(|error| refuse(error.to_string()))?;
        if is_truncated_jpeg(&bytes) {
            return Err(refuse("truncated JPEG (no end mark)".to_owned()));
        }
        Image::decode_with_orientation(&bytes).map_err(refuse)
    }

    /// Decodes the bytes of a PNG or JPEG file, turned as its EXIF orientation demands. Errors with the reason, before
    /// unpacking if the image is too large.
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        Ok(Image::decode_with_orientation(bytes)?.0)
    }

    fn decode_with_orientation(bytes: &[u8]) -> Result<(Self, Orientation), String> {
        let mut decoder = ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| error.to_string())?
            .into_decoder()
            .map_err(|error| match error {
                ImageError::Unsupported(error) => format!("{error} (expected PNG or JPEG)"),
                error => error.to_string(),
            })?;
        let (width, height) = decoder.dimensions();
        if width.max(height) > SIDE_MAX || width as usize * height as usize > PIXELS_MAX {
            return Err(format!(
                "too large: {width} × {height} pixels (expected at most {SIDE_MAX} a side and {PIXELS_MAX} in all)"
            ));
        }
        // Metadata that cannot be read demand nothing.
        let transform = decoder.orientation().unwrap_or(Transform::NoTransforms);
        let mut decoded = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?;
        decoded.apply_orientation(transform);
        let decoded = decoded.into_rgb8();
        let image = Image {
            width_px: decoded.width() as usize,
            height_px: decoded.height() as usize,
            rgb: decoded.into_raw(),
        };
        Ok((image, Orientation::new(transform)))
    }

    /// An error if [`Image::save`] would refuse the name or could not write there.
    pub fn ensure_can_save(path: &Path) -> Result<(), VisionError> {
        picture_format(path)?;
        ensure_can_create(path).map_err(|error| VisionError::File {
            path: path.to_owned(),
            reason: error.to_string(),
        })
    }

    /// Writes a PNG or JPEG file, by the name's extension.
    pub fn save(&self, path: &Path) -> Result<(), VisionError> {
        let refuse = |reason: String| VisionError::File {
            path: path.to_owned(),
            reason,
        };
        let format = picture_format(path)?;
        let mut file = OutputFile::create(path).map_err(|error| refuse(error.to_string()))?;
        image::write_buffer_with_format(
            &mut file,
            &self.rgb,
            self.width_px as u32,
            self.height_px as u32,
            image::ExtendedColorType::Rgb8,
            format,
        )
        .map_err(|error| refuse(error.to_string()))?;
        file.finish().map_err(|error| refuse(error.to_string()))
    }

    /// Borrows the image.
    pub fn view(&self) -> ImageView<'_> {
        ImageView::packed(self.width_px, self.height_px, PixelFormat::Rgb8, &self.rgb)
    }
}

/// The format of a picture by its name.
fn picture_format(path: &Path) -> Result<ImageFormat, VisionError> {
    match ImageFormat::from_path(path) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => Ok(format),
        _ => Err(VisionError::File {
            path: path.to_owned(),
            reason: "no picture's name (expected .png or .jpg)".into(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 4 × 2 image of one colour in every format.
    fn encode_in_all_formats(rgb: [u8; 3]) -> Vec<(PixelFormat, usize, Vec<u8>)> {
        let [r, g, b] = rgb;
        let [y, u, v] = rgb_to_yuv(rgb);
        let repeat = |bytes: &[u8], times: usize| bytes.repeat(times);
        let bayer = |even: [u8; 2], odd: [u8; 2]| [repeat(&even, 2), repeat(&odd, 2)].concat();
        vec![
            (PixelFormat::Rgb8, 12, repeat(&[r, g, b], 8)),
            (PixelFormat::Bgr8, 12, repeat(&[b, g, r], 8)),
            (PixelFormat::Yuyv, 8, repeat(&[y, u, y, v], 4)),
            (PixelFormat::Uyvy, 8, repeat(&[u, y, v, y], 4)),
            (PixelFormat::Yuv411, 6, repeat(&[u, y, y, v, y, y], 2)),
            (
                PixelFormat::Nv12,
                4,
                [repeat(&[y], 8), repeat(&[u, v], 2)].concat(),
            ),
            (PixelFormat::BayerRggb, 4, bayer([r, g], [g, b])),
            (PixelFormat::BayerBggr, 4, bayer([b, g], [g, r])),
            (PixelFormat::BayerGrbg, 4, bayer([g, r], [b, g])),
            (PixelFormat::BayerGbrg, 4, bayer([g, b], [r, g])),
        ]
    }

    /// A PNG of one column and many rows, as its header says; the pixels are missing.
    #[test]
    fn image_of_four_hundred_million_rows_is_refused_by_its_header() {
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        png.extend(1_u32.to_be_bytes());
        png.extend(400_000_000_u32.to_be_bytes());
        png.extend([8, 2, 0, 0, 0]);
        png.extend(0xe30b_1e27_u32.to_be_bytes());
        png.extend([0, 0, 0, 1]);
        png.extend(b"IDAT");
        let error = Image::decode(&png).expect_err("refused");
        assert!(error.contains("too large: 1 × 400000000"), "{error}");
    }

    /// A JPEG of two columns and a row, black and white, with an EXIF orientation.
    fn tagged_jpeg(orientation: u8) -> Vec<u8> {
        let mut jpeg = Vec::new();
        let pixels: Vec<u8> = (0..16 * 8 * 3)
            .map(|i| if i / 3 % 16 < 8 { 0 } else { 255 })
            .collect();
        image::codecs::jpeg::JpegEncoder::new(&mut jpeg)
            .encode(&pixels, 16, 8, image::ExtendedColorType::Rgb8)
            .expect("encoded");
        let mut exif =
            b"\xff\xe1\0\x22Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
        exif.extend([orientation, 0, 0, 0, 0, 0, 0]);
        jpeg.splice(2..2, exif);
        jpeg
    }

    #[test]
    fn image_is_turned_as_its_exif_orientation_demands() {
        let size = |image: &Image| [image.width_px, image.height_px];
        let upright = Image::decode(&tagged_jpeg(1)).expect("an image");
        assert_eq!(size(&upright), [16, 8]);
        assert!(upright.rgb[0] < 30 && upright.rgb[3 * 15] > 220);
        // Clockwise: the left, black half comes to the top.
        let turned = Image::decode(&tagged_jpeg(6)).expect("an image");
        assert_eq!(size(&turned), [8, 16]);
        assert!(turned.rgb[0] < 30 && turned.rgb[3 * 7] < 30 && turned.rgb[3 * 8 * 15] > 220);
    }

    #[test]
    fn files_of_one_camera_with_two_exif_orientations_are_refused_with_both() {
        let orientation = |tag: u8| {
            let decoded = Image::decode_with_orientation(&tagged_jpeg(tag));
            decoded.expect("an image").1
        };
        let mut common = CommonOrientation::default();
        assert_eq!(common.check("a.jpg", orientation(6)), Ok(()));
        assert_eq!(common.check("b.jpg", orientation(6)), Ok(()));
        let error = common.check("c.jpg", orientation(1)).expect_err("refused");
        assert!(
            error.contains("a.jpg") && error.contains("c.jpg"),
            "{error}"
        );
    }

    #[test]
    fn every_pixel_format_decodes_to_the_encoded_colour() {
        for (format, stride, data) in encode_in_all_formats([200, 90, 40]) {
            let view = ImageView {
                width_px: 4,
                height_px: 2,
                format,
                stride,
                data: &data,
            };
            view.check(4, 2).expect("whole");
            for (column, row) in [(0, 0), (1, 0), (2, 1), (3, 1)] {
                let decoded = view.rgb(column, row);
                let error = decoded
                    .iter()
                    .zip([200u8, 90, 40])
                    .map(|(a, b)| a.abs_diff(b))
                    .max();
                assert!(
                    error <= Some(2),
                    "{format:?} ({column}, {row}): {decoded:?}"
                );
            }
            let truncated = ImageView {
                data: &data[..data.len() - 1],
                ..view
            };
            assert!(truncated.check(4, 2).is_err(), "{format:?}");
        }
    }
}
