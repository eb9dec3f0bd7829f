//! `mirrorball record`: what the devices of a robot measure, as a recording folder, before anything is calibrated.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, ensure};
use hw::camera::CapturedImage;
use hw::{BaseDriver, DeviceEvent, Devices, EventQueue, HardwareConfig};
use localize::robot::RobotConfig;
use localize::sample::Compass;
use pipeline::csv_table::{CsvWriter, format_seconds};
use pipeline::log::Header;
use pipeline::partial_folder::PartialFolder;
use pipeline::recording::IMU_COLUMNS;
use pipeline::sample::SourceImage;
use serde::Serialize;
use vision::GroundMap;

use crate::commands::arguments;
use crate::run::command_arbiter::CommandArbiter;
use crate::run::raw_image::raw_image;
use crate::run::robot_folder::RobotPaths;
use crate::run::status::state_name;
use crate::run::stop_flag::StopFlag;
use crate::run::teleop;

/// Record the devices of a robot as a recording folder, until SIGTERM or Ctrl-C. Nothing needs to be calibrated.
///
/// Needs robot.toml with `field` and the image's size ([camera] width_px, height_px), and hardware.toml. The folder gets
/// its name when it is complete.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball record --robot my_robot --teleop --out drive\n\
    Then: mirrorball calibrate rim drive, calibrate lines, wheels, imu, latency"
)]
pub(crate) struct Args {
    /// The robot: a folder with robot.toml and hardware.toml.
    #[arg(long, value_name = "DIR")]
    robot: PathBuf,
    /// The recording folder to write.
    #[arg(long, value_name = "DIR")]
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
    frames: u64,
    /// Images that came faster than they could be written.
    images_dropped: u64,
    odometry: u64,
    imu: u64,
    compass: u64,
    out: PathBuf,
}

const EVENT_QUEUE_CAPACITY: usize = 1024;
const EVENT_TIMEOUT: Duration = Duration::from_millis(20);
const STOP_TIMEOUT: Duration = Duration::from_millis(300);
/// Images that wait for the disk: a second.
const IMAGE_QUEUE_CAPACITY: usize = 30;

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    let RobotPaths { folder, robot_file } = RobotPaths::resolve(&args.robot)?;
    let robot = RobotConfig::load(&robot_file)?;
    let hardware = HardwareConfig::load(&folder.join("hardware.toml"))?;
    let stop = StopFlag::on_signals()?;
    let partial = PartialFolder::create(&args.out)?;
    write_robot_files(&robot, partial.path())?;
    let mut recorder = FolderRecorder::start(partial.path())?;
    record(args, &robot, &hardware, &stop, &mut recorder)?;
    let counts = recorder.finish()?;
    ensure!(
        counts.frames > 0,
        "no image was recorded (devices: `mirrorball doctor --robot {}`)",
        args.robot.display()
    );
    partial.finish()?;
    let outcome = Outcome {
        out: args.out.clone(),
        ..counts
    };
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        println!(
            "{}: {} images ({} dropped), {} wheel samples, {} inertial readings, {} headings",
            outcome.out.display(),
            outcome.frames,
            outcome.images_dropped,
            outcome.odometry,
            outcome.imu,
            outcome.compass
        );
    }
    Ok(())
}

