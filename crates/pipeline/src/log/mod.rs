//! What is kept of a run, and how does it come back? Cycles to an MCAP file that other tools open, and back bit for bit.

pub mod columns;
mod encoded_image;
mod export;
mod fallback;
mod header;
mod index;
mod mcap_records;
pub mod publisher;
pub mod read;
mod record;
mod recover;
pub mod schema;
mod start;
#[cfg(test)]
mod tests;
mod verify;
mod writer;

use serde::{Deserialize, Serialize};

pub use encoded_image::{EncodedImage, ImageCompression};
pub use export::export;
pub use header::Header;
pub use index::{ChunkInfo, LogIndex};
pub use mcap_records::LogEnd;
pub use read::{LogReader, LoggedCycle};
pub use record::{LogStats, Recorder};
pub use recover::recover;
pub use schema::convert::mode_and_reason;
pub use start::start_log;
pub use verify::{Difference, VerificationReport, verify};

/// How a log is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// How images are kept.
    pub images: ImageCompression,
    /// Of JPEG images, 1 to 100.
    pub jpeg_quality: u8,
    /// Images that may wait to be written; beyond it the oldest is dropped (live) or the run waits (simulation).
    pub queue_images: usize,
    /// Cycles that may wait to be written.
    pub queue_cycles: usize,
    /// What was logged is safe from a kill after so many seconds.
    pub flush_period: f32,
}

impl Default for LogConfig {
    fn default() -> Self {
        LogConfig {
            images: ImageCompression::Png,
            jpeg_quality: 90,
            // A second at 30 Hz: 20 MB at 480 × 480 pixels.
            queue_images: 30,
            queue_cycles: 300,
            // Within the second that a kill may cost: writing takes time, too, and each flush ends a chunk that is remembered.
            flush_period: 0.75,
        }
    }
}
