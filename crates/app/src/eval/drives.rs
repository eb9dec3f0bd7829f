//! How far from the truth, frame by frame? Simulated drives under each variant, preset and seed, all cores at once.

use crate::interrupt;
use std::path::Path;

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use localize::estimate::Mode;
use localize::frames::wrap_angle;
use rayon::prelude::*;

use super::experiment::{Drives, Variant};
use super::metric::Metric;
use super::output::{CsvRows, csv_quote};
use pipeline::config::apply_overlay;
use pipeline::result_files::mode_name;
use pipeline::simulation::Simulation;
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// A pose this far off while called tracked, with no reason for doubt, is silently wrong, metres.
const UNDETECTED_FAILURE_ERROR: f32 = 0.5;
/// A pose this near is right again after a kidnap, metres and radians (3°).
const RECOVERED_WITHIN: (f32, f32) = (0.15, 0.052);

/// Drives are cut into pieces this long for the intervals of shares, seconds: what goes wrong lasts for less, mostly.
const SEGMENT_S: f64 = 5.0;

/// One frame of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameResult {
    /// Seconds after the start.
    pub stamp_s: f64,
    /// True x, y (metres) and heading (radians).
    pub truth: [f32; 3],
    /// The same as estimated; none while lost.
    pub pose: Option<[f32; 3]>,
    /// One standard deviation of each, as the estimate says.
    pub std: [f32; 3],
    /// Tracking, global, lost.
    pub mode: Mode,
    /// A tracked pose's reason for doubt is said: too few points, a poor match, a rival.
    pub doubtful: bool,
    /// Line points.
    pub line_points: usize,
    /// Image to features and features to pose, milliseconds; what differs from run to run.
    pub times_ms: [f32; 2],
}

/// One drive to run.
pub struct DriveJob<'a> {
    /// The scenario's file.
    pub scenario: &'a Path,
    /// Values in place of the scenario's.
    pub set: &'a toml::Table,
    /// Settings by name.
    pub preset: &'a str,
    /// Values in place of the preset's.
    pub config: &'a toml::Table,
    /// In place of the scenario's.
    pub seed: Option<u64>,
    /// In place of the scenario's, seconds.
    pub duration: Option<f64>,
}

/// Drives once; with every frame's row, when the robot was carried away (seconds).
pub fn run_drive(job: &DriveJob<'_>) -> Result<(Vec<FrameResult>, Vec<f64>)> {
    let simulation = Simulation::with_overrides(job.scenario, job.set, job.seed, job.duration)?;
    let setup = simulation.setup()?;
    let config: PipelineConfig =
        apply_overlay(&PipelineConfig::preset(job.preset)?, job.config.clone())?;
    let mut spine = Pipeline::new(&setup, &config)?;
    let kidnaps = simulation.sim().scenario().kidnaps.iter();
    let kidnaps = kidnaps.map(|kidnap| kidnap.time).collect();
    let mut rows = Vec::new();
    simulation.run(&mut spine, |cycle| {
        rows.extend(frame_result(&cycle));
        Ok(interrupt::flow())
    })?;
    Ok((rows, kidnaps))
}

/// What is kept of a cycle whose truth is known.
pub fn frame_result(cycle: &Cycle) -> Option<FrameResult> {
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
        times_ms: [cycle.timings.see_ms, cycle.timings.localize_ms],
    })
}

impl FrameResult {
    /// Error in x, y (metres) and heading (radians, on the circle).
    pub fn pose_error(&self) -> Option<[f32; 3]> {
        let pose = self.pose?;
        Some([
            pose[0] - self.truth[0],
            pose[1] - self.truth[1],
            wrap_angle(pose[2] - self.truth[2]),
        ])
    }
}

/// What one run came to.
#[derive(Default)]
struct DriveScore {
    mean: [f64; 3],
    std: [f64; 3],
    max: [f64; 3],
    /// Frames lost, silently wrong, and all, in each piece of the run.
    segments: Vec<[usize; 3]>,
    /// Seconds from each kidnap to the right pose; infinite where it never came.
    recovery_times: Vec<f64>,
}

