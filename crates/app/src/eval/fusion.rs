//! Which estimator is most accurate? Every course with every seed, each estimator on the same samples.

use anyhow::Result;
use indicatif::ProgressBar;
use localize::Field;
use localize::robot::RobotConfig;
use rayon::prelude::*;
use serde::Serialize;
use sim::fusion_experiment::{Disturbance, Estimator, FusionExperiment, FusionScore};

use super::experiment::FusionRuns;
use super::metric::Metric;
use super::output::CsvRows;

/// Runs the drives. Writes a CSV row for each course, seed and estimator; returns the metrics over the seeds.
pub(crate) fn run(
    fusion: &FusionRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let robot = RobotConfig::load(&fusion.robot)?;
    let field = Field::load(&robot.field)?;
    let courses = selected_or_all(&fusion.courses, &Disturbance::ALL);
    let estimators = selected_or_all(&fusion.estimators, &Estimator::ALL);
    let jobs: Vec<(Disturbance, u64)> = courses
        .iter()
        .flat_map(|&course| seeds.clone().map(move |seed| (course, seed)))
        .collect();
    bar.set_length(jobs.len() as u64);
    let scores: Vec<Vec<FusionScore>> = jobs
        .par_iter()
        .map(|&(course, seed)| {
            let experiment = FusionExperiment {
                seeds: seed..seed + 1,
                duration: fusion.duration,
                disturbances: vec![course],
                estimators: estimators.clone(),
                ..FusionExperiment::default()
            };
            let rows = experiment.run(&robot, &field);
            bar.inc(1);
            Ok(rows?)
        })
        .collect::<Result<_>>()?;
    rows.header("variant,method,seed,frames,position_m,position_max_m,heading_deg,blind_m,after_hit_m,along_m,nees,nees_inside,searched,latency_s,nees_blind,nees_blind_along,nees_blind_across,nees_blind_heading")?;
    for (&(_, seed), job_scores) in jobs.iter().zip(&scores) {
        for row in job_scores {
            write_row(rows, seed, row)?;
        }
    }
    let all: Vec<&FusionScore> = scores.iter().flatten().collect();
    let cells = courses
        .iter()
        .flat_map(|&course| estimators.iter().map(move |&estimator| (course, estimator)));
    Ok(cells
        .flat_map(|(course, estimator)| {
            let rows = all.iter().copied();
            let rows = rows.filter(|row| row.disturbance == course && row.estimator == estimator);
            metrics_of(
                &snake_case_name(&course),
                &snake_case_name(&estimator),
                &rows.collect::<Vec<_>>(),
            )
        })
        .collect())
}

fn write_row(rows: &mut CsvRows, seed: u64, row: &FusionScore) -> Result<()> {
    let cell = |value: Option<f32>| value.map_or_else(String::new, |value| format!("{value:.5}"));
    let direction = |k: usize| row.nees_blind_by_direction.map(|all| all[k]);
    rows.row(format_args!(
        "{},{},{seed},{},{:.5},{:.5},{:.5},{},{},{:.5},{:.4},{:.4},{},{:.5},{},{},{},{}",
        snake_case_name(&row.disturbance),
        snake_case_name(&row.estimator),
        row.frames,
        row.position,
        row.position_max,
        row.heading_deg,
        cell(row.blind),
        cell(row.after_hit),
        row.along,
        row.nees,
        row.nees_inside,
        row.searched,
        row.latency,
        cell(row.nees_blind),
        cell(direction(0)),
        cell(direction(1)),
        cell(direction(2))
    ))
}

fn metrics_of(variant: &str, method: &str, rows: &[&FusionScore]) -> Vec<Metric> {
    let values = |get: fn(&FusionScore) -> Option<f32>| -> Vec<f64> {
        rows.iter()
            .filter_map(|row| get(row))
            .map(f64::from)
            .collect()
    };
    let mean = |name: &'static str, get: fn(&FusionScore) -> Option<f32>| {
        Metric::mean(variant, method, name, &values(get))
    };
    let mut figures = vec![
        mean("mean position, cm", |row| Some(100.0 * row.position)),
        Metric::maximum(
            variant,
            method,
            "largest position, cm",
            &values(|row| Some(100.0 * row.position_max)),
        ),
        mean("mean heading, °", |row| Some(row.heading_deg)),
        mean("after 2 s blind, cm", |row| row.blind.map(|m| 100.0 * m)),
        mean("in the second after a hit, cm", |row| {
            row.after_hit.map(|m| 100.0 * m)
        }),
        mean("along-track error, cm", |row| Some(100.0 * row.along)),
        // Wheel odometry alone gives no covariance.
        mean("NEES (3 is honest)", |row| {
            (row.nees > 0.0).then_some(row.nees)
        }),
        mean("NEES while blind (3 is honest)", |row| row.nees_blind),
        mean("along-track share of it (1 is honest)", |row| {
            row.nees_blind_by_direction.map(|all| all[0])
        }),
        mean("cross-track share of it (1 is honest)", |row| {
            row.nees_blind_by_direction.map(|all| all[1])
        }),
        mean("heading share of it (1 is honest)", |row| {
            row.nees_blind_by_direction.map(|all| all[2])
        }),
        mean("inside the 95 % band, %", |row| {
            (row.nees > 0.0).then_some(100.0 * row.nees_inside)
        }),
        mean("searched or lost, % of frames", |row| {
            (row.frames > 0).then(|| 100.0 * row.searched as f32 / row.frames as f32)
        }),
        mean("scale off at the end, %", |row| {
            row.scale_off.map(|share| 100.0 * share)
        }),
        mean("latency believed, ms", |row| Some(1e3 * row.latency)),
    ];
    figures.retain(|figure| figure.value.is_some());
    figures
}

fn selected_or_all<T: Copy>(selected: &[T], all: &[T]) -> Vec<T> {
    if selected.is_empty() { all } else { selected }.to_vec()
}

/// The variant's name in files.
fn snake_case_name<T: Serialize>(variant: &T) -> String {
    let value = serde_json::to_value(variant).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}
