//! How large is the pose error, frame by frame? Simulated drives of each variant, preset and seed, on all cores.

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use localize::estimate::Mode;
use localize::frames::wrap_angle;
use rayon::prelude::*;

use super::experiment::{Drives, ScenarioVariant};
use super::metric::{Metric, PoseTolerance};
use super::output::{CsvRows, csv_quote};
use crate::interrupt;
use pipeline::config::apply_overlay;
use pipeline::result_files::mode_name;
use pipeline::simulation::Simulation;
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Position error from which a tracked pose without a reason for doubt is an undetected failure: metres, and standard deviations of
/// that error as it is stated.
const UNDETECTED_FAILURE_ERROR: f32 = 0.5;
const UNDETECTED_FAILURE_SIGMAS: f32 = 3.0;
/// The name of the figure; its definition stands on the page and in docs/experiments.md.
const SILENTLY_WRONG: &str = "silently wrong, % of frames";
/// A pose within these errors counts as recovered after a kidnap: metres, radians (3°).
const RECOVERED_WITHIN: PoseTolerance = PoseTolerance {
    position: 0.15,
    heading: 0.052,
};

/// Length of the segments that the intervals of proportions are computed from, seconds: most failures are shorter.
const SEGMENT_S: f64 = 5.0;

/// One frame of a drive.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FrameResult {
    /// Seconds after the start.
    pub stamp_s: f64,
    /// True x, y (metres) and heading (radians).
    pub truth: [f32; 3],
    /// Estimated x, y and heading. None while lost.
    pub pose: Option<[f32; 3]>,
    /// Standard deviation of each, from the estimate's covariance.
    pub std: [f32; 3],
    /// Tracking, global, lost.
    pub mode: Mode,
    /// The estimate gives a reason for doubt: too few points, a poor match, a second hypothesis.
    pub doubtful: bool,
    /// Line points.
    pub line_points: usize,
}

/// One drive.
struct DriveRun {
    frames: Vec<FrameResult>,
    /// Times at which the robot was displaced, seconds.
    kidnaps: Vec<f64>,
}

fn run_drive(variant: &ScenarioVariant, preset: &str, seed: u64) -> Result<DriveRun> {
    let scenario = variant.scenario.as_deref().context("no scenario")?;
    let simulation = Simulation::with_overrides(scenario, &variant.set, Some(seed), None)?;
    let setup = simulation.setup()?;
    let config: PipelineConfig =
        apply_overlay(&PipelineConfig::preset(preset)?, variant.config.clone())?;
    let mut pipeline = Pipeline::new(&setup, &config)?;
    let kidnaps = simulation.sim().scenario().kidnaps.iter();
    let kidnaps = kidnaps.map(|kidnap| kidnap.time).collect();
    let mut frames = Vec::new();
    simulation.run(&mut pipeline, |cycle| {
        frames.extend(frame_result(&cycle));
        Ok(interrupt::flow())
    })?;
    Ok(DriveRun { frames, kidnaps })
}

/// The result of a cycle. None if its truth is unknown.
pub(crate) fn frame_result(cycle: &Cycle) -> Option<FrameResult> {
    let truth = cycle.inputs.truth.as_ref()?.pose;
    let estimate = &cycle.estimate;
    let covariance = &estimate.covariance;
    Some(FrameResult {
        stamp_s: cycle.stamp.seconds(),
        truth: [truth.x, truth.y, truth.theta],
        pose: estimate.pose.map(|pose| [pose.x, pose.y, pose.theta]),
        std: [0, 1, 2].map(|k| covariance[(k, k)].max(0.0).sqrt()),
        mode: estimate.mode,
        doubtful: estimate.reason.is_some(),
        line_points: cycle.line_points.len(),
    })
}

