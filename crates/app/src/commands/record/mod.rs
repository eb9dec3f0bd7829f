//! `mirrorball record`: what the devices of a robot measure, as a recording folder or a log, before anything is calibrated.

mod counts;
mod folder;
mod log;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use hw::{BaseDriver, DeviceEvent, Devices, EventQueue, HardwareConfig};
use localize::Field;
use localize::robot::RobotConfig;
use pipeline::log::{Header, LogConfig};
use pipeline::partial_folder::PartialFolder;
use serde::Serialize;
use vision::GroundMap;

use crate::closed_terminal::is_stdout_hung_up;
use crate::commands::arguments;
use crate::run::command_arbiter::CommandArbiter;
use crate::run::robot_folder::RobotPaths;
use crate::run::status::state_name;
use crate::run::stop_flag::StopFlag;
use crate::run::teleop;
use counts::Counts;
use folder::FolderRecorder;
use log::LogRecorder;

/// Record the devices of a robot as a recording folder or a log, until SIGTERM or Ctrl-C. Nothing needs to be calibrated.
///
/// Needs robot.toml with `field` and the image's size ([camera] width_px, height_px), and hardware.toml. A folder gets its
/// name when it is complete. A log is there from the start, and survives a killed process and a full disk.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball record --robot my_robot --teleop --out drive\n\
    Then: mirrorball calibrate rim drive, calibrate lines, wheels, imu, latency"
)]
pub(crate) struct Args {
    /// The robot: a folder with robot.toml and hardware.toml.
    #[arg(long, value_name = "DIR")]
    robot: PathBuf,
    /// The recording folder to write, or the log if the name ends with .mcap.
    #[arg(long, value_name = "DIR|LOG.mcap")]
    out: PathBuf,
    /// End after this time.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Drive by hand with the keyboard or a game pad.
    #[arg(long)]
    teleop: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    #[serde(flatten)]
    counts: Counts,
    out: PathBuf,
    /// The files of a log: more than one if the disk was full. Empty for a folder.
    files: Vec<PathBuf>,
}

const EVENT_QUEUE_CAPACITY: usize = 1024;
const EVENT_TIMEOUT: Duration = Duration::from_millis(20);
const STOP_TIMEOUT: Duration = Duration::from_millis(300);

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    let RobotPaths { folder, robot_file } = RobotPaths::resolve(&args.robot)?;
    let robot = RobotConfig::load(&robot_file)?;
    let wheels = robot.base.clone().unwrap_or_default();
    let hardware = HardwareConfig::load_for_wheels(&folder.join("hardware.toml"), &wheels)?;
    let stop = StopFlag::on_signals()?;
    let recorded = if is_log(&args.out) {
        record_log(args, &robot, &hardware, &stop)
    } else {
        record_folder(args, &robot, &hardware, &stop)
    };
    let outcome = recorded?;
    if is_stdout_hung_up() {
        // The closed terminal has ended the recording.
        return Ok(());
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        let counts = &outcome.counts;
        println!(
            "{}: {} images ({} dropped), {} wheel samples, {} inertial readings, {} headings",
            outcome.out.display(),
            counts.frames,
            counts.images_dropped,
            counts.odometry,
            counts.imu,
            counts.compass
        );
    }
    Ok(())
}

fn is_log(out: &Path) -> bool {
    out.extension().is_some_and(|ending| ending == "mcap")
}

fn record_folder(
    args: &Args,
    robot: &RobotConfig,
    hardware: &HardwareConfig,
    stop: &StopFlag,
) -> Result<Outcome> {
    let partial = PartialFolder::create(&args.out)?;
    header("record", robot)?.write_files(partial.path())?;
    let mut recorder = FolderRecorder::start(partial.path())?;
    let recorded = record(args, robot, hardware, stop, |event| {
        if let DeviceEvent::Health(health) = &event {
            stderr_line!("{}", health_text(health));
        }
        recorder.write(event)
    });
    let (counts, written) = recorder.finish();
    // The thread that writes images knows the reason.
    let outcome = written.and(recorded);
    if counts.frames == 0 {
        outcome?;
        bail!(no_image(args));
    }
    partial.finish()?;
    outcome.with_context(|| {
        format!(
            "{}: the recording ended early, with {} images",
            args.out.display(),
            counts.frames
        )
    })?;
    Ok(Outcome {
        counts,
        out: args.out.clone(),
        files: Vec::new(),
    })
}

