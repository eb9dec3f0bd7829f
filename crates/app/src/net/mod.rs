//! How do other programs and team-mates communicate with the robot? State output, commands and team messages by UDP.
//!
//! `docs/network.md` describes the messages, `docs/network.proto` their encoding.

pub(crate) mod commands;
mod polling;
pub(crate) mod state_sender;
pub(crate) mod team;
#[cfg(test)]
mod tests;

use std::path::Path;

use anyhow::{Context, Result};
use localize::Stamp;
use serde::{Deserialize, Serialize};

pub(crate) use commands::{CommandConfig, CommandListener, RemoteCommand};
pub(crate) use pipeline::datagram::TeamLinkConfig;
pub(crate) use state_sender::{OutputConfig, StateSender};
pub(crate) use team::TeamTransport;

use crate::stream::{self, StreamConfig, StreamPreamble};
use pipeline::feed::Feed;

/// Content of network.toml. What is not configured is off.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct NetworkConfig {
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
pub(crate) struct Network {
    /// Commands of other programs.
    pub commands: Option<CommandListener>,
    /// Team messages: the received reports are samples for the pipeline.
    pub team: Option<TeamTransport>,
    /// The live stream, kept until the end.
    _stream: Option<stream::StreamServer>,
    /// The state output, kept until the end.
    _state_sender: Option<StateSender>,
}

impl NetworkConfig {
    /// Reads and checks network.toml.
    pub(crate) fn load(path: &Path) -> Result<Self> {
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
    pub(crate) fn start(
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
            _stream: self.stream.as_ref().map(stream).transpose()?,
            _state_sender: (!self.outputs.is_empty())
                .then(|| StateSender::start(feed, &self.outputs))
                .transpose()?,
        })
    }
}
