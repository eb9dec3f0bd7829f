//! How does another program send images? A header and the bytes of each image over a local socket (docs/wire.md).

/// Bytes of a header.
pub const HEADER_BYTES: usize = 44;
/// Bytes of a settings message, which is sent in the opposite direction.
pub const SETTINGS_BYTES: usize = 16;
/// Largest accepted image, bytes: 8192 × 8192 pixels of one byte.
pub const IMAGE_BYTES_MAX: u32 = 1 << 26;
const IMAGE_MAGIC: &[u8; 4] = b"MBF1";
/// Settings with the gain in whole units, for every camera program.
const SETTINGS_MAGIC: &[u8; 4] = b"MBS1";
/// Settings with the gain in hundredths, for a program whose headers report exposure and gain.
const FINE_SETTINGS_MAGIC: &[u8; 4] = b"MBS2";

/// Header of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ImageHeader {
    /// V4L2 code of the pixel encoding.
    pub fourcc: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Bytes from one row to the next.
    pub stride: u32,
    /// Image counter.
    pub sequence: u32,
    /// Bytes that follow the header.
    pub bytes: u32,
    /// Time of exposure, CLOCK_MONOTONIC, nanoseconds.
    pub stamp_ns: i64,
    /// Exposure of this image, µs; 0 if unknown.
    pub exposure_us: u32,
    /// Gain of this image, hundredths; without meaning if the exposure is unknown.
    pub gain_centi: i16,
}

/// Settings for the following images; −1 for automatic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SettingsMessage {
    /// Exposure, µs.
    pub exposure_us: i32,
    /// Gain, unit of the camera.
    pub gain: i32,
    /// Gain in hundredths of the unit, in place of `gain`, if the program understands it.
    pub gain_centi: Option<i32>,
    /// White balance, kelvin.
    pub white_balance_k: i32,
}

impl ImageHeader {
    /// The header's bytes, which end with a checksum.
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
        bytes[36..40].copy_from_slice(&self.exposure_us.to_le_bytes());
        bytes[40..42].copy_from_slice(&self.gain_centi.to_le_bytes());
        let checksum = super::crc16(&bytes[..42]);
        bytes[42..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// The header; `None` for a wrong magic or checksum, or an image that is too large.
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
            exposure_us: number(36),
            gain_centi: i16::from_le_bytes([bytes[40], bytes[41]]),
        };
        let valid = bytes[..4] == *IMAGE_MAGIC
            && bytes[42..] == super::crc16(&bytes[..42]).to_le_bytes()
            && header.bytes <= IMAGE_BYTES_MAX;
        valid.then_some(header)
    }
}

impl SettingsMessage {
    /// The bytes of the message.
    pub fn encode(&self) -> [u8; SETTINGS_BYTES] {
        let mut bytes = [0; SETTINGS_BYTES];
        let (magic, gain) = match self.gain_centi {
            Some(gain_centi) => (FINE_SETTINGS_MAGIC, gain_centi),
            None => (SETTINGS_MAGIC, self.gain),
        };
        bytes[..4].copy_from_slice(magic);
        let numbers = [self.exposure_us, gain, self.white_balance_k];
        for (place, number) in bytes[4..].chunks_exact_mut(4).zip(numbers) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        bytes
    }

    /// The settings, for a program that acts as a camera; `None` for a wrong magic.
    pub fn decode(bytes: &[u8; SETTINGS_BYTES]) -> Option<Self> {
        let number = |at: usize| {
            i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let is_fine = bytes[..4] == *FINE_SETTINGS_MAGIC;
        let settings = SettingsMessage {
            exposure_us: number(4),
            gain: if is_fine { number(8) / 100 } else { number(8) },
            gain_centi: is_fine.then(|| number(8)),
            white_balance_k: number(12),
        };
        (is_fine || bytes[..4] == *SETTINGS_MAGIC).then_some(settings)
    }
}
