//! What do other programs and team-mates get to know, and what may they ask? The robot's network.toml, joined with its wheels.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, ensure};
use hw::base::{Kick, MotionCommand};
use localize::omni::Twist;
use localize::team::TeamReport;
use localize::{Field, Stamp};

use super::command_arbiter::{CommandArbiter, CommandError, CommandSource};
use crate::net::commands::CommandCounts;
use crate::net::{Network, NetworkConfig, RemoteCommand};
use crate::stream::StreamConfig;
use pipeline::feed::Feed;
use pipeline::log::Header;

/// The file beside robot.toml that says who is told what, and who may command.
pub const NETWORK_FILE: &str = "network.toml";

/// The network's part of a run; dropping it ends it.
pub(super) struct RunNetwork {
    network: Network,
}

/// What is configured: by a file that was named, else by the robot's own if it has one; else nothing.
///
/// `live`: where the live stream is offered in place of what the file says. `number`: ours by the settings
/// (`team.number`), by which our own words are known when they come back; the team must know us by the same.
pub(super) fn load_config(
    file: Option<&Path>,
    robot: &Path,
    live: Option<std::net::SocketAddr>,
    number: u32,
) -> Result<NetworkConfig> {
    let own = robot.join(NETWORK_FILE);
    let file = file.or_else(|| own.exists().then_some(&own));
    let mut config = file.map_or_else(|| Ok(NetworkConfig::default()), NetworkConfig::load)?;
    if let (Some(team), Some(file)) = (&config.team, file) {
        ensure!(
            team.robot == number,
            "{}: [team] robot = {}, but the settings say team.number = {number}: both are this robot's number",
            file.display(),
            team.robot
        );
    }
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
    /// Starts what is configured: cycles of `feed` go out, commands go to `helm`.
    pub(super) fn start(
        config: &NetworkConfig,
        feed: &Feed,
        about: (&Header, &Field),
        helm: &CommandArbiter,
    ) -> Result<Self> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let session = since.map_or(0, |since| since.as_nanos() as u64);
        let helm = helm.clone();
        // Why not is counted by whoever sent it: the wheels do not turn.
        let obey = move |order: RemoteCommand| execute_command(&helm, order, hw::now()).is_ok();
        let network = config.start(feed, about, session, hw::now, obey)?;
        Ok(RunNetwork { network })
    }

    /// What team-mates said since the last call.
    pub(super) fn team_reports(&self) -> impl Iterator<Item = TeamReport> {
        self.network
            .team
            .iter()
            .flat_map(crate::net::TeamTransport::received_reports)
    }

    /// What became of commands; none if nobody may command.
    pub(super) fn command_counts(&self) -> Option<CommandCounts> {
        self.network
            .commands
            .as_ref()
            .map(|commands| commands.counts())
    }
}

/// Carries out another program's command that came `now`.
fn execute_command(
    helm: &CommandArbiter,
    order: RemoteCommand,
    now: Stamp,
) -> Result<(), CommandError> {
    let deadline = now + order.valid_for.as_secs_f64();
    if let Some(kick) = order.kick {
        let kick = Kick {
            speed: kick.speed,
            lofted: kick.lofted,
        };
        helm.kick(CommandSource::Program, kick, deadline)?;
    }
    if let Some(drive) = order.drive {
        let twist = Twist {
            x: drive.x,
            y: drive.y,
            theta: drive.theta,
        };
        let drive = MotionCommand::Twist(twist);
        helm.drive(CommandSource::Program, drive, deadline, order.needs_pose)?;
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
        let told = error.to_string();
        assert!(told.contains(&file.display().to_string()), "{told}");
        assert!(
            told.contains("robot = 3") && told.contains("team.number = 1"),
            "{told}"
        );
        // Who speaks to no team needs no number.
        std::fs::write(&file, "").expect("written");
        assert!(load_config(None, folder.path(), None, 7).is_ok());
    }
}