fn record_log(
    args: &Args,
    robot: &RobotConfig,
    hardware: &HardwareConfig,
    stop: &StopFlag,
) -> Result<Outcome> {
    let source = format!("record {}", args.robot.display());
    let field = Field::load(&robot.field)?;
    let mut recorder = LogRecorder::start(&args.out, header(&source, robot)?, &field)?;
    let recorded = record(args, robot, hardware, stop, |event| {
        if let DeviceEvent::Health(health) = &event {
            let text = health_text(health);
            stderr_line!("{text}");
            recorder.write_note(&text);
        }
        recorder.write(event);
        Ok(())
    });
    let (counts, files) = match recorder.finish() {
        Ok(finished) => finished,
        // The first error is the reason.
        Err(loss) => return recorded.and(Err(loss)),
    };
    if counts.frames == 0 {
        for file in &files {
            // It is this command's own, and holds no image. The failure below is reported.
            let _gone = std::fs::remove_file(file);
        }
        recorded?;
        bail!(no_image(args));
    }
    recorded?;
    Ok(Outcome {
        counts,
        out: args.out.clone(),
        files,
    })
}

fn no_image(args: &Args) -> String {
    let robot = args.robot.display();
    format!("no image was recorded (devices: `mirrorball doctor --robot {robot}`)")
}

fn health_text(health: &hw::HealthReport) -> String {
    let state = state_name(health.state);
    let reason = health.reason.as_deref().unwrap_or_default();
    format!("{}: {state} {reason}", health.device)
}

fn record(
    args: &Args,
    robot: &RobotConfig,
    hardware: &HardwareConfig,
    stop: &StopFlag,
    mut write: impl FnMut(DeviceEvent) -> Result<()>,
) -> Result<()> {
    let events = EventQueue::new(EVENT_QUEUE_CAPACITY);
    let devices = Devices::start(hardware, robot, LogConfig::default().queue_images, &events)?;
    let arbiter = CommandArbiter::new();
    arbiter.attach_base(devices.base.as_ref().map(BaseDriver::handle));
    let teleop_thread = args.teleop.then(|| {
        let (arbiter, stop) = (arbiter.clone(), stop.clone());
        stderr_line!("{}", teleop::HELP);
        std::thread::spawn(move || {
            if let Err(error) = teleop::drive(&arbiter, &stop) {
                stderr_line!("mirrorball: {error:#}");
                stop.raise();
            }
        })
    });
    let started = hw::now();
    let duration = args.duration.unwrap_or(f64::INFINITY);
    let mut written = Ok(());
    while written.is_ok() && !stop.is_raised() && hw::now() - started < duration {
        if let Some(event) = events.pop_timeout(EVENT_TIMEOUT) {
            written = write(event);
        }
    }
    // The wheels stop first, whatever happened to the disk.
    arbiter.close(STOP_TIMEOUT);
    stop.raise();
    drop(devices);
    if let Some(thread) = teleop_thread {
        // A panic has been reported, and the wheels have stopped.
        let _ended = thread.join();
    }
    written
}

/// robot.toml, field.toml and what they name, as a log stores them.
pub(super) fn header(source: &str, robot: &RobotConfig) -> Result<Header> {
    let map = match (&robot.map, &robot.camera) {
        (Some(map), Some(camera)) => Some(GroundMap::load_for_camera(
            &map.file,
            [camera.width_px, camera.height_px],
        )?),
        _ => None,
    };
    Header::new(source, None).with_robot(robot, map.as_ref(), None)
}
