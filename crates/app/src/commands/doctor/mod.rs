//! `mirrorball doctor`: what prevents this robot from running, or this recording from being located, and what is the
//! remedy?

mod finding;
mod machine;
mod recording;
mod robot;

use std::path::PathBuf;

use anyhow::{Result, bail};
use finding::Severity;

/// Check a robot and its machine: configuration, devices, permissions, disk, clock, Python. Exits 1 if something must be done.
///
/// With --recording, check instead whether another field, camera mount or unit explains a recording better.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball doctor --robot config/robots/virtual\n         mirrorball doctor --recording samples/sequence"
)]
pub(crate) struct Args {
    /// The robot: a folder with robot.toml and hardware.toml; without it only the machine is checked.
    #[arg(long, value_name = "DIR")]
    robot: Option<PathBuf>,
    /// A recording folder or a log: try other set-ups on it and print which explain it better, with the edit to make.
    #[arg(long, value_name = "DIR|LOG", conflicts_with = "robot")]
    recording: Option<PathBuf>,
    /// With --recording: calibrated map (npz) in place of the robot's own.
    #[arg(long, value_name = "MAP.npz", requires = "recording")]
    map: Option<PathBuf>,
    /// Folder of the logs.
    #[arg(long, value_name = "DIR", default_value = ".")]
    logs: PathBuf,
    /// Seconds to listen to the devices.
    #[arg(long, value_name = "SECONDS", value_parser = crate::commands::arguments::parse_duration, default_value = "2")]
    listen: f64,
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    if let Some(folder) = &args.recording {
        return recording::run(folder, args.map.as_deref(), json);
    }
    let mut findings = machine::check_machine(&args.logs);
    if let Some(robot) = &args.robot {
        findings.extend(robot::check_robot(robot, args.listen));
    }
    let bad = findings
        .iter()
        .filter(|finding| finding.verdict == Severity::Bad)
        .count();
    if json {
        println!(
            "{}",
            serde_json::json!({ "findings": findings, "bad": bad })
        );
    } else {
        for finding in &findings {
            let mark = match finding.verdict {
                Severity::Fine => "ok  ",
                Severity::Note => "note",
                Severity::Bad => "BAD ",
            };
            println!("{mark} {}: {}", finding.what, finding.found);
            if !finding.remedy.is_empty() {
                println!("       -> {}", finding.remedy);
            }
        }
    }
    match bad {
        0 => Ok(()),
        1 => bail!("one problem keeps the robot from running"),
        count => bail!("{count} problems keep the robot from running"),
    }
}
