//! What is a frame of a camera? Stamped bytes in the camera's own encoding, from a pool, and their colours.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use localize::Stamp;

/// How a camera's bytes make pixels.
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
    /// One colour a pixel; the first row begins red, green.
    BayerRggb,
    /// The first row begins green, red.
    BayerGrbg,
    /// The first row begins green, blue.
    BayerGbrg,
    /// The first row begins blue, green.
    BayerBggr,
    /// A JPEG image each.
    Mjpeg,
}

/// Encodings by V4L2's names, the most welcome first: full colour without loss, then with, then none.
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
        let found = FOURCCS
            .iter()
            .find(|(_, name)| **name == code.to_le_bytes());
        found.map(|(encoding, _)| *encoding)
    }

    /// The V4L2 code.
    pub fn fourcc(self) -> u32 {
        let found = FOURCCS.iter().find(|(encoding, _)| *encoding == self);
        found.map_or(0, |(_, name)| u32::from_le_bytes(**name))
    }

    /// Of the codes that a camera offers the one named `wanted`, or with no name the most welcome.
    pub(crate) fn choose(wanted: &str, offered: &[u32]) -> Option<Self> {
        let fits = |name: &[u8; 4]| wanted.is_empty() || wanted.as_bytes() == name;
        let found = FOURCCS
            .iter()
            .find(|(_, name)| fits(name) && offered.contains(&u32::from_le_bytes(**name)));
        found.map(|(encoding, _)| *encoding)
    }

    /// Bytes that a row of so many pixels needs; of JPEG nothing is known.
    pub fn row_bytes(self, width_px: usize) -> usize {
        match self {
            Encoding::Yuyv | Encoding::Uyvy => 2 * width_px,
            Encoding::Rgb8 | Encoding::Bgr8 => 3 * width_px,
            Encoding::Mjpeg => 0,
            _ => width_px,
        }
    }

    /// Bytes of a whole frame with rows `stride` bytes apart.
    pub fn image_bytes(self, width_px: usize, height_px: usize, stride: usize) -> usize {
        let rows = match self {
            Encoding::Nv12 => height_px + height_px / 2,
            Encoding::Mjpeg => return 1,
            _ => height_px,
        };
        stride * rows.saturating_sub(1) + self.row_bytes(width_px)
    }
}

/// Bytes of a frame that go back to their pool when the last one who holds them lets go.
#[derive(Debug, Default)]
pub struct PooledBytes {
    bytes: Vec<u8>,
    pool: Weak<Mutex<Vec<Vec<u8>>>>,
}

impl Deref for PooledBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl PartialEq for PooledBytes {
    fn eq(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }
}

impl Drop for PooledBytes {
    fn drop(&mut self) {
        if let Some(pool) = self.pool.upgrade() {
            let bytes = std::mem::take(&mut self.bytes);
            let mut free = pool.lock().unwrap_or_else(PoisonError::into_inner);
            if free.len() < FREE_BUFFERS_MAX {
                free.push(bytes);
            }
        }
    }
}

/// Buffers that wait to be used again: one that is filled, one in the inbox, one looked at, some in the log's queue. What a slow
/// disk needed beyond them is given back.
const FREE_BUFFERS_MAX: usize = 8;

/// Where frames' bytes come from: buffers that were used before, if there are some.
#[derive(Debug, Default)]
pub(crate) struct BufferPool {
    free: Arc<Mutex<Vec<Vec<u8>>>>,
}

impl BufferPool {
    /// Bytes as `fill` appends them to an empty buffer.
    pub(crate) fn fill<E>(
        &self,
        fill: impl FnOnce(&mut Vec<u8>) -> Result<(), E>,
    ) -> Result<Arc<PooledBytes>, E> {
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut bytes = free.pop().unwrap_or_default();
        drop(free);
        bytes.clear();
        let filled = fill(&mut bytes);
        let pool = Arc::downgrade(&self.free);
        let bytes = Arc::new(PooledBytes { bytes, pool });
        filled.map(|()| bytes)
    }
}

/// A frame as the camera sent it.
#[derive(Debug, Clone, PartialEq)]
pub struct CapturedImage {
    /// When it was taken, as the driver says (CLOCK_MONOTONIC).
    pub stamp: Stamp,
    /// Counted by the driver; a step of more than one tells of lost frames.
    pub sequence: u32,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// How the bytes make pixels.
    pub encoding: Encoding,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// It is the frame before it, to the last bit of a sample of its bytes: no sight of what is there now.
    pub repeated: bool,
    /// The bytes.
    pub data: Arc<PooledBytes>,
}
