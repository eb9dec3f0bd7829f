//! How high are the detection rates, by distance? Line points, markings, ball and robots against ground truth.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use indicatif::ProgressBar;
use localize::Stamp;
use rayon::prelude::*;
use sim::Sector;
use sim::scenario::Occlusion;
use vision::config::ObjectDetectionConfig;

use super::experiment::{RecordingEntry, ScenarioVariant, VisionRuns};
use super::metric::Metric;
use super::output::{CsvRows, csv_quote};
use crate::commands::locate::EXTERNAL_POINT_STD;
use crate::interrupt;
use pipeline::config::apply_overlay;
use pipeline::recording::Recording;
use pipeline::score;
use pipeline::score::detections::{
    DetectionStatistics, GroundTruthKind, GroundTruthObject, GroundTruthScene, ScoredItem,
    ScoredKind,
};
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Length of the segments that the intervals of proportions are computed from, seconds: after it the scene has changed.
const SEGMENT_S: f64 = 1.0;
/// A short recording is cut into this many segments.
const SEGMENTS_MIN: f64 = 10.0;
/// Width of the tables' distance bins, metres.
const RANGE_BIN: f32 = 0.5;
/// Line points, ball, and other objects are scored up to these distances, metres: those that `locate` prints.
const POINT_RANGE: f32 = 5.0;
const BALL_RANGE: f32 = 6.0;
const OBJECT_RANGE: f32 = 4.0;

/// Correct items and all items, by kind and distance bin.
type DetectionCounts = BTreeMap<(ScoredKind, usize), [usize; 2]>;

/// A segment of a run.
#[derive(Default)]
struct RunSegment {
    frames: usize,
    counts: DetectionCounts,
}

/// One run in segments, and the vision time of each image in milliseconds.
struct VisionRun {
    segment_s: f64,
    start: Option<Stamp>,
    segments: Vec<RunSegment>,
    times_ms: Vec<f64>,
}

enum ImageSource<'a> {
    Recording(&'a RecordingEntry),
    Simulated(&'a ScenarioVariant, u64),
}

impl ImageSource<'_> {
    fn name(&self) -> &str {
        match self {
            ImageSource::Recording(recording) => &recording.name,
            ImageSource::Simulated(variant, _) => &variant.name,
        }
    }

    fn run(&self, preset: &str) -> Result<VisionRun> {
        match self {
            ImageSource::Recording(recording) => run_recording(&recording.folder, preset),
            ImageSource::Simulated(variant, seed) => run_scenario(variant, *seed, preset),
        }
    }
}

