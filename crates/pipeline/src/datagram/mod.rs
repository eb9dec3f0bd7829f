//! What do datagrams between robots and other programs say? Messages, their authentication, and the team's exchange.
//!
//! Functions of data: sockets are the application's.

pub mod authentication;
pub mod message;
mod peer_clock;
mod team_link;

pub use peer_clock::PeerClock;
pub use team_link::{TeamLink, TeamLinkCounts};

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use std::net::{Ipv4Addr, SocketAddrV4};

/// Words among team-mates by UDP multicast.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TeamLinkConfig {
    /// Multicast group and port.
    pub group: String,
    /// Address of the network card; the loopback's keeps the words on this machine.
    pub interface: Ipv4Addr,
    /// The team's number: two teams may share a network.
    pub team: u32,
    /// Our own number.
    pub robot: u32,
    /// A phrase that the team shares; words then end with their authentication code.
    pub key: Option<String>,
    /// Words a second.
    pub rate: f64,
    /// A robot that was silent for so many seconds may begin anew with a lower session.
    pub silence: f64,
}

impl Default for TeamLinkConfig {
    fn default() -> Self {
        TeamLinkConfig {
            // Administratively scoped: no router hands it on (RFC 2365).
            group: "239.255.77.1:7072".to_owned(),
            interface: Ipv4Addr::LOCALHOST,
            team: 1,
            robot: 1,
            key: None,
            // 15 words of 300 bytes from each of five robots: 180 kbit/s.
            rate: 15.0,
            silence: 2.0,
        }
    }
}

impl TeamLinkConfig {
    /// Group and port, or why it cannot be used.
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
        Ok(group)
    }
}
