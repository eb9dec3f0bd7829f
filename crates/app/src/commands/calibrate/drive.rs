//! What does a drive tell about the robot? Samples of wheels and inertial unit, and poses by the line points alone.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use localize::global_search::branch_and_bound::half_turn;
use localize::robot::RobotConfig;
use localize::sample::{Imu, Odometry};
use localize::sensors::pose_pairs::VisionPose;
use localize::{DistanceField, Pose, Stamp};
use nalgebra::{Matrix3, Vector3};
use pipeline::log::{LogReader, UnpackedSetup};
use pipeline::run::{RecordingOptions, RecordingRun};
use pipeline::sample::{ImageContent, Sample};
use pipeline::setup::Setup;
use pipeline::{Cycle, Pipeline, PipelineConfig};

use crate::commands::arguments::UsageError;
use crate::commands::inputs::Inputs;
use crate::commands::locate::EXTERNAL_POINT_STD;
use crate::interrupt;

/// Where a calibration reads a drive, and where it writes.
#[derive(clap::Args)]
pub(super) struct DriveArgs {
    /// A recording folder or a log.
    #[arg(value_name = "DIR|LOG")]
    pub(super) drive: PathBuf,
    /// File for the calibration (TOML), for `include` of robot.toml.
    #[arg(long, value_name = "FILE.toml")]
    pub(super) out: PathBuf,
}

/// A drive, as its sensors measured it.
pub(super) struct Drive {
    /// The robot, with the calibration that the samples do not contain.
    pub(super) robot: RobotConfig,
    pub(super) odometry: Vec<Odometry>,
    pub(super) imu: Vec<Imu>,
    /// Empty if only the sensors were wanted.
    pub(super) poses: Vec<VisionPose>,
}

/// Largest distance of a pose by the points from the tracked one, metres and radians: another place fits them as well.
const DEVIATION_MAX: (f32, f32) = (0.3, 0.15);
/// Smallest share of the points on markings.
const INLIER_SHARE_MIN: f32 = 0.5;
/// Error of the tracked pose from which a match starts, metres.
const START_ERROR: f32 = 0.1;
/// Longest time between two poses in which no robot turns by a quarter, seconds.
const HALF_GAP_MAX: f64 = 0.3;
/// Parameters that the points must determine: the pose.
const DETERMINED_MIN: f32 = 2.5;

impl DriveArgs {
    /// Reads the drive. `part`: what the calibration is called in robot.toml; an earlier one may be replaced, no other input.
    pub(super) fn load(&self, part: &str) -> Result<Drive> {
        let inputs = Inputs::of([&*self.drive]).without(part);
        inputs.ensure_kept([Some(&*self.out)])?;
        Drive::load(&self.drive)
    }
}

impl Drive {
    /// Reads a drive and the poses of its images.
    fn load(path: &Path) -> Result<Self> {
        interrupt::install_handler()?;
        let drive = if path.is_dir() {
            load_recording(path)?
        } else if path.is_file() {
            load_log(path)?
        } else {
            let place = path.display();
            return Err(UsageError(format!("{place} is neither a folder nor a log")).into());
        };
        ensure!(
            !drive.odometry.is_empty(),
            "{}: no wheel motion (odometry.csv is missing, empty, or left out as a warning says)",
            path.display()
        );
        Ok(drive)
    }
}

fn load_recording(folder: &Path) -> Result<Drive> {
    let config = PipelineConfig::default();
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let mut collector = Collector::new(&setup, &config);
    let run = RecordingRun::open(&RecordingOptions {
        folder: folder.to_owned(),
        map: None,
        save_map: None,
        config,
        external_point_std: EXTERNAL_POINT_STD,
    })?;
    for warning in &run.setup_report().warnings {
        stderr_line!("warning: {warning}");
    }
    let bar = crate::progress::bar(run.frames() as u64, "frames");
    run.run(|cycle| {
        collector.add_cycle(cycle);
        bar.inc(1);
        interrupt::check()
    })?;
    bar.finish_and_clear();
    Ok(collector.finish(setup.robot))
}