fn score_drive(rows: &[FrameResult], kidnaps: &[f64], settle: f64) -> DriveScore {
    let mut score = DriveScore::default();
    let scored: Vec<&FrameResult> = rows.iter().filter(|row| row.stamp_s >= settle).collect();
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
    let silently = |row: &FrameResult| {
        row.mode == Mode::Tracking
            && !row.doubtful
            && row
                .pose_error()
                .is_some_and(|e| e[0].hypot(e[1]) >= UNDETECTED_FAILURE_ERROR)
    };
    for row in scored {
        let piece = ((row.stamp_s - settle) / SEGMENT_S) as usize;
        if score.segments.len() <= piece {
            score.segments.resize(piece + 1, [0; 3]);
        }
        let [lost, wrong, all] = &mut score.segments[piece];
        *lost += usize::from(row.pose.is_none());
        *wrong += usize::from(silently(row));
        *all += 1;
    }
    score.recovery_times = kidnaps
        .iter()
        .map(|&time| {
            let right = |row: &&FrameResult| {
                row.stamp_s > time
                    && row.pose_error().is_some_and(|e| {
                        e[0].hypot(e[1]) < RECOVERED_WITHIN.0 && e[2].abs() < RECOVERED_WITHIN.1
                    })
            };
            rows.iter()
                .find(right)
                .map_or(f64::INFINITY, |row| row.stamp_s - time)
        })
        .collect();
    score
}

/// Runs all of it; rows to CSV, figures back.
pub fn run(
    drives: &Drives,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let mut cells: Vec<(&Variant, &str)> = Vec::new();
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
    let runs: Vec<(Vec<FrameResult>, Vec<f64>)> = jobs
        .par_iter()
        .map(|&(cell, seed)| {
            let (variant, preset) = cells[cell];
            let scenario = variant.scenario.as_deref().context("no scenario")?;
            let done = run_drive(&DriveJob {
                scenario,
                set: &variant.set,
                preset,
                config: &variant.config,
                seed: Some(seed),
                duration: None,
            })
            .with_context(|| format!("variant {:?}", variant.name));
            bar.inc(1);
            done
        })
        .collect::<Result<_>>()?;
    let mut scores: Vec<Vec<DriveScore>> = cells.iter().map(|_| Vec::new()).collect();
    rows.header("variant,method,seed,stamp_s,true_x_m,true_y_m,true_theta_rad,x_m,y_m,theta_rad,std_x_m,std_y_m,std_theta_rad,mode,line_points")?;
    for (&(cell, seed), (drove, kidnaps)) in jobs.iter().zip(&runs) {
        let (variant, preset) = cells[cell];
        for row in drove {
            write_row(rows, &variant.name, preset, seed, row)?;
        }
        scores[cell].push(score_drive(drove, kidnaps, drives.settle));
    }
    let figures = cells.iter().zip(&scores);
    Ok(figures
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
    let each = |name, value: fn(&DriveScore) -> f64| {
        let values: Vec<f64> = scores.iter().map(value).collect();
        Metric::mean(variant, method, name, &values)
    };
    let largest = |name, value: fn(&DriveScore) -> f64| {
        let runs: Vec<f64> = scores.iter().map(value).collect();
        Metric::maximum(variant, method, name, &runs)
    };
    let pieces = |which: usize| -> Vec<(usize, usize)> {
        let pieces = scores.iter().flat_map(|score| &score.segments);
        pieces.map(|piece| (piece[which], piece[2])).collect()
    };
    let mut figures = vec![
        each("mean |x|, cm", |score| 100.0 * score.mean[0]),
        each("mean |y|, cm", |score| 100.0 * score.mean[1]),
        each("mean |θ|, rad", |score| score.mean[2]),
        each("σ of x, cm", |score| 100.0 * score.std[0]),
        each("σ of y, cm", |score| 100.0 * score.std[1]),
        each("σ of θ, rad", |score| score.std[2]),
        largest("largest |x|, cm", |score| 100.0 * score.max[0]),
        largest("largest |y|, cm", |score| 100.0 * score.max[1]),
        largest("largest |θ|, rad", |score| score.max[2]),
        Metric::clustered_proportion(variant, method, "lost, % of frames", &pieces(0)),
        Metric::clustered_proportion(variant, method, "silently wrong, % of frames", &pieces(1)),
    ];
    let back: Vec<f64> = scores
        .iter()
        .flat_map(|score| score.recovery_times.clone())
        .collect();
    if !back.is_empty() {
        let found: Vec<f64> = back.iter().copied().filter(|s| s.is_finite()).collect();
        figures.push(Metric::proportion(
            variant,
            method,
            "kidnaps found back, %",
            found.len(),
            back.len(),
        ));
        figures.push(Metric::mean(variant, method, "found back after, s", &found));
    }
    figures
}
