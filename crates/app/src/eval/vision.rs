//! What do the eyes find of what is there, and how far away? Line points, markings, ball and robots against truth.

use crate::interrupt;
use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use indicatif::ProgressBar;
use localize::Stamp;
use rayon::prelude::*;
use vision::config::ObjectConfig;

use super::experiment::{RecordingRun, Variant, VisionRuns};
use super::metric::Metric;
use super::output::{CsvRows, csv_quote};
use crate::commands::locate::EXTERNAL_POINT_STD;
use pipeline::config::apply_overlay;
use pipeline::recording::Recording;
use pipeline::score;
use pipeline::score::detections::{
    DetectionStatistics, GroundTruthObject, GroundTruthScene, ScoredItem, ScoredKind,
};
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Runs are cut into pieces this long for the intervals of shares, seconds: by then everything stands elsewhere. A short
/// recording is cut into as many as ten all the same.
const SEGMENT_S: f64 = 1.0;
const SEGMENTS_MIN: f64 = 10.0;
/// Width of the tables' bins of distance, metres.
const RANGE_BIN: f32 = 0.5;
/// Line points, ball, and the rest are judged up to here, metres: what `locate` prints.
const POINT_RANGE: f32 = 5.0;
const BALL_RANGE: f32 = 6.0;
const OBJECT_RANGE: f32 = 4.0;

/// Right ones and all, by what and bin of distance.
type DetectionCounts = BTreeMap<(ScoredKind, usize), [usize; 2]>;

/// A second of a run.
#[derive(Default)]
struct RunSegment {
    frames: usize,
    counts: DetectionCounts,
}

/// One run, second by second, and the time of each frame in milliseconds.
struct VisionRun {
    segment_s: f64,
    start: Option<Stamp>,
    segments: Vec<RunSegment>,
    times_ms: Vec<f64>,
}

enum ImageSource<'a> {
    Recording(&'a RecordingRun),
    Simulated(&'a Variant, u64),
}

impl ImageSource<'_> {
    fn name(&self) -> &str {
        match self {
            ImageSource::Recording(one) => &one.name,
            ImageSource::Simulated(variant, _) => &variant.name,
        }
    }

    fn run(&self, preset: &str) -> Result<VisionRun> {
        match self {
            ImageSource::Recording(one) => run_recording(&one.folder, preset),
            ImageSource::Simulated(variant, seed) => run_scenario(variant, *seed, preset),
        }
    }
}

