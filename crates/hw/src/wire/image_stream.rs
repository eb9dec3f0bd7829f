//! How does another program hand over images? A header and the bytes of each frame, over a local socket (docs/wire.md).

/// Bytes of a header.
pub const HEADER_BYTES: usize = 44;
/// Bytes of settings, which go the other way.
pub const SETTINGS_BYTES: usize = 16;
/// Largest frame taken, bytes: 8192 × 8192 pixels of one byte.
pub const IMAGE_BYTES_MAX: u32 = 1 << 26;
const IMAGE_MAGIC: &[u8; 4] = b"MBF1";
const SETTINGS_MAGIC: &[u8; 4] = b"MBS1";

/// What stands before a frame's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ImageHeader {
    /// V4L2's code of the encoding.
    pub fourcc: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Bytes from one row to the next.
    pub stride: u32,
    /// Counts the frames.
    pub sequence: u32,
    /// Bytes that follow.
    pub bytes: u32,
    /// When the frame was taken, CLOCK_MONOTONIC, nanoseconds.
    pub stamp_ns: i64,
}

/// How the frames are to be taken; −1 leaves it to the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SettingsMessage {
    /// Exposure, µs.
    pub exposure_us: i32,
    /// Gain, the camera's own unit.
    pub gain: i32,
    /// White balance, kelvin.
    pub white_balance_k: i32,
}

impl ImageHeader {
    /// The header's bytes, with a checksum at their end.
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        bytes[..4].copy_from_slice(IMAGE_MAGIC);
        let numbers = [
            self.fourcc,
            self.width_px,
            self.height_px,
            self.stride,
            self.sequence,
            self.bytes,
        ];
        for (place, number) in bytes[4..28].chunks_exact_mut(4).zip(numbers) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        bytes[28..36].copy_from_slice(&self.stamp_ns.to_le_bytes());
        let checksum = super::crc16(&bytes[..42]);
        bytes[42..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// A header, if these are the bytes of one.
    pub fn decode(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let number = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let header = ImageHeader {
            fourcc: number(4),
            width_px: number(8),
            height_px: number(12),
            stride: number(16),
            sequence: number(20),
            bytes: number(24),
            stamp_ns: (i64::from(number(32)) << 32) | i64::from(number(28)),
        };
        let right = bytes[..4] == *IMAGE_MAGIC
            && bytes[42..] == super::crc16(&bytes[..42]).to_le_bytes()
            && header.bytes <= IMAGE_BYTES_MAX;
        right.then_some(header)
    }
}

impl SettingsMessage {
    /// The settings' bytes.
    pub fn encode(&self) -> [u8; SETTINGS_BYTES] {
        let mut bytes = [0; SETTINGS_BYTES];
        bytes[..4].copy_from_slice(SETTINGS_MAGIC);
        let numbers = [self.exposure_us, self.gain, self.white_balance_k];
        for (place, number) in bytes[4..].chunks_exact_mut(4).zip(numbers) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        bytes
    }

    /// Settings, if these are the bytes of some. For whoever plays a camera.
    pub fn decode(bytes: &[u8; SETTINGS_BYTES]) -> Option<Self> {
        let number = |at: usize| {
            i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let settings = SettingsMessage {
            exposure_us: number(4),
            gain: number(8),
            white_balance_k: number(12),
        };
        (bytes[..4] == *SETTINGS_MAGIC).then_some(settings)
    }
}
