//! How do other programs and team-mates communicate with the robot? State output, commands and team messages by UDP.
//!
//! `docs/network.md` describes the messages, `docs/network.proto` their encoding.

pub mod commands;
mod polling;
pub mod state_sender;
pub mod team;
#[cfg(test)]
mod tests;

use std::path::Path;

use anyhow::{Context, Result};
use localize::Stamp;
use serde::{Deserialize, Serialize};

pub use commands::{CommandConfig, CommandListener, RemoteCommand};
pub use pipeline::datagram::TeamLinkConfig;
pub use state_sender::{OutputConfig, StateSender};
pub use team::TeamTransport;

use crate::stream::{self, StreamConfig, StreamPreamble};
use pipeline::feed::Feed;

/// Content of network.toml. What is not configured is off.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkConfig {
    /// Receivers of the state by UDP, one `[[outputs]]` each.
    pub outputs: Vec<OutputConfig>,
    /// Drive and kick commands by UDP.
    pub commands: Option<CommandConfig>,
    /// Team messages by UDP.
    pub team: Option<TeamLinkConfig>,
    /// The live stream for viewers.
    pub stream: Option<StreamConfig>,
}

/// The running network threads. Dropping it ends them.
pub struct Network {
    /// Commands of other programs.
    pub commands: Option<CommandListener>,
    /// Team messages: the received reports are samples for the pipeline.
    pub team: Option<TeamTransport>,
    /// The live stream.
    pub stream: Option<stream::StreamServer>,
    /// Sends the state to other programs.
    pub state_sender: Option<StateSender>,
}

impl NetworkConfig {
    /// Reads and checks network.toml.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let config: NetworkConfig =
            toml::from_str(&text).with_context(|| path.display().to_string())?;
        config.check().with_context(|| path.display().to_string())?;
        Ok(config)
    }

    fn check(&self) -> Result<()> {
        if let Some(commands) = &self.commands {
            commands.address()?;
            commands::CommandFilter::new(commands)?;
        }
        if let Some(team) = &self.team {
            team.address()?;
        }
        Ok(())
    }

    /// Starts the configured threads on the cycles of `feed`.
    ///
    /// `session`: must increase with each start (nanoseconds since 1970). `clock`: current time in the clock of the samples.
    /// `execute`: executes a remote command; false if it is overruled.
    pub fn start(
        &self,
        feed: &Feed,
        preamble: StreamPreamble<'_>,
        session: u64,
        clock: impl Fn() -> Stamp + Clone + Send + 'static,
        execute: impl FnMut(RemoteCommand) -> bool + Send + 'static,
    ) -> Result<Network> {
        let stream = |config| stream::StreamServer::start(feed, preamble, config);
        let team = |config| TeamTransport::join(feed, config, session, clock);
        let listen = |config| CommandListener::listen(config, execute);
        Ok(Network {
            commands: self.commands.as_ref().map(listen).transpose()?,
            team: self.team.as_ref().map(team).transpose()?,
            stream: self.stream.as_ref().map(stream).transpose()?,
            state_sender: (!self.outputs.is_empty())
                .then(|| StateSender::start(feed, &self.outputs))
                .transpose()?,
        })
    }
}