/// Looks at every source with every preset; counts by distance to CSV, figures back.
pub fn run(
    eyes: &VisionRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let simulated = eyes.variants.iter().flat_map(|variant| {
        let seeds = seeds.clone();
        seeds.map(move |seed| ImageSource::Simulated(variant, seed))
    });
    let recorded = eyes.recordings.iter().map(ImageSource::Recording);
    let sources: Vec<ImageSource<'_>> = recorded.chain(simulated).collect();
    let jobs: Vec<(&str, &ImageSource<'_>)> = eyes
        .presets
        .iter()
        .flat_map(|preset| sources.iter().map(move |source| (preset.as_str(), source)))
        .collect();
    bar.set_length(jobs.len() as u64);
    let looked: Vec<VisionRun> = jobs
        .par_iter()
        .map(|(preset, source)| {
            let done = source.run(preset).with_context(|| source.name().to_owned());
            bar.inc(1);
            done
        })
        .collect::<Result<_>>()?;
    rows.header("variant,method,kind,range_m,right,count")?;
    let mut figures = Vec::new();
    let names = sources.iter().map(ImageSource::name);
    let mut names: Vec<&str> = names.collect();
    names.dedup();
    for name in names {
        for preset in &eyes.presets {
            let mine = jobs.iter().zip(&looked);
            let mine: Vec<&VisionRun> = mine
                .filter(|((method, source), _)| *method == preset.as_str() && source.name() == name)
                .map(|(_, looked)| looked)
                .collect();
            write_rows(rows, name, preset, &mine)?;
            figures.extend(metrics_of(name, preset, &mine));
        }
    }
    Ok(figures)
}

/// Shares in percent that the default eyes find in a recording: right line points (5 m), markings sampled (4 m), ball (6 m)
/// and robots (4 m).
pub fn detection_rates(folder: &Path) -> Result<[Option<f64>; 4]> {
    let looked = run_recording(folder, "default")?;
    let figures = metrics_of("", "", &[&looked]);
    Ok(RATE_NAMES.map(|name| figures.iter().find(|one| one.name == name)?.value))
}

const RATE_NAMES: [&str; 4] = [
    "line points right (5 m), %",
    "markings sampled (4 m), %",
    "ball found (6 m), %",
    "robots found (4 m), %",
];

fn run_recording(folder: &Path, preset: &str) -> Result<VisionRun> {
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let recording = Recording::open(folder, EXTERNAL_POINT_STD)?;
    let (truth, objects) = (recording.truth.clone(), recording.objects.clone());
    ensure!(!truth.is_empty(), "{}: no truth.csv", folder.display());
    let mut spine = Pipeline::new(&setup, &PipelineConfig::preset(preset)?)?;
    let lasts = truth.first().zip(truth.last());
    let mut looked = VisionRun::new(lasts.map_or(0.0, |(first, last)| last.stamp - first.stamp));
    for cycle in recording.filter_map(|sample| spine.process_sample(sample)) {
        let there = objects.get(&cycle.stamp).map(Vec::as_slice);
        if let Some(pose) = score::true_pose_at(&truth, cycle.stamp) {
            looked.add_cycle(&cycle, &setup, pose, (there, &[]));
        }
    }
    Ok(looked)
}

fn run_scenario(variant: &Variant, seed: u64, preset: &str) -> Result<VisionRun> {
    let scenario = variant.scenario.as_deref().context("no scenario")?;
    let simulation = Simulation::with_overrides(scenario, &variant.set, Some(seed), None)?;
    let setup = simulation.setup()?;
    let config = apply_overlay(&PipelineConfig::preset(preset)?, variant.config.clone())?;
    let mut spine = Pipeline::new(&setup, &config)?;
    let mut looked = VisionRun::new(simulation.duration());
    let occlusions = simulation.sim().scenario().occlusions.clone();
    simulation.run(&mut spine, |cycle| {
        let Some(truth) = &cycle.inputs.truth else {
            return Ok(interrupt::flow());
        };
        let thing = |is_ball, at, heading| GroundTruthObject {
            is_ball,
            at,
            heading,
            visible_px: None,
        };
        let ball = truth.ball.map(|at| thing(true, at, None));
        let robots = truth.robots.iter().zip(&truth.robot_headings);
        let robots = robots.map(|(&at, &heading)| thing(false, at, Some(heading)));
        let there: Vec<GroundTruthObject> = ball.into_iter().chain(robots).collect();
        let now = cycle.stamp.seconds();
        let hangs = occlusions
            .iter()
            .filter(|one| one.start <= now && now < one.stop);
        let covered: Vec<(f32, f32)> = hangs
            .map(|one| (one.direction_deg.to_radians(), one.width_deg.to_radians()))
            .collect();
        looked.add_cycle(&cycle, &setup, truth.pose, (Some(&there), &covered));
        Ok(interrupt::flow())
    })?;
    Ok(looked)
}

impl VisionRun {
    /// Of a run that lasts so many seconds.
    fn new(duration: f64) -> Self {
        VisionRun {
            segment_s: SEGMENT_S.min((duration / SEGMENTS_MIN).max(1e-3)),
            start: None,
            segments: Vec::new(),
            times_ms: Vec::new(),
        }
    }

    fn add_cycle(
        &mut self,
        cycle: &Cycle,
        setup: &Setup,
        pose: localize::Pose,
        (objects, covered): (Option<&[GroundTruthObject]>, &[(f32, f32)]),
    ) {
        let (Some(seen), Some((_, map))) = (&cycle.detections, &setup.camera) else {
            return;
        };
        let first = *self.start.get_or_insert(cycle.stamp);
        let piece = ((cycle.stamp - first) / self.segment_s) as usize;
        if self.segments.len() <= piece {
            self.segments.resize_with(piece + 1, RunSegment::default);
        }
        let RunSegment { frames, counts } = &mut self.segments[piece];
        *frames += 1;
        self.times_ms.push(f64::from(cycle.timings.see_ms));
        let scene = GroundTruthScene {
            pose,
            tilt: cycle.estimate.tilt,
            viewpoint_height: setup
                .viewpoint_height
                .unwrap_or(ObjectConfig::default().viewpoint_height),
            field: &setup.field,
            map,
            occluded_sectors: covered,
            objects,
        };
        DetectionStatistics::default().add_image_with(seen, &scene, &mut |note: ScoredItem| {
            let bin = (note.range / RANGE_BIN) as usize;
            let [right, all] = counts.entry((note.kind, bin)).or_default();
            *right += usize::from(note.correct);
            *all += 1;
        });
    }
}

fn write_rows(rows: &mut CsvRows, variant: &str, preset: &str, runs: &[&VisionRun]) -> Result<()> {
    let mut sums = DetectionCounts::new();
    for piece in runs.iter().flat_map(|run| &run.segments) {
        for (&key, &[right, all]) in &piece.counts {
            let sum = sums.entry(key).or_default();
            sum[0] += right;
            sum[1] += all;
        }
    }
    for ((kind, bin), [right, all]) in sums {
        let range = bin as f32 * RANGE_BIN;
        let (variant, kind) = (csv_quote(variant), kind_name(kind));
        rows.row(format_args!(
            "{variant},{preset},{kind},{range:.1},{right},{all}"
        ))?;
    }
    Ok(())
}

fn kind_name(kind: ScoredKind) -> &'static str {
    match kind {
        ScoredKind::Point => "line point",
        ScoredKind::Marking => "marking",
        ScoredKind::Ball => "ball",
        ScoredKind::Robot => "robot",
        ScoredKind::Edge => "robot's edge",
        ScoredKind::FalseBall => "no ball",
        ScoredKind::FalseRobot => "no robot",
    }
}