/// Processes every source with every preset; writes counts by distance to CSV and returns the metrics.
pub(crate) fn run(
    runs: &VisionRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let simulated = runs.variants.iter().flat_map(|variant| {
        let seeds = seeds.clone();
        seeds.map(move |seed| ImageSource::Simulated(variant, seed))
    });
    let recorded = runs.recordings.iter().map(ImageSource::Recording);
    let sources: Vec<ImageSource<'_>> = recorded.chain(simulated).collect();
    let jobs: Vec<(&str, &ImageSource<'_>)> = runs
        .presets
        .iter()
        .flat_map(|preset| sources.iter().map(move |source| (preset.as_str(), source)))
        .collect();
    bar.set_length(jobs.len() as u64);
    let results: Vec<VisionRun> = jobs
        .par_iter()
        .map(|(preset, source)| {
            let result = source.run(preset).with_context(|| source.name().to_owned());
            bar.inc(1);
            result
        })
        .collect::<Result<_>>()?;
    rows.header("variant,method,kind,range_m,right,count")?;
    let mut figures = Vec::new();
    let names = sources.iter().map(ImageSource::name);
    let mut names: Vec<&str> = names.collect();
    names.dedup();
    for name in names {
        for preset in &runs.presets {
            let matching = jobs.iter().zip(&results);
            let matching: Vec<&VisionRun> = matching
                .filter(|((method, source), _)| *method == preset.as_str() && source.name() == name)
                .map(|(_, result)| result)
                .collect();
            write_rows(rows, name, preset, &matching)?;
            figures.extend(metrics_of(name, preset, &matching));
        }
    }
    Ok(figures)
}

/// Detection rates in percent of the default preset in a recording: correct line points (5 m), markings (4 m), ball (6 m)
/// and robots (4 m).
pub(crate) fn detection_rates(folder: &Path) -> Result<[Option<f64>; 4]> {
    let run = run_recording(folder, "default")?;
    let figures = metrics_of("", "", &[&run]);
    Ok(RATE_NAMES.map(|name| figures.iter().find(|figure| figure.name == name)?.value))
}

const RATE_NAMES: [&str; 4] = [
    "line points right (5 m), %",
    "markings sampled (4 m), %",
    "ball found (6 m), %",
    "robots found (4 m), %",
];

/// A preset that reads all scan lines: points are scored image by image.
fn settings(preset: &str) -> Result<PipelineConfig> {
    let mut config = PipelineConfig::preset(preset)?;
    config.vision.scan.interlaced_points_min = 0;
    Ok(config)
}

fn run_recording(folder: &Path, preset: &str) -> Result<VisionRun> {
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let recording = Recording::open(folder, EXTERNAL_POINT_STD)?;
    let (truth, objects) = (recording.truth.clone(), recording.objects.clone());
    ensure!(
        !truth.is_empty(),
        "{}: no truth.csv, or an empty one",
        folder.display()
    );
    let mut pipeline = Pipeline::new(&setup, &settings(preset)?)?;
    let ends = truth.first().zip(truth.last());
    let mut run = VisionRun::new(ends.map_or(0.0, |(first, last)| last.stamp - first.stamp));
    for cycle in recording.filter_map(|sample| pipeline.process_sample(sample)) {
        if let Some(pose) = score::true_pose_at(&truth, cycle.stamp) {
            let scene = SceneTruth {
                pose,
                objects: objects.get(&cycle.stamp).map(Vec::as_slice),
                occluded_sectors: &[],
            };
            run.add_cycle(&cycle, &setup, &scene);
        }
    }
    Ok(run)
}

fn run_scenario(variant: &ScenarioVariant, seed: u64, preset: &str) -> Result<VisionRun> {
    let scenario = variant.scenario.as_deref().context("no scenario")?;
    let simulation = Simulation::with_overrides(scenario, &variant.set, Some(seed), None)?;
    let setup = simulation.setup()?;
    let config = apply_overlay(&settings(preset)?, variant.config.clone())?;
    let mut pipeline = Pipeline::new(&setup, &config)?;
    let mut run = VisionRun::new(simulation.duration());
    let occlusions = simulation.sim().scenario().occlusions.clone();
    simulation.run(&mut pipeline, |cycle| {
        let Some(truth) = &cycle.inputs.truth else {
            return Ok(interrupt::flow());
        };
        let object = |kind, at, heading| GroundTruthObject {
            kind,
            at,
            heading,
            visible_px: None,
        };
        let ball = truth.ball.map(|at| object(GroundTruthKind::Ball, at, None));
        let robots = truth.robots.iter().zip(&truth.robot_headings);
        let robots =
            robots.map(|(&at, &heading)| object(GroundTruthKind::Robot, at, Some(heading)));
        let people = truth.people.iter();
        let people = people.map(|&at| object(GroundTruthKind::Person, at, None));
        let objects: Vec<GroundTruthObject> =
            ball.into_iter().chain(robots).chain(people).collect();
        let now = cycle.stamp.seconds();
        let active = occlusions
            .iter()
            .filter(|occlusion| occlusion.start <= now && now < occlusion.stop);
        let sectors: Vec<Sector> = active.map(Occlusion::sector).collect();
        let scene = SceneTruth {
            pose: truth.pose,
            objects: Some(&objects),
            occluded_sectors: &sectors,
        };
        run.add_cycle(&cycle, &setup, &scene);
        Ok(interrupt::flow())
    })?;
    Ok(run)
}

/// Ground truth of one cycle.
struct SceneTruth<'a> {
    pose: localize::Pose,
    /// None if the objects are unknown.
    objects: Option<&'a [GroundTruthObject]>,
    /// Covered sectors of the view.
    occluded_sectors: &'a [Sector],
}

