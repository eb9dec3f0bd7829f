//! How accurate is the pose from a single image? Images rendered at known poses, located without history.

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use rayon::prelude::*;

use super::drives::{FrameResult, frame_result};
use super::experiment::Stills;
use super::metric::Metric;
use super::output::CsvRows;
use pipeline::sample::Sample;
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};

/// Position error from which a pose counts as an outlier, metres.
const OUTLIER_DISTANCE: f32 = 0.5;

/// Renders and locates each still; a still's seed counts up from `seed`.
pub(crate) fn run(
    stills: &Stills,
    seed: u64,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let mut jobs = Vec::new();
    for (spot, &at) in stills.spots.iter().enumerate() {
        for &heading in &stills.headings_deg {
            jobs.push((spot, [at[0], at[1], heading], seed + jobs.len() as u64));
        }
    }
    bar.set_length(jobs.len() as u64);
    let results: Vec<Vec<FrameResult>> = jobs
        .par_iter()
        .map(|&(_, place, seed)| {
            let located = locate_still(stills, place, seed);
            bar.inc(1);
            located
        })
        .collect::<Result<_>>()?;
    rows.header(
        "method,spot,seed,true_x_m,true_y_m,true_theta_rad,x_m,y_m,theta_rad,error_x_m,error_y_m,error_theta_rad,mode,line_points",
    )?;
    let mut figures = Vec::new();
    for (index, preset) in stills.presets.iter().enumerate() {
        let mut errors = Vec::new();
        let mut outliers = 0;
        for (&(spot, _, seed), located) in jobs.iter().zip(&results) {
            let row = &located[index];
            let [tx, ty, tt] = row.truth;
            let (mode, points) = (pipeline::result_files::mode_name(row.mode), row.line_points);
            let Some((pose, error)) = row.pose.zip(row.pose_error()) else {
                rows.row(format_args!(
                    "{preset},{spot},{seed},{tx:.5},{ty:.5},{tt:.6},,,,,,,{mode},{points}"
                ))?;
                continue;
            };
            let ([x, y, t], [ex, ey, et]) = (pose, error);
            rows.row(format_args!(
                "{preset},{spot},{seed},{tx:.5},{ty:.5},{tt:.6},{x:.5},{y:.5},{t:.6},{ex:.5},{ey:.5},{et:.6},{mode},{points}"
            ))?;
            if ex.hypot(ey) < OUTLIER_DISTANCE {
                errors.push(error);
            } else {
                outliers += 1;
            }
        }
        figures.extend(metrics_of(preset, &errors, outliers, jobs.len()));
    }
    Ok(figures)
}

/// Renders one image and locates it with each preset; `place`: x, y (metres), heading (degrees).
fn locate_still(stills: &Stills, place: [f32; 3], seed: u64) -> Result<Vec<FrameResult>> {
    let [x, y, theta_deg] = place.map(f64::from);
    let start = toml::toml! { x = x  y = y  theta_deg = theta_deg };
    let set = toml::Table::from_iter([("start".to_owned(), toml::Value::Table(start))]);
    let simulation = Simulation::with_overrides(&stills.scenario, &set, Some(seed), None)?;
    let setup = simulation.setup()?;
    let mut samples: Vec<Sample> = Vec::new();
    for sample in simulation {
        let is_image = matches!(sample, Sample::Image(_));
        samples.push(sample);
        if is_image {
            break;
        }
    }
    stills
        .presets
        .iter()
        .map(|preset| {
            let mut pipeline = Pipeline::new(&setup, &PipelineConfig::preset(preset)?)?;
            let cycle = samples
                .iter()
                .find_map(|sample| pipeline.process_sample(sample.clone()));
            cycle
                .as_ref()
                .and_then(frame_result)
                .context("the scenario ends before its first image")
        })
        .collect()
}

fn metrics_of(preset: &str, errors: &[[f32; 3]], outliers: usize, count: usize) -> Vec<Metric> {
    let values = |axis: usize, scale: f64| -> Vec<f64> {
        errors
            .iter()
            .map(|error| scale * f64::from(error[axis]))
            .collect()
    };
    let degrees = 1f64.to_degrees();
    let (x, y, theta) = (values(0, 100.0), values(1, 100.0), values(2, degrees));
    vec![
        Metric::proportion("", preset, "located, %", errors.len() + outliers, count),
        Metric::proportion("", preset, "within 0.5 m, %", errors.len(), count),
        Metric::mean("", preset, "mean of x, cm", &x),
        Metric::mean("", preset, "mean of y, cm", &y),
        Metric::mean("", preset, "mean of θ, °", &theta),
        Metric::std_dev("", preset, "σ of x, cm", &x),
        Metric::std_dev("", preset, "σ of y, cm", &y),
        Metric::std_dev("", preset, "σ of θ, °", &theta),
    ]
}
