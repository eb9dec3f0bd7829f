//! `mirrorball run`: the robot itself. Devices in, poses out, in real time, whatever breaks meanwhile.

pub mod command_arbiter;
pub mod latency;
pub mod log_rotation;
pub mod network;
pub mod patrol;
pub mod raw_image;
pub mod robot_folder;
mod run_loop;
pub mod status;
pub mod stderr_writer;
pub mod stop_flag;
pub mod teleop;

use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;

use crate::commands::arguments::{self, UsageError};
#[cfg(feature = "view")]
use crate::view::{self, AfterRun};
use patrol::Patrol;
#[cfg(feature = "view")]
use pipeline::PipelineConfig;
use pipeline::feed::Feed;
use pipeline::log::ImageCompression;
use robot_folder::RobotFolder;
use run_loop::RunLoop;
use stop_flag::StopFlag;

pub use command_arbiter::{CommandArbiter, CommandError, CommandSource};

/// Play on the robot: devices in, poses out, until SIGTERM or Ctrl-C; the wheels stop first.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball run --robot config/robots/virtual --record game.mcap\n\
    Devices may come and go while it runs. `mirrorball doctor` says what is missing."
)]
pub struct Args {
    /// The robot: a folder with robot.toml and hardware.toml.
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    robot: Option<PathBuf>,
    /// List the devices of this machine that hardware.toml could name, and end.
    #[arg(long)]
    list: bool,
    /// Record everything into a log (MCAP); a full disk ends the log, not the play, and a new one begins when there is room.
    #[arg(long, value_name = "LOG")]
    record: Option<PathBuf>,
    /// How the log keeps images: png keeps RGB and Bayer cameras' exactly, and takes more time.
    #[arg(long, value_parser = arguments::image_mode(), default_value = ImageCompression::Jpeg.name(), requires = "record")]
    images: ImageCompression,
    /// Write the estimated poses (as `locate` does); stamps are CLOCK_MONOTONIC.
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Offer the log's topics live to Foxglove, Lichtblick and our own view (default: 127.0.0.1:8765).
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    live: Option<SocketAddr>,
    /// Who is told what and who may command, by UDP (docs/network.md); default: network.toml in the robot's folder, if there.
    #[arg(long, value_name = "FILE.toml")]
    network: Option<PathBuf>,
    /// End after so many seconds.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Drive by hand: keys of the terminal, or a game pad.
    #[arg(long, conflicts_with = "patrol")]
    teleop: bool,
    /// Drive along the waypoints of a file (TOML: waypoints, speed, turn_rate_deg), by the estimated pose.
    #[arg(long, value_name = "FILE.toml")]
    patrol: Option<PathBuf>,
    /// Show it in a window of this machine's display; closing the window changes nothing.
    #[cfg(feature = "view")]
    #[arg(long)]
    view: bool,
    /// Run at this real-time priority, 1 to 99, with all memory locked.
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(i32).range(1..=99))]
    realtime: Option<i32>,
    /// Find the place as this paper does: lima2001, minho2016 or nubot2013.
    #[arg(long, value_name = "NAME", value_parser = localize::presets::PRESETS, default_value = "default")]
    preset: String,
    /// Change settings of vision and localisation by a TOML overlay.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    if args.list {
        return list(json);
    }
    let Some(robot) = &args.robot else {
        return Err(UsageError("--robot DIR is wanted".to_owned()).into());
    };
    arguments::ensure_distinct_outputs([args.record.as_deref(), args.out.as_deref()])?;
    let patrol = args.patrol.as_deref().map(Patrol::load).transpose()?;
    let robot = RobotFolder::load(robot)?;
    let stop = StopFlag::on_signals()?;
    #[cfg(feature = "view")]
    if args.view {
        let shown = RobotFolder::load(&robot.folder)?.setup;
        let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
        let name = format!("run {}", robot.folder.display());
        let play = |feed| run_robot(args, robot, patrol, feed, &stop, json);
        return view::run_with_window(&name, (shown, config), AfterRun::Close, play);
    }
    run_robot(args, robot, patrol, Feed::new(), &stop, json)
}

/// Plays until the end and says how it went.
fn run_robot(
    args: &Args,
    robot: RobotFolder,
    patrol: Option<Patrol>,
    feed: Feed,
    stop: &StopFlag,
    json: bool,
) -> Result<()> {
    let report = RunLoop::new(args, robot, patrol, feed)?.run(stop)?;
    if json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        report.print();
    }
    Ok(())
}

/// One device of `--list`.
#[derive(Serialize)]
struct ListedDevice {
    name: String,
    usable: bool,
    what: String,
}

fn list(json: bool) -> Result<()> {
    let found = hw::list_devices().into_iter().map(|found| ListedDevice {
        name: found.name,
        usable: found.description.is_ok(),
        what: found.description.unwrap_or_else(|error| error.to_string()),
    });
    let found: Vec<ListedDevice> = found.collect();
    if json {
        println!("{}", serde_json::json!({ "devices": found }));
        return Ok(());
    }
    if found.is_empty() {
        println!("no camera, serial line or CAN interface was found");
    }
    for device in found {
        println!("{}\n    {}", device.name, device.what);
    }
    Ok(())
}