impl VisionRun {
    /// An empty run of `duration` seconds.
    fn new(duration: f64) -> Self {
        VisionRun {
            segment_s: SEGMENT_S.min((duration / SEGMENTS_MIN).max(1e-3)),
            start: None,
            segments: Vec::new(),
            times_ms: Vec::new(),
        }
    }

    fn add_cycle(&mut self, cycle: &Cycle, setup: &Setup, truth: &SceneTruth<'_>) {
        let (Some(detections), Some((_, map))) = (&cycle.detections, &setup.camera) else {
            return;
        };
        let first = *self.start.get_or_insert(cycle.stamp);
        let index = ((cycle.stamp - first) / self.segment_s) as usize;
        if self.segments.len() <= index {
            self.segments.resize_with(index + 1, RunSegment::default);
        }
        let RunSegment { frames, counts } = &mut self.segments[index];
        *frames += 1;
        self.times_ms.push(f64::from(cycle.timings.see_ms));
        let scene = GroundTruthScene {
            pose: truth.pose,
            tilt: cycle.estimate.tilt,
            viewpoint_height: setup
                .viewpoint_height
                .unwrap_or(ObjectDetectionConfig::default().viewpoint_height),
            field: &setup.field,
            map,
            occluded_sectors: truth.occluded_sectors,
            objects: truth.objects,
        };
        let mut count = |item: ScoredItem| {
            let bin = (item.range / RANGE_BIN) as usize;
            let [correct, all] = counts.entry((item.kind, bin)).or_default();
            *correct += usize::from(item.correct);
            *all += 1;
        };
        DetectionStatistics::default().add_image_with(detections, &scene, &mut count);
    }
}

fn write_rows(rows: &mut CsvRows, variant: &str, preset: &str, runs: &[&VisionRun]) -> Result<()> {
    let mut sums = DetectionCounts::new();
    for segment in runs.iter().flat_map(|run| &run.segments) {
        for (&key, &[correct, all]) in &segment.counts {
            let sum = sums.entry(key).or_default();
            sum[0] += correct;
            sum[1] += all;
        }
    }
    for ((kind, bin), [correct, all]) in sums {
        let range = bin as f32 * RANGE_BIN;
        let (variant, kind) = (csv_quote(variant), kind_name(kind));
        rows.row(format_args!(
            "{variant},{preset},{kind},{range:.1},{correct},{all}"
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
    let segments: Vec<&RunSegment> = runs.iter().flat_map(|run| &run.segments).collect();
    let within = |kind: ScoredKind, range: f32| -> Vec<(usize, usize)> {
        let last = (range / RANGE_BIN) as usize;
        let sum = |segment: &&RunSegment| {
            let counts = segment.counts.range((kind, 0)..(kind, last));
            counts.fold((0, 0), |sum, (_, count)| {
                (sum.0 + count[0], sum.1 + count[1])
            })
        };
        segments.iter().map(sum).collect()
    };
    // False detections are counted per image.
    let false_detections = |kind, range| -> Vec<(usize, usize)> {
        let counted = within(kind, range).into_iter().zip(&segments);
        counted
            .map(|((_, all), segment)| (all, segment.frames))
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
            false_detections(ScoredKind::FalseBall, f32::MAX),
        ),
        share(robots, within(ScoredKind::Robot, OBJECT_RANGE)),
        share(
            "their edge right to 10 cm, %",
            within(ScoredKind::Edge, OBJECT_RANGE),
        ),
        share(
            "false robots (4 m), per 100 frames",
            false_detections(ScoredKind::FalseRobot, OBJECT_RANGE),
        ),
        Metric::median(variant, method, "time to see, ms", times.collect()),
    ];
    // Without a ball or robot there is no rate.
    figures.retain(|figure| figure.value.is_some());
    figures
}
