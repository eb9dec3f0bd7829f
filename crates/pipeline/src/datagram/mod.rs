//! Which datagrams do robots and other programs exchange? Messages, authentication and the team link.
//!
//! This module has functions of data only. Sockets belong to the application.

pub mod authentication;
pub mod message;
mod peer_clock;
mod peers;
mod proto_json;
mod team_link;
mod team_message;

pub use team_link::{TeamClock, TeamLink, TeamLinkCounts};

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use std::net::{Ipv4Addr, SocketAddrV4};

/// Settings of team messages by UDP multicast.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TeamLinkConfig {
    /// Multicast group and port.
    pub group: String,
    /// Address of the network interface; the loopback's keeps messages on this machine.
    pub interface: Ipv4Addr,
    /// The team's number: two teams may share a network.
    pub team: u32,
    /// Number of this robot.
    pub robot: u32,
    /// Numbers of the team's robots. Other numbers are received while there is place, 16 senders in all, and used while there is,
    /// `team.teammates_max` in all.
    pub members: Vec<u32>,
    /// A phrase of at least 8 characters that the team shares; messages then end with an authentication code. Other interfaces
    /// than the loopback require it.
    pub key: Option<String>,
    /// Messages per second on average. A message follows an image, so there are no more than images: 10 per second without a
    /// camera.
    pub rate: f64,
    /// After this time without a message a robot may restart with a lower session, seconds. Under a key never with one that
    /// another has replaced.
    pub silence: f64,
}

impl Default for TeamLinkConfig {
    fn default() -> Self {
        TeamLinkConfig {
            // Administratively scoped: routers do not forward it (RFC 2365).
            group: "239.255.77.1:7072".to_owned(),
            interface: Ipv4Addr::LOCALHOST,
            team: 1,
            robot: 1,
            members: vec![1, 2, 3, 4, 5, 6, 7, 8, 9, 10],
            key: None,
            // 15 messages of 300 bytes from each of five robots: 180 kbit/s.
            rate: 15.0,
            silence: 2.0,
        }
    }
}

impl TeamLinkConfig {
    /// Parses group and port. An error says why they are invalid.
    pub fn address(&self) -> Result<SocketAddrV4> {
        let group: SocketAddrV4 = self
            .group
            .parse()
            .with_context(|| format!("[team] group = {:?}: must be address:port", self.group))?;
        ensure!(
            group.ip().is_multicast(),
            "[team] group = {:?}: must be a multicast address, 224.0.0.0 to 239.255.255.255",
            self.group
        );
        ensure!(
            self.rate > 0.0 && self.rate <= 1000.0,
            "[team] rate = {}: must be above 0, to 1000",
            self.rate
        );
        ensure!(
            self.interface.is_loopback() || self.key.is_some(),
            "[team] interface = \"{}\" lets other machines send balls and robots without authentication: set a key",
            self.interface
        );
        Ok(group)
    }
}
