//! What does `mirrorball run` take? Its arguments.

use std::net::SocketAddr;
use std::path::PathBuf;

use pipeline::log::ImageCompression;

use crate::commands::arguments;

/// Run on the robot: devices in, poses out, until SIGTERM or Ctrl-C. The wheels stop first.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball run --robot config/robots/virtual --record game.mcap\n\
    Devices may be plugged in and out while it runs. `mirrorball doctor` reports what is missing."
)]
pub(crate) struct Args {
    /// The robot: a folder with robot.toml and hardware.toml.
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    pub(super) robot: Option<PathBuf>,
    /// List the devices of this machine that hardware.toml can name, and exit.
    #[arg(long)]
    pub(super) list: bool,
    /// Record everything into a log (MCAP). A full disk ends the log, not the run; a new log starts when there is space.
    #[arg(long, value_name = "LOG")]
    pub(super) record: Option<PathBuf>,
    /// Image format of the log: png keeps RGB and Bayer images exactly, and takes more time.
    #[arg(long, value_parser = arguments::image_mode(), default_value = ImageCompression::Jpeg.name(), requires = "record")]
    pub(super) images: ImageCompression,
    /// Write the estimated poses in the format of `locate`; stamps are CLOCK_MONOTONIC.
    #[arg(long, value_name = "FILE.csv")]
    pub(super) out: Option<PathBuf>,
    /// Write the ground map with what was learned about its errors (npz) when the run ends.
    #[arg(long, value_name = "MAP.npz")]
    pub(super) save_map: Option<PathBuf>,
    /// Stream the log's topics live to Foxglove, Lichtblick and `mirrorball view` (default: 127.0.0.1:8765).
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    pub(super) live: Option<SocketAddr>,
    /// State output, commands and team messages by UDP (docs/network.md) [default: network.toml in the robot's folder].
    #[cfg_attr(
        feature = "ros2",
        doc = "A node of ROS 2 by its section [ros2] (docs/ros.md)."
    )]
    #[arg(long, value_name = "FILE.toml")]
    pub(super) network: Option<PathBuf>,
    /// End after this time.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration, allow_negative_numbers = true)]
    pub(super) duration: Option<f64>,
    /// Drive by hand with the keyboard or a game pad.
    #[arg(long, conflicts_with = "patrol")]
    pub(super) teleop: bool,
    /// Follow the waypoints of a file (TOML: waypoints, speed, turn_rate_deg) by the estimated pose.
    #[arg(long, value_name = "FILE.toml")]
    pub(super) patrol: Option<PathBuf>,
    /// Show the run in a window; closing the window does not end the run.
    #[cfg(feature = "view")]
    #[arg(long)]
    pub(super) view: bool,
    /// Real-time priority, 1 to 99, and all memory locked; 0 for none [default: 1 where the system permits it, memory not
    /// locked].
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(i32).range(0..=99))]
    pub(super) realtime: Option<i32>,
    /// Localization method: the default, or that of a paper (lima2001, minho2016, nubot2013).
    #[arg(long, value_name = "NAME", value_parser = localize::presets::PRESETS, default_value = "default")]
    pub(super) preset: String,
    /// Override settings of vision and localization by a TOML file.
    #[arg(long, value_name = "FILE.toml")]
    pub(super) config: Option<PathBuf>,
}
