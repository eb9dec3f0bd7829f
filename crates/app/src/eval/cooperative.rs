//! How well do team-mates locate a robot that sees no markings? Synthetic drives, with and without the team.

use std::path::PathBuf;

use anyhow::Result;
use indicatif::ProgressBar;
use localize::Field;
use localize::localizer::CooperativeConfig;
use localize::synthetic::cooperative::{
    CooperativeExperiment, CooperativeScore, cooperative_localizer, evaluate_cooperative,
};
use rayon::prelude::*;
use serde::Deserialize;

use super::metric::Metric;
use super::output::{CsvRows, csv_quote};

/// Error that is wanted of a robot that was blind for 10 s and seen by two mates, metres.
pub(super) const WANTED_ERROR: f64 = 0.10;
/// 95 % of a χ² distribution with two degrees of freedom are below this.
pub(super) const NEES_95: f64 = 5.991;

/// Synthetic drives of a robot without line points among team-mates.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CooperativeRuns {
    /// The field.
    pub field: PathBuf,
    /// Circumstances to compare.
    pub variants: Vec<CooperativeVariant>,
}

/// What the robots do. Missing values are those of `localize::synthetic::cooperative::CooperativeExperiment`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CooperativeVariant {
    /// Its name in tables.
    pub name: String,
    /// Is the pose corrected by team-mates?
    #[serde(default = "yes")]
    pub team: bool,
    /// Number of team-mates near the blind robot.
    pub mates: Option<usize>,
    /// Are they blind too?
    pub mates_blind: Option<bool>,
    /// Team-mates that believe to be elsewhere.
    pub liars: Option<usize>,
    /// How far, metres.
    pub lie: Option<f32>,
    /// Opponents; the first two stay close to the blind robot.
    pub opponents: Option<usize>,
    /// Time for which the errors of the mates' poses last, seconds.
    pub error_time: Option<f32>,
    /// True over stated standard deviation of the mates' poses.
    pub pose_std_factor: Option<f32>,
    /// Delays of messages, seconds.
    pub delays: Option<[f32; 2]>,
    /// Largest error of a mate's clock, seconds.
    pub clock_error: Option<f32>,
    /// Share of lost messages.
    pub loss: Option<f32>,
    /// Images between two messages, at 30 images per second.
    pub images_per_message: Option<usize>,
    /// Does the blind robot see other robots?
    pub sees_robots: Option<bool>,
    /// Seconds without line points.
    pub blind: Option<f64>,
}

fn yes() -> bool {
    true
}

/// Runs each variant with each seed.
pub(crate) fn run(
    runs: &CooperativeRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    bar.set_length(runs.variants.len() as u64 * (seeds.end - seeds.start));
    rows.header("variant,method,seed,robot,error_m")?;
    let field = Field::load(&runs.field)?;
    let localizer = cooperative_localizer(&field);
    let seeds: Vec<u64> = seeds.collect();
    let mut figures = Vec::new();
    for variant in &runs.variants {
        let trial = experiment(variant);
        let scores: Vec<CooperativeScore> = seeds
            .par_iter()
            .map(|&seed| {
                let score = evaluate_cooperative(&field, &localizer, seed, &trial);
                bar.inc(1);
                score
            })
            .collect();
        let method = if variant.team { "team" } else { "alone" };
        let name = csv_quote(&variant.name);
        for (seed, score) in seeds.iter().zip(&scores) {
            if let Some(error) = score.position_error {
                rows.row(format_args!("{name},{method},{seed},1,{error:.5}"))?;
            }
        }
        figures.extend(metrics_of(&variant.name, method, &scores));
    }
    Ok(figures)
}

fn experiment(variant: &CooperativeVariant) -> CooperativeExperiment {
    let default = CooperativeExperiment::default();
    CooperativeExperiment {
        mates: variant.mates.unwrap_or(default.mates).min(8),
        mates_blind: variant.mates_blind.unwrap_or(default.mates_blind),
        liars: variant.liars.unwrap_or(default.liars),
        lie: variant.lie.unwrap_or(default.lie),
        opponents: variant.opponents.unwrap_or(default.opponents).min(8),
        error_time: variant.error_time.unwrap_or(default.error_time),
        pose_std_factor: variant.pose_std_factor.unwrap_or(default.pose_std_factor),
        delays: variant.delays.unwrap_or(default.delays),
        clock_error: variant.clock_error.unwrap_or(default.clock_error),
        loss: variant.loss.unwrap_or(default.loss),
        images_per_message: variant
            .images_per_message
            .unwrap_or(default.images_per_message),
        sees_robots: variant.sees_robots.unwrap_or(default.sees_robots),
        blind: variant.blind.unwrap_or(default.blind),
        config: CooperativeConfig {
            enabled: variant.team,
            ..default.config
        },
        ..default
    }
}

fn metrics_of(variant: &str, method: &str, scores: &[CooperativeScore]) -> Vec<Metric> {
    let values = |get: fn(&CooperativeScore) -> Option<f64>, scale: f64| -> Vec<f64> {
        let values = scores.iter().filter_map(get);
        values.map(|value| scale * value).collect()
    };
    let errors = values(|score| score.position_error, 100.0);
    let within = |error: &&f64| **error <= 100.0 * WANTED_ERROR;
    let near = errors.iter().filter(within).count();
    let covered = scores.iter().filter_map(|score| score.nees);
    let covered = covered.filter(|nees| *nees <= NEES_95).count();
    let mean = |name: &'static str, values: &[f64]| Metric::mean(variant, method, name, values);
    let share = |name: &'static str, hits: usize, count: usize| {
        Metric::proportion(variant, method, name, hits, count)
    };
    let mut figures = vec![
        mean("error of the position in the last second, cm", &errors),
        mean(
            "stated standard deviation, cm",
            &values(|score| score.stated_std, 100.0),
        ),
        mean(
            "NEES of the position (2 is honest)",
            &values(|score| score.nees, 1.0),
        ),
        mean(
            "error of the heading, °",
            &values(|score| score.heading_error.map(f64::to_degrees), 1.0),
        ),
    ];
    figures.retain(|figure| figure.value.is_some());
    figures.push(share("drives within 10 cm, %", near, scores.len()));
    figures.push(share(
        "drives whose mean NEES is below the 95 % bound, %",
        covered,
        errors.len(),
    ));
    figures
}
