//! Where is the live stream offered, and with which images?

use pipeline::log::ImageCompression;
use serde::{Deserialize, Serialize};

/// Address of the stream and format of its images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct StreamConfig {
    /// Address to listen on. Everyone who reaches it can watch; the default is the loopback address.
    pub bind: String,
    /// TCP port; 0 selects a free one.
    pub port: u16,
    /// Image format: `jpeg` needs a tenth of `png`; `none` leaves images out.
    pub images: ImageCompression,
    /// Quality of JPEG images, 1 to 100.
    pub jpeg_quality: u8,
    /// Message queue of each viewer; when it is full, the oldest are dropped.
    pub backlog: usize,
}

impl Default for StreamConfig {
    fn default() -> Self {
        StreamConfig {
            bind: "127.0.0.1".to_owned(),
            // Foxglove's default port.
            port: 8765,
            images: ImageCompression::Jpeg,
            // 40 kB per image of 480 × 480: 10 Mbit/s at 30 Hz, which a wireless link carries.
            jpeg_quality: 80,
            // Half a second of all topics at 30 Hz.
            backlog: 256,
        }
    }
}
