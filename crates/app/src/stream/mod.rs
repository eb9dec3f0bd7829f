//! How does one watch a robot that is playing? The topics of its log, live, over a WebSocket.
//!
//! Foxglove and Lichtblick open `ws://127.0.0.1:8765`; our own debug view reads the same stream by [`Client`].

mod client;
mod server;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use client::{StreamClient, StreamEvent};
pub use server::StreamServer;

use pipeline::log::ImageCompression;

/// Where those who watch find the stream, and what they get of the images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StreamConfig {
    /// Address to listen on; anybody who reaches it may watch, so it is this machine's own unless changed.
    pub bind: String,
    /// TCP port; 0 takes a free one.
    pub port: u16,
    /// How images go out: `jpeg` is a tenth of `png`, `none` leaves them out.
    pub images: ImageCompression,
    /// Of JPEG images, 1 to 100.
    pub jpeg_quality: u8,
    /// Messages that may wait for one viewer; beyond it the oldest are dropped.
    pub backlog: usize,
}

impl Default for StreamConfig {
    fn default() -> Self {
        StreamConfig {
            bind: "127.0.0.1".to_owned(),
            // Where Foxglove looks first.
            port: 8765,
            images: ImageCompression::Jpeg,
            // 40 kB an image of 480 × 480: ten megabit a second at 30 Hz, which a wireless link carries.
            jpeg_quality: 80,
            // Half a second of all topics at 30 Hz.
            backlog: 256,
        }
    }
}
