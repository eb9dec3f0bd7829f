//! `mirrorball locate`: where was the robot in each image of a recording folder?

use std::path::PathBuf;

use anyhow::{Result, ensure};
use serde::Serialize;
use vision::config::ObjectConfig;

use crate::commands::arguments::{self, UsageError};
use crate::interrupt;
use pipeline::csv_table::format_seconds;
use pipeline::cycle::{Pipeline, PipelineConfig};
use pipeline::recording::Recording;
use pipeline::result_files::CsvOutputs;
use pipeline::score;
use pipeline::score::detections::{DetectionStatistics, DetectionSummary, GroundTruthScene};
use pipeline::score::summary::{RunStatistics, Summary};
use pipeline::setup::Setup;

/// Locate the robot in every image of a recording folder.
///
/// The folder contains robot.toml, frames.csv (or points.csv with line points of other vision software) and optionally
/// odometry.csv, compass.csv and truth.csv. Writes poses.csv into it.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball locate samples/sequence --out poses.csv --json")]
pub(crate) struct Args {
    /// The recording folder.
    dir: PathBuf,
    /// Use this calibrated ground map (npz) instead of the robot's own.
    #[arg(long, value_name = "MAP.npz")]
    map: Option<PathBuf>,
    /// File for the poses [default: DIR/poses.csv].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Also write every line point: stamp_s,x_m,y_m in the robot frame.
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Also write ball, robots and goals: stamp_s,kind,x_m,y_m,std_m,score in the robot frame.
    #[arg(long, value_name = "FILE")]
    seen: Option<PathBuf>,
    /// Localization method: the default, or that of a paper (lima2001, minho2016, nubot2013).
    #[arg(long, value_name = "NAME", value_parser = localize::presets::PRESETS, default_value = "default")]
    preset: String,
    /// Override settings of vision and localization by a TOML file.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    #[serde(flatten)]
    summary: Summary,
    /// Number of distinct pixels on the scan lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_pixels: Option<usize>,
    /// Their share of the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_share: Option<f32>,
    /// Detection rates, if the objects of the recording are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    eyes: Option<DetectionSummary>,
}

/// Standard deviation of line points of other vision software, which come without one, metres.
pub(crate) const EXTERNAL_POINT_STD: f32 = 0.04;

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    if !args.dir.is_dir() {
        return Err(UsageError(format!("{} is not a folder", args.dir.display())).into());
    }
    interrupt::install_handler()?;
    let setup = Setup::load(&args.dir.join("robot.toml"), args.map.as_deref())?;
    let recording = Recording::open(&args.dir, EXTERNAL_POINT_STD)?;
    let truth = recording.truth.clone();
    let objects = recording.objects.clone();
    let mut spine = Pipeline::new(
        &setup,
        &PipelineConfig::load(&args.preset, args.config.as_deref())?,
    )?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| args.dir.join("poses.csv"));
    arguments::ensure_distinct_outputs([
        Some(&*out),
        args.points.as_deref(),
        args.seen.as_deref(),
    ])?;
    let mut outputs = CsvOutputs::create(Some(&out), args.points.as_deref(), args.seen.as_deref())?;
    let mut tally = RunStatistics::default();
    let mut sight = DetectionStatistics::default();
    let viewpoint_height = setup
        .viewpoint_height
        .unwrap_or(ObjectConfig::default().viewpoint_height);
    let bar = crate::progress::bar(recording.frames() as u64, "frames");
    for cycle in recording.filter_map(|sample| spine.process_sample(sample)) {
        if let Some(fault) = &cycle.fault {
            bar.suspend(|| {
                eprintln!(
                    "image at {} s skipped: {fault}",
                    format_seconds(cycle.stamp)
                )
            });
        }
        outputs.write(&cycle)?;
        interrupt::check()?;
        let error = cycle
            .estimate
            .pose
            .and_then(|pose| score::pose_error(&truth, cycle.stamp, pose));
        tally.add_cycle(&cycle, error);
        if let (Some(seen), Some((_, map))) = (&cycle.detections, &setup.camera)
            && let Some(pose) = score::true_pose_at(&truth, cycle.stamp)
        {
            let scene = GroundTruthScene {
                pose,
                tilt: cycle.estimate.tilt,
                viewpoint_height,
                field: &setup.field,
                map,
                occluded_sectors: &[],
                objects: objects.get(&cycle.stamp).map(Vec::as_slice),
            };
            sight.add_image(seen, &scene);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    outputs.finish()?;
    let (summary, eyes) = (tally.summary(), sight.summary());
    let coverage = spine.scan_coverage();
    if json {
        let outcome = Outcome {
            summary: summary.clone(),
            scan_pixels: coverage.map(|(pixels, _)| pixels),
            scan_share: coverage.map(|(_, share)| share),
            eyes,
        };
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        summary.print();
        eyes.iter().for_each(DetectionSummary::print);
        if let Some((pixels, share)) = coverage {
            println!(
                "scan lines read {pixels} pixels, {:.1} % of the image",
                100.0 * share
            );
        }
        println!("poses: {}", out.display());
    }
    ensure!(
        summary.unreadable < summary.frames,
        "{}: no usable image",
        args.dir.display()
    );
    Ok(())
}
