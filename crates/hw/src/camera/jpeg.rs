//! Which pixels does a JPEG contain? Decodes the images of cameras that compress.

use super::buffer_pool::BufferPool;
use super::image::{CapturedImage, Encoding};

impl CapturedImage {
    /// Decodes a JPEG to red, green, blue; returns other encodings unchanged. `None` if it is damaged or of another size.
    pub(super) fn decompress(self, pool: &BufferPool) -> Option<Self> {
        if self.encoding != Encoding::Mjpeg {
            return Some(self);
        }
        // The decoder would fill the missing part of a truncated image with grey. Drivers pad with zeros.
        let end = self.data.iter().rposition(|byte| *byte != 0)?;
        if end == 0 || self.data[end - 1..=end] != [0xFF, 0xD9] {
            return None;
        }
        let rgb = vision::Image::decode(&self.data).ok()?;
        if (rgb.width_px, rgb.height_px) != (self.width_px, self.height_px) {
            return None;
        }
        let data = pool.fill(|bytes| {
            bytes.clear();
            bytes.extend_from_slice(&rgb.rgb);
            Ok::<(), ()>(())
        });
        Some(CapturedImage {
            encoding: Encoding::Rgb8,
            stride: Encoding::Rgb8.row_bytes(self.width_px),
            data: data.ok()?,
            ..self
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::Stamp;

    fn frame(encoding: Encoding, width_px: usize, height_px: usize, data: &[u8]) -> CapturedImage {
        let filled = BufferPool::new(0).fill(|bytes| {
            bytes.clear();
            bytes.extend_from_slice(data);
            Ok::<(), ()>(())
        });
        CapturedImage {
            stamp: Stamp(0),
            sequence: 0,
            width_px,
            height_px,
            encoding,
            stride: encoding.row_bytes(width_px),
            repeated: false,
            setting: None,
            data: filled.expect("filled"),
        }
    }

    #[test]
    fn jpeg_is_decoded_and_truncated_jpeg_is_rejected() {
        let mut jpeg = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
        encoder
            .encode(&[128; 3 * 16 * 8], 16, 8, image::ExtendedColorType::Rgb8)
            .expect("encoded");
        let pool = BufferPool::new(0);
        let decode = |bytes: &[u8]| frame(Encoding::Mjpeg, 16, 8, bytes).decompress(&pool);
        assert!(decode(&jpeg[..jpeg.len() - 9]).is_none());
        assert!(decode(&[0xFF, 0xD8, 1, 2]).is_none());
        assert!(
            frame(Encoding::Mjpeg, 8, 8, &jpeg)
                .decompress(&pool)
                .is_none()
        );
        jpeg.extend([0; 7]);
        let whole = decode(&jpeg).expect("an image");
        assert_eq!((whole.encoding, whole.data.len()), (Encoding::Rgb8, 384));
        assert!(whole.data.iter().all(|level| level.abs_diff(128) <= 2));
    }

    #[test]
    fn configured_or_preferred_encoding_is_selected() {
        let offered = [Encoding::Grey8, Encoding::Mjpeg, Encoding::Yuyv].map(Encoding::fourcc);
        assert_eq!(Encoding::choose("", &offered), Some(Encoding::Yuyv));
        assert_eq!(Encoding::choose("GREY", &offered), Some(Encoding::Grey8));
        assert_eq!(Encoding::choose("NV12", &offered), None);
    }
}
