//! `mirrorball field from-recording`: an unknown line pattern, mapped from a drive.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use localize::Pose;
use localize::field::Field;
use localize::field_mapping::{FieldMappingConfig, MappedField, MappingImage, map_field};
use localize::frames::{RobotFrame, Tf};
use pipeline::log::{LogReader, UnpackedSetup};
use pipeline::recording::Recording;
use pipeline::setup::Setup;
use pipeline::{Cycle, Pipeline, PipelineConfig};

use super::field_file::{self, MappingFigures, Outcome};
use crate::commands::arguments::UsageError;
use crate::commands::inputs::Inputs;
use crate::commands::locate::EXTERNAL_POINT_STD;
use crate::interrupt;

/// Map the lines and arcs of an unknown floor from a drive with wheels and camera.
///
/// The camera or its map must be calibrated. Drive past every marking, slowly, and come back to the start. The field that
/// robot.toml names is not used, but for the width of its lines.
#[derive(clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Example: mirrorball field from-recording drive/ --out hall.toml\n         \
                  mirrorball field from-recording drive.mcap --line-width 0.05 --out hall.toml"
)]
pub(super) struct Args {
    /// A recording folder with odometry.csv, or a log.
    #[arg(value_name = "DIR|LOG")]
    drive: PathBuf,
    /// The field file to write.
    #[arg(long, value_name = "FIELD.toml")]
    out: PathBuf,
    /// Width of the painted or taped lines, metres (default: as the robot's field file has it).
    #[arg(long, value_name = "METRES")]
    line_width: Option<f32>,
    /// Floor beyond the outermost marking, metres.
    #[arg(long, value_name = "METRES", default_value_t = 1.0)]
    border: f32,
    /// Largest range of line points used, metres.
    #[arg(long, value_name = "METRES", default_value_t = 5.0)]
    range: f32,
    /// Standard deviation of the robot's tilt from image to image, degrees: with less, far line points count more.
    #[arg(long, value_name = "DEGREES", default_value_t = TILT_STD_DEG)]
    tilt: f32,
}

/// Tilt of real robots from image to image, degrees.
const TILT_STD_DEG: f32 = 0.45;
/// Keyframes that must see places again, for the map to be held together.
const REVISITS_MIN: usize = 3;
/// Scatter of the points about the lines and arcs that calibrated cameras and closed loops stay below, metres.
const RESIDUAL_MAX: f32 = 0.035;
/// Standard deviation of the markings from which a map says so, metres.
const MARKING_STD_MAX: f32 = 0.1;
/// Share of the points that the lines and arcs should explain.
const EXPLAINED_MIN: f32 = 0.6;

/// Runs the command.
pub(super) fn run(args: &Args, json: bool) -> Result<()> {
    Inputs::of([&*args.drive]).ensure_kept([Some(&*args.out)])?;
    interrupt::install_handler()?;
    let (images, line_width) = if args.drive.is_dir() {
        load_recording(&args.drive)?
    } else if args.drive.is_file() {
        load_log(&args.drive)?
    } else {
        let place = args.drive.display();
        return Err(UsageError(format!("{place} is neither a folder nor a log")).into());
    };
    let config = FieldMappingConfig {
        line_width: args.line_width.unwrap_or(line_width),
        border: args.border,
        range_max: args.range,
        tilt_std_deg: args.tilt.max(0.0),
        ..FieldMappingConfig::default()
    };
    let mapped = map_field(&images, &config).with_context(|| args.drive.display().to_string())?;
    let field = Field::new(mapped.config.clone())?;
    let warnings = warnings(&mapped, &field);
    field_file::write(
        &args.out,
        &mapped.config,
        &format!("Mapped from a drive of {} images.", images.len()),
    )?;
    let figures = MappingFigures {
        keyframes: mapped.poses.len(),
        revisits: mapped.revisits,
        explained_share: mapped.explained_share,
        residual: mapped.residual,
        marking_std: field.marking_std(),
        odometry_correction: mapped.odometry_correction,
    };
    Outcome::new(&args.out, &mapped.config, warnings)?
        .with_mapping(figures)
        .print(json)
}

/// What makes the map doubtful.
fn warnings(mapped: &MappedField, field: &Field) -> Vec<String> {
    let mut warnings = Vec::new();
    if mapped.revisits < REVISITS_MIN {
        warnings.push(
            "the drive came to no place twice: errors of the wheels add up over the map. Drive a loop".to_owned(),
        );
    }
    if mapped.explained_share < EXPLAINED_MIN {
        warnings.push(format!(
            "only {:.0} % of the line points lie on the lines and arcs found: are they straight or round, and is the camera calibrated?",
            100.0 * mapped.explained_share
        ));
    }
    if mapped.copies > 0 {
        warnings.push(format!(
            "{} lines have a parallel one within 0.6 m: if the floor has no such pairs, the map holds these lines twice, because \
             passes did not meet. Drive more slowly and cross your own path more often",
            mapped.copies
        ));
    }
    if mapped.residual > RESIDUAL_MAX {
        warnings.push(format!(
            "line points scatter by {:.1} cm about the lines and arcs found: check the camera's calibration (mirrorball doctor --recording) before you trust this map",
            100.0 * mapped.residual
        ));
    }
    let std = field.marking_std();
    if std > MARKING_STD_MAX {
        warnings.push(format!(
            "the markings are known to {:.0} cm only: drive past each of them more than once",
            100.0 * std
        ));
    }
    if mapped.uncertain_arcs > 0 {
        warnings.push(format!(
            "{} arcs were left out: too little of them was seen to tell centre and radius",
            mapped.uncertain_arcs
        ));
    }
    warnings
}

/// Line points and motion of a recording folder, and the width of the lines.
fn load_recording(folder: &Path) -> Result<(Vec<MappingImage>, f32)> {
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let recording = Recording::open(folder, EXTERNAL_POINT_STD)?;
    // The pose on the field that robot.toml names is of no use here: only the line points are.
    let mut pipeline = Pipeline::new(&setup, &PipelineConfig::default())?;
    let bar = crate::progress::bar(recording.frames() as u64, "frames");
    let mut images = Vec::new();
    for cycle in recording.filter_map(|sample| pipeline.process_sample(sample)) {
        images.push(image(&cycle));
        bar.inc(1);
        interrupt::check()?;
    }
    bar.finish_and_clear();
    Ok((images, setup.field.config.line_width))
}

fn load_log(path: &Path) -> Result<(Vec<MappingImage>, f32)> {
    let log = LogReader::open(path)?;
    let unpacked = UnpackedSetup::load(log.header())?;
    let mut images = Vec::new();
    for logged in log {
        images.push(image(&logged?.cycle));
        interrupt::check()?;
    }
    Ok((images, unpacked.setup.field.config.line_width))
}

/// The motion since the last image, and the line points.
fn image(cycle: &Cycle) -> MappingImage {
    let start: Tf<RobotFrame, RobotFrame> = Tf::new(0.0, 0.0, 0.0);
    let motion = cycle.inputs.odometry.iter().fold(start, |sum, odometry| {
        sum * Tf::new(odometry.dx, odometry.dy, odometry.dtheta)
    });
    let motion = Pose::new(motion.x, motion.y, motion.theta);
    MappingImage {
        motion: [motion.x, motion.y, motion.theta],
        points: cycle.line_points.clone(),
    }
}