impl FrameResult {
    /// Error in x, y (metres) and heading (radians, wrapped). None while lost.
    pub(crate) fn pose_error(&self) -> Option<[f32; 3]> {
        let pose = self.pose?;
        Some([
            pose[0] - self.truth[0],
            pose[1] - self.truth[1],
            wrap_angle(pose[2] - self.truth[2]),
        ])
    }

    /// A place is claimed that is wrong, and nothing says so: neither a reason nor the standard deviation.
    fn is_undetected_failure(&self) -> bool {
        let [std_x, std_y, _] = self.std;
        let stated = UNDETECTED_FAILURE_SIGMAS * std_x.hypot(std_y);
        self.mode == Mode::Tracking
            && !self.doubtful
            && self
                .pose_error()
                .is_some_and(|[x, y, _]| x.hypot(y) >= UNDETECTED_FAILURE_ERROR.max(stated))
    }
}

/// Errors and failures of one drive.
#[derive(Default)]
struct DriveScore {
    mean: [f64; 3],
    std: [f64; 3],
    max: [f64; 3],
    segments: Vec<SegmentCounts>,
    /// Seconds from each kidnap to the recovered pose; infinite without recovery.
    recovery_times: Vec<f64>,
}

/// Numbers of frames in a segment of a drive.
#[derive(Clone, Default)]
struct SegmentCounts {
    lost: usize,
    undetected_failures: usize,
    frames: usize,
}

fn score_drive(run: &DriveRun, settle: f64) -> DriveScore {
    let mut score = DriveScore::default();
    let scored = run.frames.iter().filter(|row| row.stamp_s >= settle);
    let scored: Vec<&FrameResult> = scored.collect();
    let errors: Vec<[f64; 3]> = scored
        .iter()
        .filter_map(|row| row.pose_error())
        .map(|error| error.map(f64::from))
        .collect();
    let count = errors.len().max(1) as f64;
    for axis in 0..3 {
        let values = || errors.iter().map(|error| error[axis]);
        score.mean[axis] = values().map(f64::abs).sum::<f64>() / count;
        let mean = values().sum::<f64>() / count;
        let squares: f64 = values().map(|value| (value - mean).powi(2)).sum();
        score.std[axis] = (squares / count).sqrt();
        score.max[axis] = values().map(f64::abs).fold(0.0, f64::max);
    }
    for row in scored {
        let index = ((row.stamp_s - settle) / SEGMENT_S) as usize;
        if score.segments.len() <= index {
            score.segments.resize(index + 1, SegmentCounts::default());
        }
        let segment = &mut score.segments[index];
        segment.lost += usize::from(row.pose.is_none());
        segment.undetected_failures += usize::from(row.is_undetected_failure());
        segment.frames += 1;
    }
    score.recovery_times = run
        .kidnaps
        .iter()
        .map(|&time| {
            let is_recovered = |row: &&FrameResult| {
                row.stamp_s > time
                    && row
                        .pose_error()
                        .is_some_and(|error| RECOVERED_WITHIN.contains(error))
            };
            run.frames
                .iter()
                .find(is_recovered)
                .map_or(f64::INFINITY, |row| row.stamp_s - time)
        })
        .collect();
    score
}

