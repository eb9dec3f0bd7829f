//! How is a run connected to the network? network.toml, with remote commands passed to the arbiter.

use std::path::Path;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, ensure};
use hw::base::{CommandTally, Kick, MotionCommand};
use localize::omni::Twist;
use localize::team::TeamReport;

use super::command_arbiter::{CommandArbiter, CommandError, CommandSource};
use super::tuning::TuningHandle;
use crate::net::commands::CommandCounts;
use crate::net::{Network, NetworkConfig, RemoteCommand, TeamTransport};
#[cfg(feature = "ros2")]
use crate::ros2::{NodeContext, RosNode};
use crate::stream::{StreamConfig, StreamPreamble};
#[cfg(feature = "ros2")]
use localize::Stamp;
use pipeline::datagram::{TeamClock, TeamLinkCounts};
use pipeline::feed::Feed;

/// The network configuration in the robot's folder.
pub(crate) const NETWORK_FILE: &str = "network.toml";

/// The network threads of a run. Dropping it ends them.
pub(super) struct RunNetwork {
    network: Network,
    #[cfg(feature = "ros2")]
    node: Option<RosNode>,
}

/// Reads the network configuration: `file`, else the robot's own network.toml, else an empty one.
///
/// `live`: address of the live stream, overrides the file's. `number`: the setting `team.number`, by which the robot
/// recognises its own messages; `[team] robot` must be equal.
pub(super) fn load_config(
    file: Option<&Path>,
    robot: &Path,
    live: Option<std::net::SocketAddr>,
    number: u32,
) -> Result<NetworkConfig> {
    let default_file = robot.join(NETWORK_FILE);
    let file = file.or_else(|| default_file.exists().then_some(&default_file));
    let mut config = file.map_or_else(|| Ok(NetworkConfig::default()), NetworkConfig::load)?;
    if let (Some(team), Some(file)) = (&config.team, file) {
        ensure!(
            team.robot == number,
            "{}: [team] robot = {} differs from the setting team.number = {number}. Both are this robot's number: make them equal",
            file.display(),
            team.robot
        );
    }
    #[cfg(not(feature = "ros2"))]
    ensure!(
        config.ros2.is_none(),
        "[ros2] in {}: this build has no node of ROS 2. Use the tarball mirrorball-ros2, or build with --features ros2",
        file.map_or_else(String::new, |file| file.display().to_string())
    );
    if let Some(address) = live {
        config.stream = Some(StreamConfig {
            bind: address.ip().to_string(),
            port: address.port(),
            ..config.stream.unwrap_or_default()
        });
    }
    Ok(config)
}

impl RunNetwork {
    /// Starts the configured threads: they send the cycles of `feed` and pass commands to `arbiter`.
    pub(super) fn start(
        config: &NetworkConfig,
        feed: &Feed,
        preamble: StreamPreamble<'_>,
        tuning: Option<TuningHandle>,
        arbiter: &CommandArbiter,
    ) -> Result<Self> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let session = since.map_or(0, |since| since.as_nanos() as u64);
        let (commanded, observed) = (arbiter.clone(), arbiter.clone());
        let execute = move |command: RemoteCommand| execute_command(&commanded, command).is_ok();
        let obstacle = Arc::new(move || observed.obstacle_to_programs());
        let commands = (execute, obstacle as _);
        let network = config.start(feed, (preamble, tuning), session, hw::now, commands)?;
        Ok(RunNetwork {
            network,
            #[cfg(feature = "ros2")]
            node: None,
        })
    }

    /// Starts the node of ROS 2, if it is configured.
    #[cfg(feature = "ros2")]
    pub(super) fn start_node(
        &mut self,
        config: &NetworkConfig,
        feed: &Feed,
        context: &NodeContext<'_>,
        arbiter: &CommandArbiter,
    ) -> Result<()> {
        let Some(ros2) = &config.ros2 else {
            return Ok(());
        };
        let arbiter = arbiter.clone();
        let drive = move |twist: Twist, deadline: Stamp| {
            let motion = MotionCommand::Twist(twist);
            let source = CommandSource::Program;
            arbiter.drive(source, motion, deadline, false).is_ok()
        };
        self.node = Some(RosNode::start(ros2, feed, context, Box::new(drive))?);
        Ok(())
    }

    /// The node of ROS 2.
    #[cfg(feature = "ros2")]
    pub(super) fn node(&self) -> Option<&RosNode> {
        self.node.as_ref()
    }

    /// Reports of team-mates received since the last call.
    pub(super) fn team_reports(&self) -> impl Iterator<Item = TeamReport> {
        self.network
            .team
            .iter()
            .flat_map(TeamTransport::received_reports)
    }

    /// The clocks of the team-mates. None if there is no team.
    pub(super) fn team_clocks(&self) -> Option<Vec<TeamClock>> {
        self.network
            .team
            .as_ref()
            .map(|team| team.clocks(hw::now()))
    }

    /// Counts of team messages. None if there is no team.
    pub(super) fn team_counts(&self) -> Option<TeamLinkCounts> {
        self.network.team.as_ref().map(TeamTransport::counts)
    }

    /// Counts of remote commands. None if remote commands are not configured.
    ///
    /// `tally`: what the base took of them.
    pub(super) fn command_counts(&self, tally: &CommandTally) -> Option<CommandCounts> {
        let commands = self.network.commands.as_ref()?;
        Some(CommandCounts {
            sent: tally.sent(),
            obeyed: tally.confirmed(),
            ..commands.counts()
        })
    }

    /// Messages for the operator since the last call.
    pub(super) fn take_notices(&self) -> Vec<String> {
        let commands = self.network.commands.iter();
        let outputs = self.network.state_sender.iter();
        let stream = self.network.stream.iter();
        let team = self.network.team.iter();
        let notices = commands
            .flat_map(|commands| commands.take_notices())
            .chain(outputs.flat_map(|outputs| outputs.take_notices()))
            .chain(team.flat_map(|team| team.take_notices()))
            .chain(stream.flat_map(|stream| stream.take_notices()));
        #[cfg(feature = "ros2")]
        let notices = notices.chain(self.node.iter().flat_map(RosNode::take_notices));
        notices.collect()
    }
}

/// Executes another program's command until its deadline.
fn execute_command(arbiter: &CommandArbiter, command: RemoteCommand) -> Result<(), CommandError> {
    let deadline = command.deadline;
    if let Some(kick) = command.kick {
        let kick = Kick {
            speed: kick.speed,
            lofted: kick.lofted,
        };
        arbiter.kick(CommandSource::Program, kick, deadline)?;
    }
    if let Some(drive) = command.drive {
        let twist = Twist {
            x: drive.x,
            y: drive.y,
            theta: drive.theta,
        };
        let motion = MotionCommand::Twist(twist);
        arbiter.drive(CommandSource::Program, motion, deadline, command.needs_pose)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conflicting_robot_numbers_are_rejected_with_file_and_values() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join(NETWORK_FILE);
        std::fs::write(&file, "[team]\nrobot = 3\n").expect("written");
        let config = load_config(None, folder.path(), None, 3).expect("one number");
        assert_eq!(config.team.map(|team| team.robot), Some(3));
        let error = load_config(None, folder.path(), None, 1).expect_err("two numbers");
        let message = error.to_string();
        assert!(message.contains(&file.display().to_string()), "{message}");
        assert!(
            message.contains("robot = 3") && message.contains("team.number = 1"),
            "{message}"
        );
        // Without a team any number is accepted.
        std::fs::write(&file, "").expect("written");
        assert!(load_config(None, folder.path(), None, 7).is_ok());
    }
}