fn record(
    args: &Args,
    robot: &RobotConfig,
    hardware: &HardwareConfig,
    stop: &StopFlag,
    recorder: &mut FolderRecorder,
) -> Result<()> {
    let events = EventQueue::new(EVENT_QUEUE_CAPACITY);
    let devices = Devices::start(hardware, robot, &events)?;
    let arbiter = CommandArbiter::new();
    arbiter.attach_base(devices.base.as_ref().map(BaseDriver::handle));
    let teleop_thread = args.teleop.then(|| {
        let (arbiter, stop) = (arbiter.clone(), stop.clone());
        eprintln!("{}", teleop::HELP);
        std::thread::spawn(move || {
            if let Err(error) = teleop::drive(&arbiter, &stop) {
                eprintln!("mirrorball: {error:#}");
                stop.raise();
            }
        })
    });
    let started = hw::now();
    let duration = args.duration.unwrap_or(f64::INFINITY);
    let mut written = Ok(());
    while written.is_ok() && !stop.is_raised() && hw::now() - started < duration {
        if let Some(event) = events.pop_timeout(EVENT_TIMEOUT) {
            written = recorder.write(event);
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
fn write_robot_files(robot: &RobotConfig, folder: &Path) -> Result<()> {
    let map = match (&robot.map, &robot.camera) {
        (Some(map), Some(camera)) => Some(GroundMap::load_for_camera(
            &map.file,
            [camera.width_px, camera.height_px],
        )?),
        _ => None,
    };
    Header::new("record", None)
        .with_robot(robot, map.as_ref(), None)?
        .write_files(folder)
}

/// The tables of the folder, and the thread that writes its images.
struct FolderRecorder {
    folder: PathBuf,
    odometry: Table,
    imu: Table,
    compass: Table,
    magnetometer: Table,
    images: SyncSender<CapturedImage>,
    image_thread: JoinHandle<Result<u64>>,
    images_dropped: u64,
}

/// A table and its number of rows.
struct Table {
    path: PathBuf,
    file: CsvWriter,
    rows: u64,
}

impl Table {
    fn create(folder: &Path, name: &str, columns: &str) -> Result<Self> {
        let path = folder.join(name);
        Ok(Table {
            file: CsvWriter::create(&path, columns)?,
            path,
            rows: 0,
        })
    }

    fn write_row(&mut self, row: std::fmt::Arguments<'_>) -> Result<()> {
        self.rows += 1;
        self.file.write_row(row)
    }

    /// Completes the table; an empty one is removed.
    fn finish(self) -> Result<u64> {
        self.file.finish()?;
        if self.rows == 0 {
            std::fs::remove_file(&self.path)?;
        }
        Ok(self.rows)
    }
}

impl FolderRecorder {
    fn start(folder: &Path) -> Result<Self> {
        let frames = folder.join("frames");
        std::fs::create_dir(&frames)
            .with_context(|| format!("cannot write {}", frames.display()))?;
        let (images, queue) = sync_channel(IMAGE_QUEUE_CAPACITY);
        let images_folder = folder.to_owned();
        let image_thread = std::thread::Builder::new()
            .name("images".to_owned())
            .spawn(move || write_images(&images_folder, &queue))?;
        let table = |name: &str, columns: &str| Table::create(folder, name, columns);
        Ok(FolderRecorder {
            odometry: table("odometry.csv", "stamp_s,dx_m,dy_m,dtheta_rad")?,
            imu: table("imu.csv", &format!("stamp_s,{}", IMU_COLUMNS.join(",")))?,
            compass: table("compass.csv", "stamp_s,heading_rad")?,
            magnetometer: table("magnetometer.csv", "stamp_s,x,y")?,
            folder: folder.to_owned(),
            images,
            image_thread,
            images_dropped: 0,
        })
    }

    fn write(&mut self, event: DeviceEvent) -> Result<()> {
        match event {
            DeviceEvent::Image(image) => self.write_image(image),
            DeviceEvent::Odometry(sample) => {
                let stamp = format_seconds(sample.stamp);
                let (dx, dy, dtheta) = (sample.dx, sample.dy, sample.dtheta);
                self.odometry
                    .write_row(format_args!("{stamp},{dx},{dy},{dtheta}"))
            }
            DeviceEvent::Imu(sample) => {
                let stamp = format_seconds(sample.stamp);
                let ([ax, ay, az], [wx, wy, wz]) = (sample.specific_force, sample.angular_velocity);
                self.imu
                    .write_row(format_args!("{stamp},{ax},{ay},{az},{wx},{wy},{wz}"))
            }
            DeviceEvent::Compass(sample) => self.write_compass(&sample),
            DeviceEvent::Health(health) => {
                let state = state_name(health.state);
                let reason = health.reason.as_deref().unwrap_or_default();
                eprintln!("{}: {state} {reason}", health.device);
                Ok(())
            }
            DeviceEvent::Command(_)
            | DeviceEvent::Power(_)
            | DeviceEvent::Kicker(_)
            | DeviceEvent::Switches(_) => Ok(()),
        }
    }

    fn write_compass(&mut self, sample: &Compass) -> Result<()> {
        let stamp = format_seconds(sample.stamp);
        self.compass
            .write_row(format_args!("{stamp},{}", sample.heading))?;
        match sample.magnetic_field {
            Some([x, y]) => self.magnetometer.write_row(format_args!("{stamp},{x},{y}")),
            None => Ok(()),
        }
    }

    fn write_image(&mut self, image: CapturedImage) -> Result<()> {
        // An image that the camera repeats shows another time than its stamp.
        if image.repeated {
            return Ok(());
        }
        match self.images.try_send(image) {
            Ok(()) => Ok(()),
            Err(std::sync::mpsc::TrySendError::Full(_)) => {
                self.images_dropped += 1;
                Ok(())
            }
            Err(std::sync::mpsc::TrySendError::Disconnected(_)) => {
                Err(anyhow!("cannot write {}", self.folder.display()))
            }
        }
    }

    fn finish(self) -> Result<Outcome> {
        drop(self.images);
        let frames = self
            .image_thread
            .join()
            .map_err(|_panic| anyhow!("the thread that writes images panicked"))??;
        self.magnetometer.finish()?;
        Ok(Outcome {
            frames,
            images_dropped: self.images_dropped,
            odometry: self.odometry.finish()?,
            imu: self.imu.finish()?,
            compass: self.compass.finish()?,
            out: PathBuf::new(),
        })
    }
}

/// Writes images and frames.csv until the queue ends; returns their number.
fn write_images(folder: &Path, queue: &Receiver<CapturedImage>) -> Result<u64> {
    let mut table = CsvWriter::create(&folder.join("frames.csv"), "stamp_s,file")?;
    let mut frames = 0;
    for image in queue {
        let stamp = format_seconds(image.stamp);
        // An image that the camera cut off is left out.
        let Some(rgb) = SourceImage::Raw(raw_image(image)).to_rgb() else {
            continue;
        };
        let file = format!("frames/{frames:06}.png");
        rgb.save(&folder.join(&file))?;
        table.write_row(format_args!("{stamp},{file}"))?;
        frames += 1;
    }
    table.finish()?;
    Ok(frames)
}