/// Runs the drives; writes a CSV row for each frame and returns the metrics.
pub(crate) fn run(
    drives: &Drives,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let mut cells: Vec<(&ScenarioVariant, &str)> = Vec::new();
    for variant in &drives.variants {
        cells.extend(
            drives
                .presets
                .iter()
                .map(|preset| (variant, preset.as_str())),
        );
    }
    let jobs: Vec<(usize, u64)> = (0..cells.len())
        .flat_map(|cell| seeds.clone().map(move |seed| (cell, seed)))
        .collect();
    bar.set_length(jobs.len() as u64);
    let runs: Vec<DriveRun> = jobs
        .par_iter()
        .map(|&(cell, seed)| {
            let (variant, preset) = cells[cell];
            let run = run_drive(variant, preset, seed)
                .with_context(|| format!("variant {:?}", variant.name));
            bar.inc(1);
            run
        })
        .collect::<Result<_>>()?;
    let mut scores: Vec<Vec<DriveScore>> = cells.iter().map(|_| Vec::new()).collect();
    rows.header("variant,method,seed,stamp_s,true_x_m,true_y_m,true_theta_rad,x_m,y_m,theta_rad,std_x_m,std_y_m,std_theta_rad,mode,line_points")?;
    for (&(cell, seed), run) in jobs.iter().zip(&runs) {
        let (variant, preset) = cells[cell];
        for row in &run.frames {
            write_row(rows, &variant.name, preset, seed, row)?;
        }
        scores[cell].push(score_drive(run, drives.settle));
    }
    let scored_cells = cells.iter().zip(&scores);
    Ok(scored_cells
        .flat_map(|(&(variant, preset), scores)| metrics_of(&variant.name, preset, scores))
        .collect())
}

fn write_row(
    rows: &mut CsvRows,
    variant: &str,
    preset: &str,
    seed: u64,
    row: &FrameResult,
) -> Result<()> {
    let [tx, ty, tt] = row.truth;
    let pose = row.pose.map_or_else(
        || ",,".to_owned(),
        |[x, y, t]| format!("{x:.5},{y:.5},{t:.6}"),
    );
    let [sx, sy, st] = row.std;
    let (variant, mode) = (csv_quote(variant), mode_name(row.mode));
    rows.row(format_args!(
        "{variant},{preset},{seed},{:.4},{tx:.5},{ty:.5},{tt:.6},{pose},{sx:.5},{sy:.5},{st:.6},{mode},{}",
        row.stamp_s, row.line_points
    ))
}

fn metrics_of(variant: &str, method: &str, scores: &[DriveScore]) -> Vec<Metric> {
    let mean = |name, value: fn(&DriveScore) -> f64| {
        let values: Vec<f64> = scores.iter().map(value).collect();
        Metric::mean(variant, method, name, &values)
    };
    let maximum = |name, value: fn(&DriveScore) -> f64| {
        let runs: Vec<f64> = scores.iter().map(value).collect();
        Metric::maximum(variant, method, name, &runs)
    };
    let segments = |hits: fn(&SegmentCounts) -> usize| -> Vec<(usize, usize)> {
        let segments = scores.iter().flat_map(|score| &score.segments);
        segments
            .map(|counts| (hits(counts), counts.frames))
            .collect()
    };
    let mut figures = vec![
        mean("mean |x|, cm", |score| 100.0 * score.mean[0]),
        mean("mean |y|, cm", |score| 100.0 * score.mean[1]),
        mean("mean |θ|, rad", |score| score.mean[2]),
        mean("σ of x, cm", |score| 100.0 * score.std[0]),
        mean("σ of y, cm", |score| 100.0 * score.std[1]),
        mean("σ of θ, rad", |score| score.std[2]),
        maximum("largest |x|, cm", |score| 100.0 * score.max[0]),
        maximum("largest |y|, cm", |score| 100.0 * score.max[1]),
        maximum("largest |θ|, rad", |score| score.max[2]),
        Metric::clustered_proportion(variant, method, "lost, % of frames", &segments(|s| s.lost)),
        Metric::clustered_proportion(
            variant,
            method,
            SILENTLY_WRONG,
            &segments(|s| s.undetected_failures),
        ),
    ];
    let times: Vec<f64> = scores
        .iter()
        .flat_map(|score| score.recovery_times.clone())
        .collect();
    if !times.is_empty() {
        let recovered: Vec<f64> = times.iter().copied().filter(|s| s.is_finite()).collect();
        figures.push(Metric::proportion(
            variant,
            method,
            "kidnaps found back, %",
            recovered.len(),
            times.len(),
        ));
        figures.push(Metric::mean(
            variant,
            method,
            "found back after, s",
            &recovered,
        ));
    }
    figures
}
