//! How long does a cycle take? Each stage alone on one core, every cycle measured, so that slow cycles show too.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use localize::global_search::branch_and_bound::{BranchAndBound, HeadingPrior};
use localize::global_search::hough::Hough;
use localize::global_search::monte_carlo::MonteCarlo;
use localize::global_search::scan_map::ScanMap;
use localize::matching::{MatchConfig, Matcher, Minimiser};
use localize::synthetic::drive::{SyntheticDrive, SyntheticDriveConfig, SyntheticSample};
use localize::{DistanceField, Field, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::Vision;
use vision::image::Image;

use super::experiment::{Stage, Times};
use super::metric::Metric;
use super::output::{CsvRows, csv_quote};
use pipeline::PipelineConfig;
use pipeline::paths;
use pipeline::setup::Setup;

/// The stage's name in tables.
fn stage_name(stage: Stage) -> &'static str {
    match stage {
        Stage::LinePoints => "line points",
        Stage::MonteCarlo => "Monte Carlo",
        Stage::MatchingRprop => "RPROP",
        Stage::Matching => "matching",
        Stage::ScanMapGlobal => "scan map, all",
        Stage::ScanMapLocal => "scan map, 4 m²",
        Stage::Hough => "Hough",
        Stage::Exact => "exact",
    }
}

/// Measures each stage. Other load on the machine shows in the upper end of the interval.
pub(crate) fn run(
    times: &Times,
    seed: u64,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let field = Field::load(&times.field)?;
    let frames: Vec<SyntheticSample> = SyntheticDrive::new(
        &field,
        SyntheticDriveConfig::default(),
        ChaCha8Rng::seed_from_u64(seed),
    )
    .take(times.cycles)
    .collect();
    bar.set_length(times.stages.len() as u64);
    rows.header("method,cycle,time_ms")?;
    let mut figures = Vec::new();
    for &stage in &times.stages {
        let times_ms = measure_stage(stage, &field, &frames)
            .with_context(|| format!("stage {}", stage_name(stage)))?;
        for (cycle, time) in times_ms.iter().enumerate() {
            rows.row(format_args!(
                "{},{cycle},{time:.5}",
                csv_quote(stage_name(stage))
            ))?;
        }
        figures.push(Metric::median("", stage_name(stage), "time, ms", times_ms));
        bar.inc(1);
    }
    Ok(figures)
}

/// Milliseconds of each call. The first three frames run twice, because the first calls fill caches.
fn time_each_frame<'a>(
    frames: &'a [SyntheticSample],
    mut call: impl FnMut(&'a SyntheticSample, Option<HeadingPrior>),
) -> Vec<f64> {
    let mut once = |frame: &'a SyntheticSample| {
        let std = 10f32.to_radians();
        let heading = frame.compass.heading;
        let started = Instant::now();
        call(frame, Some(HeadingPrior { heading, std }));
        started.elapsed().as_secs_f64() * 1e3
    };
    for frame in frames.iter().take(3) {
        once(frame);
    }
    frames.iter().map(once).collect()
}

fn measure_stage(stage: Stage, field: &Field, frames: &[SyntheticSample]) -> Result<Vec<f64>> {
    let config = PipelineConfig::default().localize;
    let distances = DistanceField::new(field, &config.distance_field);
    let perturbed = |pose: Pose| Pose::new(pose.x + 0.02, pose.y - 0.02, pose.theta + 0.01);
    let matching = |config: MatchConfig| {
        let mut matcher = Matcher::new(config);
        time_each_frame(frames, |frame, _| {
            black_box(matcher.refine(&distances, &frame.points, perturbed(frame.true_pose), 0.05));
        })
    };
    let scan_map = || ScanMap::new(field, &distances, config.global_search.scan_map.clone());
    Ok(match stage {
        Stage::LinePoints => return measure_line_points(frames.len()),
        Stage::MonteCarlo => {
            let settings = config.global_search.monte_carlo.clone();
            let mut filter = MonteCarlo::new(field, &distances, settings);
            time_each_frame(frames, |frame, prior| {
                filter.reset();
                black_box(filter.update(&frame.points, prior));
            })
        }
        Stage::MatchingRprop => {
            let preset = PipelineConfig::preset("nubot2013")?.localize.matching;
            matching(MatchConfig {
                minimiser: Minimiser::Rprop,
                ..preset
            })
        }
        Stage::Matching => matching(config.matching.clone()),
        Stage::ScanMapGlobal => {
            let map = scan_map();
            time_each_frame(frames, |frame, prior| {
                let heading = prior.map_or(0.0, |prior| prior.heading);
                black_box(map.find_poses(&frame.points, heading, 6, 0.4));
            })
        }
        Stage::ScanMapLocal => {
            let map = scan_map();
            time_each_frame(frames, |frame, _| {
                black_box(map.find_pose_near(&frame.points, frame.true_pose));
            })
        }
        Stage::Hough => {
            let mut hough = Hough::new(field, config.global_search.hough.clone());
            time_each_frame(frames, |frame, prior| {
                black_box(hough.find_poses(&frame.points, prior));
            })
        }
        Stage::Exact => {
            let mut search =
                BranchAndBound::new(field, &distances, config.branch_and_bound.clone());
            let mut matcher = Matcher::new(config.matching.clone());
            time_each_frame(frames, |frame, _| {
                black_box(search.find_hypotheses(&distances, &mut matcher, &frame.points, None));
            })
        }
    })
}

/// Recording of the images from which line points are timed.
const IMAGES: &str = "samples/sequence";

/// Fails if stages need images that are not there.
pub(super) fn ensure_images(times: &Times) -> Result<()> {
    if times.stages.contains(&Stage::LinePoints) {
        paths::find_resource(IMAGES)?;
    }
    Ok(())
}

/// Cycles through the images of the sample recording.
fn measure_line_points(cycles: usize) -> Result<Vec<f64>> {
    let folder = paths::find_resource(IMAGES)?;
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let (camera, map) = setup.camera.as_ref().context("the sample has no camera")?;
    let config = PipelineConfig::preset("minho2016")?.vision;
    let width = setup.field.config.line_width;
    let mut vision = Vision::new(map, camera, width, config)?;
    let images: Vec<Image> = (0..8)
        .map(|number| Image::load(&folder.join(format!("frames/{number:03}.jpg"))))
        .collect::<Result<_, _>>()?;
    // The first image learns the colours.
    vision.process_lines(&images[0].view())?;
    (0..cycles)
        .map(|cycle| {
            let started = Instant::now();
            black_box(vision.process_lines(&images[cycle % images.len()].view())?);
            Ok(started.elapsed().as_secs_f64() * 1e3)
        })
        .collect()
}
