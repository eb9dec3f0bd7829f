//! `mirrorball locate`: where was the robot in each frame of a recording folder?

use std::path::PathBuf;

use anyhow::{Result, ensure};
use serde::Serialize;
use vision::config::ObjectConfig;

use crate::commands::arguments::{self, UsageError};
use crate::interrupt;
use pipeline::csv_table::format_seconds;
use pipeline::recording::Recording;
use pipeline::result_files::CsvOutputs;
use pipeline::score;
use pipeline::score::detections::{DetectionStatistics, DetectionSummary, GroundTruthScene};
use pipeline::score::summary::{RunStatistics, Summary};
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Find the robot in every frame of a recording folder.
///
/// The folder holds robot.toml, frames.csv (or points.csv with line points of another vision) and, if there are any,
/// odometry.csv, compass.csv and truth.csv. Writes poses.csv into it.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball locate samples/sequence --out poses.csv --json")]
pub struct Args {
    /// The recording folder.
    dir: PathBuf,
    /// Measure with this calibrated map (npz) in place of the robot's own.
    #[arg(long, value_name = "MAP.npz")]
    map: Option<PathBuf>,
    /// Where the poses go [default: DIR/poses.csv].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Also write every line point: stamp_s,x_m,y_m in the robot frame.
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Also write ball, robots and goals: stamp_s,kind,x_m,y_m,std_m,score in the robot frame.
    #[arg(long, value_name = "FILE")]
    seen: Option<PathBuf>,
    /// Find the place as this paper does: lima2001, minho2016 or nubot2013.
    #[arg(long, value_name = "NAME", value_parser = localize::presets::PRESETS, default_value = "default")]
    preset: String,
    /// Change settings of vision and localisation by a TOML overlay.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    #[serde(flatten)]
    summary: Summary,
    /// Different pixels that the scan lines read, and their share of the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_pixels: Option<usize>,
    /// See `scan_pixels`.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_share: Option<f32>,
    /// What the eyes found of what is known to be there.
    #[serde(skip_serializing_if = "Option::is_none")]
    eyes: Option<DetectionSummary>,
}

/// Standard deviation taken for line points of another vision, which come without one, metres.
pub const EXTERNAL_POINT_STD: f32 = 0.04;

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
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
    if let Some(notice) = spine.notice() {
        eprintln!("{notice}");
    }
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
                    "frame at {} s skipped: {fault}",
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
        "{}: no frame could be used",
        args.dir.display()
    );
    Ok(())
}
