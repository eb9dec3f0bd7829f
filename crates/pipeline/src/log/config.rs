//! How is a log written? Images, queues and the period of its flushes.

use serde::{Deserialize, Serialize};

use super::encoded_image::ImageCompression;

/// Settings of a log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// Compression of the images.
    pub images: ImageCompression,
    /// Quality of JPEG images, 1 to 100.
    pub jpeg_quality: u8,
    /// Images that may wait for the writer. Beyond it, the oldest is dropped (live) or the run waits (simulation).
    pub queue_images: usize,
    /// Cycles that may wait for the writer.
    pub queue_cycles: usize,
    /// Period of flushes, seconds; later data is lost if the process is killed.
    pub flush_period: f32,
}

impl Default for LogConfig {
    fn default() -> Self {
        LogConfig {
            images: ImageCompression::Png,
            jpeg_quality: 90,
            // One second at 30 Hz: 20 MB at 480 × 480 pixels.
            queue_images: 30,
            queue_cycles: 300,
            // A kill loses at most one second, writing included. Shorter periods cost memory: a flush ends a chunk.
            flush_period: 0.75,
        }
    }
}
