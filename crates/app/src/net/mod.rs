//! How do other programs and team-mates communicate with the robot? State output, commands and team messages by UDP.
//!
//! `docs/network.md` describes the messages, `docs/network.proto` their encoding.

mod address;
mod command_senders;
pub(crate) mod commands;
mod lock;
#[cfg(test)]
mod multicast_tests;
mod polling;
mod rejection_notices;
mod send_schedule;
pub(crate) mod state_sender;
pub(crate) mod team;
#[cfg(test)]
mod tests;

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use localize::Stamp;
use localize::toml_file;
use serde::{Deserialize, Serialize};

pub(crate) use address::bind;
pub(crate) use commands::{CommandConfig, CommandListener, RemoteCommand, RobotIdentity};
pub(crate) use pipeline::datagram::TeamLinkConfig;
pub(crate) use state_sender::{CommandStatus, Obstacle, OutputConfig, StateSender};
pub(crate) use team::TeamTransport;

use crate::ros2::config::Ros2Config;
use crate::run::tuning::TuningHandle;
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
    /// A node of ROS 2.
    pub ros2: Option<Ros2Config>,
}

/// The running network threads. Dropping it ends them.
pub(crate) struct Network {
    /// Commands of other programs.
    pub commands: Option<CommandListener>,
    /// Team messages: the received reports are samples for the pipeline.
    pub team: Option<TeamTransport>,
    /// The live stream, kept until the end.
    pub stream: Option<stream::StreamServer>,
    /// The state output, kept until the end.
    pub state_sender: Option<StateSender>,
}

/// Reads and checks network.toml. The error names file, line and reason.
pub fn check_network_file(path: &Path) -> Result<()> {
    NetworkConfig::load(path).map(|_| ())
}

impl NetworkConfig {
    /// Reads and checks network.toml.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let (config, _): (NetworkConfig, _) = toml_file::read(path)?;
        config.check().with_context(|| path.display().to_string())?;
        Ok(config)
    }

    fn check(&self) -> Result<()> {
        if let Some(commands) = &self.commands {
            commands.address()?;
            commands.check_validity()?;
            let robot = self.robot_number();
            commands::CommandFilter::new(commands, RobotIdentity { robot, boot: 1 })?;
            if commands.key.is_some() {
                self.check_identity_is_published(robot)?;
            }
        }
        for output in &self.outputs {
            address::check_form(&output.to).context("[[outputs]] to")?;
        }
        if let Some(team) = &self.team {
            team.address()?;
        }
        if let Some(stream) = &self.stream {
            stream.check()?;
        }
        if let Some(ros2) = &self.ros2 {
            ros2.check()?;
        }
        Ok(())
    }

    /// Under a key a command must echo the robot's number and the boot number, which only the state output publishes.
    fn check_identity_is_published(&self, robot: u32) -> Result<()> {
        ensure!(
            !self.outputs.is_empty(),
            "[commands] key without [[outputs]]: a command under a key echoes `boot` from the state output, so none could be valid. Add [[outputs]] to the sender"
        );
        if let Some(differs) = self.outputs.iter().find(|output| output.robot != robot) {
            bail!(
                "[[outputs]] robot = {} and robot = {robot} differ, but commands under a key name one robot. Make them equal",
                differs.robot
            );
        }
        Ok(())
    }

    /// Number of this robot: that of its state output, else that in the team, else 1.
    fn robot_number(&self) -> u32 {
        let output = self.outputs.first().map(|output| output.robot);
        output
            .or(self.team.as_ref().map(|team| team.robot))
            .unwrap_or(1)
    }

    /// Starts the configured threads on the cycles of `feed`.
    ///
    /// `tuning`: changes settings, if the stream's viewers may. `session`: must increase with each start (nanoseconds since 1970). `clock`: current time in the clock of the samples.
    /// `execute`: executes a remote command; false if it is overruled. `obstacle`: why executed commands have no effect now.
    pub(crate) fn start(
        &self,
        feed: &Feed,
        (preamble, tuning): (StreamPreamble<'_>, Option<TuningHandle>),
        session: u64,
        clock: impl Fn() -> Stamp + Clone + Send + 'static,
        (execute, obstacle): (impl FnMut(RemoteCommand) -> bool + Send + 'static, Obstacle),
    ) -> Result<Network> {
        let stream = |config| stream::StreamServer::start(feed, preamble, tuning.clone(), config);
        let team = |config| TeamTransport::join(feed, config, session, clock);
        let identity = RobotIdentity {
            robot: self.robot_number(),
            boot: random_boot_number()?,
        };
        let listen = |config| CommandListener::listen(config, identity, execute);
        let commands = self.commands.as_ref().map(listen).transpose()?;
        let status = commands.as_ref().map(|commands| CommandStatus {
            identity,
            listener: commands.shared(),
            obstacle,
        });
        Ok(Network {
            commands,
            team: self.team.as_ref().map(team).transpose()?,
            stream: self.stream.as_ref().map(stream).transpose()?,
            state_sender: (!self.outputs.is_empty())
                .then(|| StateSender::start(feed, &self.outputs, status))
                .transpose()?,
        })
    }
}

/// A number of this start that nobody can guess: 1 to 2⁵³, which every JSON reader keeps exactly.
fn random_boot_number() -> Result<u64> {
    use std::io::Read;
    let mut bytes = [0; 8];
    std::fs::File::open("/dev/urandom")
        .and_then(|mut file| file.read_exact(&mut bytes))
        .context("cannot read /dev/urandom")?;
    Ok((u64::from_le_bytes(bytes) >> 11) + 1)
}