fn load_log(path: &Path) -> Result<Drive> {
    let log = LogReader::open(path)?;
    let unpacked = UnpackedSetup::load(log.header())?;
    let config = unpacked.config()?;
    let mut collector = Collector::new(&unpacked.setup, &config);
    let mut pipeline = None;
    for logged in log {
        interrupt::check()?;
        let logged = logged?;
        let image = match &logged.image {
            Some(image) if logged.cycle.detections.is_none() => image,
            _ => {
                collector.add_cycle(&logged.cycle);
                continue;
            }
        };
        // A log of `record`: nothing has looked at its images yet.
        let pipeline = match &mut pipeline {
            Some(pipeline) => pipeline,
            absent => absent.insert(Pipeline::new(&unpacked.setup, &config)?),
        };
        let mut samples = logged.samples(false)?;
        if let Some(Sample::Image(last)) = samples.last_mut() {
            last.content = ImageContent::Pixels(image.decode()?.into());
        }
        for sample in samples {
            if let Some(cycle) = pipeline.process_sample(sample) {
                collector.add_cycle(&cycle);
            }
        }
    }
    Ok(collector.finish(unpacked.setup.robot))
}

/// Collects the samples of cycles, and matches their line points again without wheels.
struct Collector {
    distances: DistanceField,
    matcher: localize::matching::Matcher,
    odometry: Vec<Odometry>,
    imu: Vec<Imu>,
    poses: Vec<VisionPose>,
}

impl Collector {
    fn new(setup: &Setup, config: &PipelineConfig) -> Self {
        let mut matching = config.localize.matching.clone();
        if let Some(height) = setup.viewpoint_height {
            matching.viewpoint_height = height;
        }
        Collector {
            distances: DistanceField::new(&setup.field, &config.localize.distance_field),
            matcher: localize::matching::Matcher::new(matching),
            odometry: Vec::new(),
            imu: Vec::new(),
            poses: Vec::new(),
        }
    }

    fn add_cycle(&mut self, cycle: &Cycle) {
        self.odometry.extend(&cycle.inputs.odometry);
        self.imu.extend(&cycle.inputs.imu);
        let Some(tracked) = cycle.estimate.pose else {
            return;
        };
        let matched =
            self.matcher
                .refine(&self.distances, &cycle.line_points, tracked, START_ERROR);
        let error = matched.pose.difference(tracked);
        let is_near =
            error.x.abs().max(error.y.abs()) < DEVIATION_MAX.0 && error.z.abs() < DEVIATION_MAX.1;
        if is_near
            && matched.inlier_share > INLIER_SHARE_MIN
            && matched.determined_parameters > DETERMINED_MIN
        {
            let pose = VisionPose {
                stamp: cycle.stamp,
                pose: matched.pose,
                covariance: matched.covariance,
            };
            self.poses.push(self.on_the_same_half(pose));
        }
    }

    /// A pose, or its half turn, whichever is nearer to the heading of the one before: where both halves of a field look nearly alike,
    /// successive poses may be on either.
    fn on_the_same_half(&self, found: VisionPose) -> VisionPose {
        let follows = |last: &&VisionPose| found.stamp - last.stamp <= HALF_GAP_MAX;
        let Some(last) = self.poses.last().filter(follows) else {
            return found;
        };
        let turned = |pose: Pose| pose.difference(last.pose).z.abs();
        let twin = half_turn(found.pose);
        if turned(twin) >= turned(found.pose) {
            return found;
        }
        let turn = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        VisionPose {
            pose: twin,
            covariance: turn * found.covariance * turn,
            ..found
        }
    }

    fn finish(mut self, robot: RobotConfig) -> Drive {
        sort(&mut self.odometry, |sample| sample.stamp);
        sort(&mut self.imu, |sample| sample.stamp);
        Drive {
            robot,
            odometry: self.odometry,
            imu: self.imu,
            poses: self.poses,
        }
    }
}

/// Orders samples by stamp; a repeated one counts once.
fn sort<T>(samples: &mut Vec<T>, stamp: impl Fn(&T) -> Stamp) {
    samples.sort_by_key(&stamp);
    samples.dedup_by_key(|sample| stamp(sample));
}
