//! Where is the live stream offered, and with which images?

use std::net::IpAddr;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use pipeline::datagram::authentication::MacKey;
use pipeline::log::ImageCompression;
use serde::{Deserialize, Serialize};

use super::guard::GuardLimits;

/// Address of the stream and format of its images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct StreamConfig {
    /// Address to listen on. Everyone who reaches it can watch; the default is the loopback address.
    pub bind: String,
    /// TCP port; 0 selects a free one.
    pub port: u16,
    /// Image format: `jpeg` needs a tenth of `png` at quality 80; `none` leaves images out.
    pub images: ImageCompression,
    /// Quality of JPEG images, 1 to 100.
    pub jpeg_quality: u8,
    /// Message queue of each viewer; when it is full, the oldest are dropped.
    pub backlog: usize,
    /// Viewers at the same time.
    pub connections: usize,
    /// Viewers at the same time from one address.
    pub connections_per_address: usize,
    /// A viewer that takes nothing for this time is dropped, seconds.
    pub stall: f64,
    /// Web pages that may connect, with or without a port; "*" for all. Programs that are no browser need no entry.
    pub origins: Vec<String>,
    /// Viewers may change settings while the robot plays. On other addresses than the loopback this needs a key.
    pub tuning: bool,
    /// Phrase of at least 8 characters under which viewers seal their changes.
    pub key: Option<String>,
}

impl StreamConfig {
    /// Checks the values. An error names the key.
    pub(crate) fn check(&self) -> Result<()> {
        ensure!(
            (1..=100).contains(&self.jpeg_quality),
            "[stream] invalid jpeg_quality: {} (expected 1 to 100)",
            self.jpeg_quality
        );
        for (key, value, most) in [
            ("backlog", self.backlog, 100_000),
            ("connections", self.connections, 256),
            ("connections_per_address", self.connections_per_address, 256),
        ] {
            ensure!(
                (1..=most).contains(&value),
                "[stream] invalid {key}: {value} (expected 1 to {most})"
            );
        }
        let is_loopback = self
            .bind
            .parse::<IpAddr>()
            .map_or(self.bind == "localhost", |address| address.is_loopback());
        ensure!(
            !self.tuning || is_loopback || self.key.is_some(),
            "[stream] bind = {:?} lets other machines change settings without authentication: set a key",
            self.bind
        );
        if let Some(key) = &self.key {
            MacKey::new(key).context("[stream]")?;
        }
        ensure!(
            (0.1..=3600.0).contains(&self.stall),
            "[stream] invalid stall: {} (expected 0.1 to 3600)",
            self.stall
        );
        Ok(())
    }

    pub(super) fn limits(&self) -> GuardLimits {
        GuardLimits {
            connections: self.connections,
            connections_per_address: self.connections_per_address,
            stall: Duration::from_secs_f64(self.stall),
            origins: self.origins.clone(),
        }
    }
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
            connections: 16,
            connections_per_address: 8,
            stall: 5.0,
            origins: vec![
                "https://app.foxglove.dev".to_owned(),
                "http://localhost".to_owned(),
                "http://127.0.0.1".to_owned(),
                "file://".to_owned(),
            ],
            tuning: false,
            key: None,
        }
    }
}
