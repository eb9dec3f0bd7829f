//! `mirrorball locate`: the robot's pose in each frame of a recording folder.

use std::path::PathBuf;

use anyhow::{Context, Result};

use crate::commands::arguments::{self, UsageError};
use crate::commands::inputs::Inputs;
use crate::interrupt;
use pipeline::PipelineConfig;
use pipeline::result_files::CsvOutputs;
use pipeline::run::{RecordingOptions, RecordingRun, ensure_usable};
use vision::output_file::ensure_can_create;

/// Locate the robot in every frame of a recording folder.
///
/// The folder holds robot.toml, frames.csv (or points.csv with line points of external vision) and, if available,
/// odometry.csv, compass.csv and truth.csv. Writes poses.csv into it.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball locate samples/sequence --out poses.csv --json")]
pub(crate) struct Args {
    /// The recording folder.
    dir: PathBuf,
    /// Calibrated map (npz) in place of the robot's own.
    #[arg(long, value_name = "MAP.npz")]
    map: Option<PathBuf>,
    /// File of the poses [default: DIR/poses.csv].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Also write every line point: stamp_s,x_m,y_m in the robot frame.
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Also write ball, robots and goals: stamp_s,kind,x_m,y_m,std_m,score in the robot frame.
    #[arg(long, value_name = "FILE")]
    seen: Option<PathBuf>,
    /// Write the ground map with what was learned about its errors (npz).
    #[arg(long, value_name = "MAP.npz")]
    save_map: Option<PathBuf>,
    /// Localization method: the default, or that of a paper (lima2001, minho2016, nubot2013).
    #[arg(long, value_name = "NAME", value_parser = localize::presets::PRESETS, default_value = "default")]
    preset: String,
    /// Override settings of vision and localization by a TOML file.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
}

/// Standard deviation assumed for line points of external vision, which come without one, metres.
pub(crate) const EXTERNAL_POINT_STD: f32 = 0.04;

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    if !args.dir.is_dir() {
        return Err(UsageError(format!("{} is not a folder", args.dir.display())).into());
    }
    interrupt::install_handler()?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| args.dir.join("poses.csv"));
    let output_files = [
        Some(&*out),
        args.points.as_deref(),
        args.seen.as_deref(),
        args.save_map.as_deref(),
    ];
    arguments::ensure_distinct_outputs(output_files)?;
    let inputs = Inputs::of([&*args.dir])
        .with_file(args.map.as_deref(), "map")
        .with_file(args.config.as_deref(), "");
    inputs.ensure_kept([Some(&*out), args.points.as_deref(), args.seen.as_deref()])?;
    // What was learned about a map may replace it.
    inputs
        .without("map")
        .ensure_kept([args.save_map.as_deref()])?;
    if let Some(path) = &args.save_map {
        // The map is written when all images are located.
        ensure_can_create(path).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let run = RecordingRun::open(&RecordingOptions {
        folder: args.dir.clone(),
        map: args.map.clone(),
        save_map: args.save_map.clone(),
        config: PipelineConfig::load(&args.preset, args.config.as_deref())?,
        external_point_std: EXTERNAL_POINT_STD,
    })?;
    if let Some(notice) = run.notice() {
        stderr_line!("note: {notice}");
    }
    let setup_warnings = run.setup_report().warnings.len();
    for warning in &run.setup_report().warnings {
        stderr_line!("warning: {warning}");
    }
    let mut outputs = CsvOutputs::create(Some(&out), args.points.as_deref(), args.seen.as_deref())?;
    let bar = crate::progress::bar(run.frames() as u64, "frames");
    let result = run.run(|cycle| {
        outputs.write(cycle)?;
        bar.inc(1);
        interrupt::check()
    })?;
    bar.finish_and_clear();
    outputs.finish()?;
    for sentence in result.image_faults.sentences() {
        stderr_line!("{sentence}");
    }
    for warning in result.warnings.iter().skip(setup_warnings) {
        stderr_line!("warning: {warning}");
    }
    if json {
        println!("{}", serde_json::to_string(&result)?);
    } else {
        result.summary.print();
        if let Some(figures) = &result.setup {
            println!("{}", figures.text());
        }
        if setup_warnings > 0 {
            let folder = args.dir.display();
            println!(
                "the set-up is doubtful: `mirrorball doctor --recording {folder}` shows alternatives"
            );
        }
        if let Some(detections) = &result.detections {
            detections.print();
        }
        if let Some(labelled) = &result.labelled_objects {
            labelled.print();
        }
        if let (Some(pixels), Some(share)) = (result.scan_pixels, result.scan_share) {
            println!(
                "scan lines read {pixels} pixels, {:.1} % of the image",
                100.0 * share
            );
        }
        println!("poses: {}", out.display());
    }
    ensure_usable(&result.summary, &args.dir)
}
