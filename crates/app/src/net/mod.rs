//! How do other programs and team-mates take part? State out and commands in by UDP, and words among the team.
//!
//! `docs/network.md` says what is on the wire, `docs/network.proto` in which numbers.

pub mod commands;
pub mod message;
pub mod out;
pub mod seal;
pub mod team;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use commands::{CommandConfig, Commands, Order};
pub use out::{OutputConfig, Sender};
pub use team::{Link, LinkConfig};

use crate::stream::StreamConfig;

/// Everything that goes over the network; all of it is off unless configured.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkConfig {
    /// Who gets our state by UDP: one `[[outputs]]` each.
    pub outputs: Vec<OutputConfig>,
    /// Drive and kick commands by UDP.
    pub commands: Option<CommandConfig>,
    /// Words among team-mates by UDP.
    pub team: Option<LinkConfig>,
    /// The live stream for viewers.
    pub stream: Option<StreamConfig>,
}
