//! How do other programs and team-mates take part? State out and commands in by UDP, and words among the team.
//!
//! `docs/network.md` says what is on the wire, `docs/network.proto` in which numbers.

pub mod commands;
pub mod state_sender;
pub mod team;
#[cfg(test)]
mod tests;

use std::path::Path;

use anyhow::{Context, Result};
use localize::{Field, Stamp};
use serde::{Deserialize, Serialize};

pub use commands::{CommandConfig, CommandListener, RemoteCommand};
pub use pipeline::datagram::TeamLinkConfig;
pub use state_sender::{OutputConfig, StateSender};
pub use team::TeamTransport;

use crate::stream::{self, StreamConfig};
use pipeline::feed::Feed;
use pipeline::log::Header;

/// Everything that goes over the network; all of it is off unless configured.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkConfig {
    /// Who gets our state by UDP: one `[[outputs]]` each.
    pub outputs: Vec<OutputConfig>,
    /// Drive and kick commands by UDP.
    pub commands: Option<CommandConfig>,
    /// Words among team-mates by UDP.
    pub team: Option<TeamLinkConfig>,
    /// The live stream for viewers.
    pub stream: Option<StreamConfig>,
}

/// What of it is running; dropping it ends it.
pub struct Network {
    /// Commands of other programs.
    pub commands: Option<CommandListener>,
    /// Words of team-mates: its reports are samples for the spine.
    pub team: Option<TeamTransport>,
    /// The live stream.
    pub stream: Option<stream::StreamServer>,
    /// Who tells other programs.
    pub state_sender: Option<StateSender>,
}

impl NetworkConfig {
    /// Reads a file of these sections; refuses what could not be started from it.
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

    /// Starts what is configured, on the cycles of `feed`.
    ///
    /// `header` and `field`: what viewers get first. `session`: larger for each start, nanoseconds since 1970 will do.
    /// `clock`: the time that stamps samples, now. `obey`: carries out another program's command, or says that it does not.
    pub fn start(
        &self,
        feed: &Feed,
        (header, field): (&Header, &Field),
        session: u64,
        clock: impl Fn() -> Stamp + Clone + Send + 'static,
        obey: impl FnMut(RemoteCommand) -> bool + Send + 'static,
    ) -> Result<Network> {
        let stream = |config| stream::StreamServer::start(feed, header, field, config);
        let team = |config| TeamTransport::join(feed, config, session, clock);
        let listen = |config| CommandListener::listen(config, obey);
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
