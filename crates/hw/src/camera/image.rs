//! How is a camera image stored? Stamped bytes in the camera's pixel encoding.

use std::sync::Arc;

use localize::Stamp;
use localize::robot::ExposureSetting;

use super::buffer_pool::PooledBytes;

/// Pixel encoding of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// Y U Y V, two pixels in four bytes.
    Yuyv,
    /// U Y V Y, two pixels in four bytes.
    Uyvy,
    /// A plane of Y, then one of U V pairs at half the size.
    Nv12,
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Brightness.
    Grey8,
    /// Bayer pattern, one colour per pixel; the first row begins red, green.
    BayerRggb,
    /// Bayer pattern; the first row begins green, red.
    BayerGrbg,
    /// Bayer pattern; the first row begins green, blue.
    BayerGbrg,
    /// Bayer pattern; the first row begins blue, green.
    BayerBggr,
    /// One JPEG per image.
    Mjpeg,
}

/// Encodings and their V4L2 codes in order of preference: full colour, then subsampled or lossy, then grey.
const FOURCCS: [(Encoding, &[u8; 4]); 11] = [
    (Encoding::Rgb8, b"RGB3"),
    (Encoding::Bgr8, b"BGR3"),
    (Encoding::Yuyv, b"YUYV"),
    (Encoding::Uyvy, b"UYVY"),
    (Encoding::BayerRggb, b"RGGB"),
    (Encoding::BayerGrbg, b"GRBG"),
    (Encoding::BayerGbrg, b"GBRG"),
    (Encoding::BayerBggr, b"BA81"),
    (Encoding::Nv12, b"NV12"),
    (Encoding::Mjpeg, b"MJPG"),
    (Encoding::Grey8, b"GREY"),
];

impl Encoding {
    /// The encoding of a V4L2 code.
    pub fn from_fourcc(code: u32) -> Option<Self> {
        let entry = FOURCCS
            .iter()
            .find(|(_, name)| **name == code.to_le_bytes());
        entry.map(|(encoding, _)| *encoding)
    }

    /// The V4L2 code.
    pub fn fourcc(self) -> u32 {
        let entry = FOURCCS.iter().find(|(encoding, _)| *encoding == self);
        entry.map_or(0, |(_, name)| u32::from_le_bytes(**name))
    }

    /// The encoding of code `name` if the camera offers it; for an empty name the preferred one that it offers.
    pub(crate) fn choose(name: &str, offered: &[u32]) -> Option<Self> {
        let fits = |code: &[u8; 4]| name.is_empty() || name.as_bytes() == code;
        let entry = FOURCCS
            .iter()
            .find(|(_, code)| fits(code) && offered.contains(&u32::from_le_bytes(**code)));
        entry.map(|(encoding, _)| *encoding)
    }

    /// Bytes of a row of `width_px` pixels; 0 for JPEG.
    pub fn row_bytes(self, width_px: usize) -> usize {
        match self {
            Encoding::Yuyv | Encoding::Uyvy => 2 * width_px,
            Encoding::Rgb8 | Encoding::Bgr8 => 3 * width_px,
            Encoding::Mjpeg => 0,
            _ => width_px,
        }
    }

    /// Least bytes of an image whose rows are `stride` bytes apart.
    pub fn image_bytes(self, width_px: usize, height_px: usize, stride: usize) -> usize {
        let rows = match self {
            Encoding::Nv12 => height_px + height_px / 2,
            Encoding::Mjpeg => return 1,
            _ => height_px,
        };
        stride * rows.saturating_sub(1) + self.row_bytes(width_px)
    }
}

/// What a camera delivered since the last call.
#[derive(Debug)]
pub(super) struct Capture {
    /// The newest complete image, if any.
    pub(super) image: Option<CapturedImage>,
    /// Incomplete images before it.
    pub(super) damaged: u32,
}

/// An image as the camera sent it.
#[derive(Debug, Clone, PartialEq)]
pub struct CapturedImage {
    /// Time of exposure by the driver (CLOCK_MONOTONIC).
    pub stamp: Stamp,
    /// Image counter of the driver; a step of more than one means lost images.
    pub sequence: u32,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Pixel encoding of `data`.
    pub encoding: Encoding,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// True if the compared bytes equal those of the image before: it shows nothing new.
    pub repeated: bool,
    /// Exposure (seconds) and gain (unit of the driver) of this image; `None` if the camera does not report them.
    pub setting: Option<ExposureSetting>,
    /// Rows from top to bottom.
    pub data: Arc<PooledBytes>,
}
