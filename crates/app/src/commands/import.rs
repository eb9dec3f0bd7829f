//! `mirrorball import`: the images and motion of a ROS bag as a recording folder, by the Python package.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use localize::robot::RobotConfig;
use pipeline::partial_folder::PartialFolder;
use pyo3::prelude::*;
use serde::Serialize;

use super::arguments::{self, UsageError};
use super::record;
use crate::python;
use crate::run::robot_folder::RobotPaths;

/// Convert a ROS bag to a recording folder: images, odometry, inertial unit, compass. ROS is not needed.
///
/// Reads ROS 1 bags (.bag) and ROS 2 bags (.mcap, .db3, or their folder). A topic is found by its type, unless it is named.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball import drive.bag --list\n         \
                  mirrorball import drive.bag drive/ --image /omni/image_raw --robot my_robot\n\
                  An empty name (--imu '') leaves a topic out.")]
pub(crate) struct Args {
    /// The bag.
    bag: PathBuf,
    /// The recording folder to write.
    #[arg(required_unless_present = "list", conflicts_with = "list")]
    folder: Option<PathBuf>,
    /// List the topics of the bag.
    #[arg(long)]
    list: bool,
    /// Robot whose robot.toml, field, and mirror or map go to the folder. Otherwise write robot.toml yourself.
    #[arg(long, value_name = "DIR")]
    robot: Option<PathBuf>,
    /// Image topic: sensor_msgs/Image or CompressedImage.
    #[arg(long, value_name = "TOPIC")]
    image: Option<String>,
    /// Odometry topic: nav_msgs/Odometry.
    #[arg(long, value_name = "TOPIC")]
    odometry: Option<String>,
    /// Topic of the inertial unit: sensor_msgs/Imu.
    #[arg(long, value_name = "TOPIC")]
    imu: Option<String>,
    /// Compass topic: sensor_msgs/MagneticField; or a heading, radians counter-clockwise, as Float64, Float32, Imu or
    /// QuaternionStamped.
    #[arg(long, value_name = "TOPIC")]
    compass: Option<String>,
    /// True poses on the field, for scoring: PoseStamped, PoseWithCovarianceStamped or Odometry.
    #[arg(long, value_name = "TOPIC")]
    truth: Option<String>,
    /// The robot's frame, to which /tf_static turns inertial unit and compass (default: that of the odometry).
    #[arg(long, value_name = "FRAME")]
    base: Option<String>,
    /// Begin this time after the bag's start.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration)]
    from: Option<f64>,
    /// End this time after the bag's start.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration)]
    to: Option<f64>,
    /// Python interpreter or folder of a virtual environment (default: $VIRTUAL_ENV, else the build's).
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
}

/// Options of `mirrorball.bags.command.import_folder`.
#[derive(Serialize)]
struct Options<'a> {
    selection: Selection<'a>,
    start_s: Option<f64>,
    stop_s: Option<f64>,
    base_frame: Option<&'a str>,
}

#[derive(Serialize)]
struct Selection<'a> {
    image: Option<&'a str>,
    odometry: Option<&'a str>,
    imu: Option<&'a str>,
    compass: Option<&'a str>,
    truth: Option<&'a str>,
}

impl Args {
    fn options(&self) -> Options<'_> {
        Options {
            selection: Selection {
                image: self.image.as_deref(),
                odometry: self.odometry.as_deref(),
                imu: self.imu.as_deref(),
                compass: self.compass.as_deref(),
                truth: self.truth.as_deref(),
            },
            start_s: self.from,
            stop_s: self.to,
            base_frame: self.base.as_deref(),
        }
    }
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    if let (Some(from), Some(to)) = (args.from, args.to)
        && from >= to
    {
        return Err(
            UsageError(format!("--from {from} --to {to}: an empty part of the bag")).into(),
        );
    }
    let Some(folder) = &args.folder else {
        let text = call_python(args, |commands| {
            commands
                .call_method1("topic_list", (args.bag.as_os_str(), json))?
                .extract::<String>()
        })?;
        println!("{text}");
        return Ok(());
    };
    let partial = PartialFolder::create(folder)?;
    if let Some(robot) = &args.robot {
        write_robot_files(robot, partial.path())?;
    }
    let options = serde_json::to_string(&args.options())?;
    let (text, warnings) = call_python(args, |commands| {
        let (bag, folder) = (args.bag.as_os_str(), partial.path().as_os_str());
        let arguments = (bag, folder, options, json);
        commands
            .call_method1("import_folder", arguments)?
            .extract::<(String, Vec<String>)>()
    })?;
    partial.finish()?;
    println!("{text}");
    for warning in &warnings {
        stderr_line!("warning: {warning}");
    }
    if args.robot.is_none() {
        stderr_line!(
            "{}: robot.toml and field.toml are still missing: import with --robot DIR, or copy those of samples/sequence and change them",
            folder.display()
        );
    }
    Ok(())
}

/// robot.toml and the files that it names, under their names in a recording folder.
fn write_robot_files(robot: &Path, folder: &Path) -> Result<()> {
    let RobotPaths { robot_file, .. } = RobotPaths::resolve(robot)?;
    let config = RobotConfig::load(&robot_file)?;
    record::header("import", &config)
        .with_context(|| format!("--robot {}", robot.display()))?
        .write_files(folder)
}

fn call_python<T>(args: &Args, call: impl FnOnce(Bound<'_, PyModule>) -> PyResult<T>) -> Result<T> {
    python::start(args.python.as_deref())?;
    let outcome = Python::attach(|py| {
        py.import("mirrorball.bags.command")
            .and_then(call)
            .map_err(|error| python::explain_error(py, &error))
    });
    python::finish();
    outcome
}