fn metrics_of(variant: &str, method: &str, runs: &[&VisionRun]) -> Vec<Metric> {
    let pieces: Vec<&RunSegment> = runs.iter().flat_map(|run| &run.segments).collect();
    let within = |kind: ScoredKind, range: f32| -> Vec<(usize, usize)> {
        let last = (range / RANGE_BIN) as usize;
        let sum = |piece: &&RunSegment| {
            let counts = piece.counts.range((kind, 0)..(kind, last));
            counts.fold((0, 0), |sum, (_, one)| (sum.0 + one[0], sum.1 + one[1]))
        };
        pieces.iter().map(sum).collect()
    };
    // Something that is not there: how often in a frame, not how often right.
    let false_ones = |kind, range| -> Vec<(usize, usize)> {
        let counted = within(kind, range).into_iter().zip(&pieces);
        counted
            .map(|((_, all), piece)| (all, piece.frames))
            .collect()
    };
    let share = |name, counted: Vec<(usize, usize)>| {
        Metric::clustered_proportion(variant, method, name, &counted)
    };
    let times = runs.iter().flat_map(|run| run.times_ms.iter().copied());
    let [points, markings, ball, robots] = RATE_NAMES;
    let mut figures = vec![
        share(points, within(ScoredKind::Point, POINT_RANGE)),
        share(markings, within(ScoredKind::Marking, OBJECT_RANGE)),
        share(ball, within(ScoredKind::Ball, BALL_RANGE)),
        share(
            "false balls, per 100 frames",
            false_ones(ScoredKind::FalseBall, f32::MAX),
        ),
        share(robots, within(ScoredKind::Robot, OBJECT_RANGE)),
        share(
            "their edge right to 10 cm, %",
            within(ScoredKind::Edge, OBJECT_RANGE),
        ),
        share(
            "false robots (4 m), per 100 frames",
            false_ones(ScoredKind::FalseRobot, OBJECT_RANGE),
        ),
        Metric::median(variant, method, "time to see, ms", times.collect()),
    ];
    // Where there is no ball or robot, nothing can be found.
    figures.retain(|figure| figure.value.is_some());
    figures
}
