//! `mirrorball run`: the program on the robot. Devices in, poses out, in real time; device failures do not end it.

mod arguments;
pub(crate) mod command_arbiter;
mod exposure_control;
mod field_half;
pub(crate) mod latency;
pub(crate) mod log_rotation;
pub(crate) mod network;
pub(crate) mod patrol;
#[cfg(feature = "ros2")]
mod pose_reset;
mod pose_writer;
pub(crate) mod raw_image;
mod repeated_lines;
mod replay_start;
pub(crate) mod robot_folder;
mod run_loop;
mod setup_watch;
pub(crate) mod status;
pub(crate) mod stderr_writer;
pub(crate) mod stop_flag;
pub(crate) mod teleop;
pub(crate) mod tuning;
mod unused_images;
mod wake_probe;

use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;
use vision::output_file::ensure_can_create;

use crate::closed_terminal::is_stdout_hung_up;
use crate::commands::arguments::{UsageError, ensure_distinct_outputs};
use crate::commands::inputs::Inputs;
#[cfg(feature = "view")]
use crate::view::{self, AfterRun};
use patrol::Patrol;
#[cfg(feature = "view")]
use pipeline::PipelineConfig;
use pipeline::feed::Feed;

use robot_folder::RobotFolder;
use run_loop::RunLoop;
use stop_flag::StopFlag;

pub(crate) use arguments::Args;

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    if args.list {
        return list(json);
    }
    let Some(robot) = &args.robot else {
        return Err(UsageError("missing argument: --robot DIR".to_owned()).into());
    };
    let outputs = [
        args.record.as_deref(),
        args.out.as_deref(),
        args.save_map.as_deref(),
    ];
    ensure_distinct_outputs(outputs)?;
    let inputs = Inputs::of([&**robot])
        .with_file(args.network.as_deref(), "")
        .with_file(args.patrol.as_deref(), "")
        .with_file(args.config.as_deref(), "");
    inputs.ensure_kept([args.record.as_deref(), args.out.as_deref()])?;
    // What was learned about a map may replace it.
    inputs
        .without("map")
        .ensure_kept([args.save_map.as_deref()])?;
    if let Some(path) = &args.save_map {
        // The map is written when the run ends.
        ensure_can_create(path).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let patrol = args.patrol.as_deref().map(Patrol::load).transpose()?;
    let robot = RobotFolder::load(robot)?;
    let stop = StopFlag::on_signals()?;
    #[cfg(feature = "view")]
    if args.view {
        let setup = RobotFolder::load(&robot.folder)?.setup;
        let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
        let name = format!("run {}", robot.folder.display());
        let play = |feed| run_robot(args, robot, patrol, feed, &stop, json);
        return view::run_with_window(&name, (setup, config), AfterRun::Close, play);
    }
    run_robot(args, robot, patrol, Feed::new(), &stop, json)
}

/// Runs the robot until the end and prints the report.
fn run_robot(
    args: &Args,
    robot: RobotFolder,
    patrol: Option<Patrol>,
    feed: Feed,
    stop: &StopFlag,
    json: bool,
) -> Result<()> {
    let report = RunLoop::new(args, robot, patrol, feed)?.run(stop)?;
    // A closed terminal has ended the run, and nobody reads its report.
    match (is_stdout_hung_up(), json) {
        (true, _) => {}
        (false, true) => println!("{}", serde_json::to_string(&report)?),
        (false, false) => report.print(),
    }
    ensure!(
        report.outputs_lost.is_empty(),
        "{}",
        report.outputs_lost.join("; ")
    );
    // Without a given duration the run waits for its devices until it is stopped.
    if args.duration.is_some()
        && let Some(devices) = report.silent_devices()
        && let Some(robot) = &args.robot
    {
        bail!(
            "no device delivered anything in {:.1} s ({devices}). `mirrorball doctor --robot {}` names the remedy",
            report.seconds,
            robot.display()
        );
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
    let devices = hw::list_devices().into_iter().map(|device| ListedDevice {
        name: device.name,
        usable: device.description.is_ok(),
        what: device.description.unwrap_or_else(|error| error.to_string()),
    });
    let devices: Vec<ListedDevice> = devices.collect();
    if json {
        println!("{}", serde_json::json!({ "devices": devices }));
        return Ok(());
    }
    if devices.is_empty() {
        println!("no device found (expected cameras, serial ports or CAN interfaces)");
    }
    for device in devices {
        println!("{}\n    {}", device.name, device.what);
    }
    Ok(())
}
