//! Which colours do a camera's bytes stand for? Any encoding to packed red, green, blue.
//!
//! YUV is BT.601 with limited range, which USB cameras send (USB Video Class 1.5, colour matching descriptor's default).
//! Bayer rows become colours by bilinear interpolation, which keeps a pixel's own sample as it is.

use super::frame::{CameraFrame, Encoding};

impl CameraFrame {
    /// Fills `rgb` with `3 · width_px · height_px` bytes; false if the frame is torn or no image (JPEG).
    pub fn to_rgb(&self, rgb: &mut Vec<u8>) -> bool {
        let (width, height) = (self.width_px, self.height_px);
        let wanted = self.encoding.frame_bytes(width, height, self.stride);
        if self.data.len() < wanted || self.stride < self.encoding.row_bytes(width) {
            return false;
        }
        rgb.clear();
        rgb.resize(3 * width * height, 0);
        if self.encoding == Encoding::Mjpeg {
            return self.jpeg_to_rgb(rgb);
        }
        for (v, out) in rgb.chunks_exact_mut(3 * width).enumerate() {
            let row = &self.data[v * self.stride..][..self.encoding.row_bytes(width)];
            match self.encoding {
                Encoding::Rgb8 => out.copy_from_slice(row),
                Encoding::Bgr8 => {
                    for (out, bgr) in out.chunks_exact_mut(3).zip(row.chunks_exact(3)) {
                        out.copy_from_slice(&[bgr[2], bgr[1], bgr[0]]);
                    }
                }
                Encoding::Grey8 => {
                    for (out, grey) in out.chunks_exact_mut(3).zip(row) {
                        out.fill(*grey);
                    }
                }
                Encoding::Yuyv => pairs_to_rgb(row, [0, 1, 2, 3], out),
                Encoding::Uyvy => pairs_to_rgb(row, [1, 0, 3, 2], out),
                Encoding::Nv12 => {
                    let chroma = &self.data[(height + v / 2) * self.stride..];
                    for (u, (out, y)) in out.chunks_exact_mut(3).zip(row).enumerate() {
                        let at = u & !1;
                        out.copy_from_slice(&yuv_to_rgb(*y, chroma[at], chroma[at + 1]));
                    }
                }
                Encoding::BayerRggb => self.bayer_row(v, [0, 0], out),
                Encoding::BayerGrbg => self.bayer_row(v, [1, 0], out),
                Encoding::BayerGbrg => self.bayer_row(v, [0, 1], out),
                Encoding::BayerBggr => self.bayer_row(v, [1, 1], out),
                Encoding::Mjpeg => {}
            }
        }
        true
    }

    fn jpeg_to_rgb(&self, rgb: &mut [u8]) -> bool {
        let decoded = image::load_from_memory_with_format(&self.data, image::ImageFormat::Jpeg);
        let Ok(decoded) = decoded.map(image::DynamicImage::into_rgb8) else {
            return false;
        };
        let fits = decoded.as_raw().len() == rgb.len() && decoded.width() as usize == self.width_px;
        if fits {
            rgb.copy_from_slice(decoded.as_raw());
        }
        fits
    }

    /// One row; `red` is where the pattern's red lies in each square of 2 × 2 (column, row).
    fn bayer_row(&self, v: usize, red: [usize; 2], out: &mut [u8]) {
        let (width, height) = (self.width_px, self.height_px);
        // Neighbours beyond the border are those mirrored at it, which have the same colour.
        let mirror = |at: usize, step: isize, size: usize| {
            let there = at as isize + step;
            if there < 0 || there >= size as isize {
                (at as isize - step).clamp(0, size as isize - 1) as usize
            } else {
                there as usize
            }
        };
        let rows = [-1, 0, 1].map(|step| &self.data[mirror(v, step, height) * self.stride..]);
        let red_row = v % 2 == red[1];
        for (u, out) in out.chunks_exact_mut(3).enumerate() {
            let columns = [-1, 0, 1].map(|step| mirror(u, step, width));
            let at = |row: usize, column: usize| u32::from(rows[row][columns[column]]);
            let own = at(1, 1);
            let across = (at(1, 0) + at(1, 2)).div_ceil(2);
            let along = (at(0, 1) + at(2, 1)).div_ceil(2);
            let corners = (at(0, 0) + at(0, 2) + at(2, 0) + at(2, 2) + 2) / 4;
            let cross = (at(1, 0) + at(1, 2) + at(0, 1) + at(2, 1) + 2) / 4;
            let colours = match (red_row, u % 2 == red[0]) {
                (true, true) => [own, cross, corners],
                (true, false) => [across, own, along],
                (false, true) => [along, own, across],
                (false, false) => [corners, cross, own],
            };
            out.copy_from_slice(&colours.map(|colour| colour as u8));
        }
    }
}

/// Two pixels in four bytes; `order` says where Y, U, the second Y and V are.
fn pairs_to_rgb(row: &[u8], order: [usize; 4], out: &mut [u8]) {
    let [first, u, second, v] = order;
    for (out, pair) in out.chunks_exact_mut(6).zip(row.chunks_exact(4)) {
        out[..3].copy_from_slice(&yuv_to_rgb(pair[first], pair[u], pair[v]));
        out[3..].copy_from_slice(&yuv_to_rgb(pair[second], pair[u], pair[v]));
    }
}

/// ITU-R BT.601, limited range, in 1/65536.
fn yuv_to_rgb(y: u8, u: u8, v: u8) -> [u8; 3] {
    let luma = 76_309 * (i32::from(y) - 16) + 32_768;
    let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
    [
        luma + 104_597 * v,
        luma - 25_675 * u - 53_279 * v,
        luma + 132_201 * u,
    ]
    .map(|colour| (colour >> 16).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::frame::Pool;
    use localize::Stamp;

    fn frame(encoding: Encoding, width_px: usize, height_px: usize, data: &[u8]) -> CameraFrame {
        let filled = Pool::default().fill(|bytes| {
            bytes.extend_from_slice(data);
            Ok::<(), ()>(())
        });
        CameraFrame {
            stamp: Stamp(0),
            sequence: 0,
            width_px,
            height_px,
            encoding,
            stride: encoding.row_bytes(width_px),
            data: filled.expect("filled"),
        }
    }

    fn rgb(frame: &CameraFrame) -> Vec<u8> {
        let mut rgb = Vec::new();
        assert!(frame.to_rgb(&mut rgb));
        rgb
    }

    #[test]
    fn yuv_has_the_colours_of_bt601() {
        // White, black, and the red of 75 % colour bars.
        assert_eq!(
            rgb(&frame(Encoding::Yuyv, 2, 1, &[235, 128, 16, 128])),
            [255, 255, 255, 0, 0, 0]
        );
        let red = rgb(&frame(Encoding::Uyvy, 2, 1, &[100, 65, 212, 65]));
        for (found, wanted) in red.iter().zip([191, 0, 0, 191, 0, 0]) {
            assert!(found.abs_diff(wanted) <= 1, "{red:?}");
        }
        let planes = [235, 16, 16, 235, 128, 128];
        assert_eq!(
            rgb(&frame(Encoding::Nv12, 2, 2, &planes)),
            [255, 255, 255, 0, 0, 0, 0, 0, 0, 255, 255, 255]
        );
    }

    #[test]
    fn each_bayer_order_gives_back_an_even_colour() {
        let (red, green, blue) = (200, 100, 50);
        for (encoding, square) in [
            (Encoding::BayerRggb, [[red, green], [green, blue]]),
            (Encoding::BayerGrbg, [[green, red], [blue, green]]),
            (Encoding::BayerGbrg, [[green, blue], [red, green]]),
            (Encoding::BayerBggr, [[blue, green], [green, red]]),
        ] {
            let data: Vec<u8> = (0..6 * 4)
                .map(|at| square[at / 6 % 2][at % 6 % 2])
                .collect();
            let colours = rgb(&frame(encoding, 6, 4, &data));
            assert!(
                colours.chunks(3).all(|pixel| pixel == [red, green, blue]),
                "{encoding:?}"
            );
        }
    }

    #[test]
    fn a_torn_frame_has_no_colours() {
        let torn = frame(Encoding::Rgb8, 2, 2, &[0; 11]);
        assert!(!torn.to_rgb(&mut Vec::new()));
        assert!(!frame(Encoding::Mjpeg, 2, 2, &[0xFF, 0xD8, 1, 2]).to_rgb(&mut Vec::new()));
    }

    #[test]
    fn a_jpeg_is_decoded() {
        let mut jpeg = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
        encoder
            .encode(&[128; 3 * 16 * 8], 16, 8, image::ExtendedColorType::Rgb8)
            .expect("encoded");
        let colours = rgb(&frame(Encoding::Mjpeg, 16, 8, &jpeg));
        assert!(colours.iter().all(|level| level.abs_diff(128) <= 2));
    }

    #[test]
    fn the_wanted_format_or_the_most_welcome_is_chosen() {
        let offered = [Encoding::Grey8, Encoding::Mjpeg, Encoding::Yuyv].map(Encoding::fourcc);
        assert_eq!(Encoding::choose("", &offered), Some(Encoding::Yuyv));
        assert_eq!(Encoding::choose("GREY", &offered), Some(Encoding::Grey8));
        assert_eq!(Encoding::choose("NV12", &offered), None);
    }
}
