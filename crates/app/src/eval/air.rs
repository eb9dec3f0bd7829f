//! How soon and how well is a ball in the air known? Synthetic flights, one robot over time and several together.

use anyhow::Result;
use indicatif::ProgressBar;
use localize::synthetic::air_ball::{AirExperiment, AirScore, BallMotion, evaluate_air_ball};
use rayon::prelude::*;
use serde::Deserialize;

use super::metric::Metric;
use super::output::{CsvRows, csv_quote};

/// Synthetic flights.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AirRuns {
    /// Circumstances to compare.
    pub variants: Vec<AirVariant>,
}

/// How the ball moves and who sees it. Missing values are those of `localize::synthetic::air_ball::AirExperiment`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AirVariant {
    /// Its name in tables.
    pub name: String,
    /// How the ball moves.
    pub motion: BallMotion,
    /// Number of robots.
    #[serde(default = "one")]
    pub robots: usize,
    /// Robots whose directions are wrong.
    #[serde(default)]
    pub liars: usize,
    /// Standard deviation of a direction, degrees.
    pub ray_std_deg: Option<f32>,
    /// Share of directions that are wrong.
    pub outlier_share: Option<f32>,
    /// Speed of kicks, m/s.
    pub speed: Option<f64>,
    /// Does the apparent size measure the distance?
    pub sized: Option<bool>,
    /// Time for which errors of tilt and pose last, seconds.
    pub error_time: Option<f64>,
}

fn one() -> usize {
    1
}

/// Runs each variant with each seed.
pub(crate) fn run(
    air: &AirRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    bar.set_length(air.variants.len() as u64 * (seeds.end - seeds.start));
    rows.header("variant,method,seed,robot,error_m")?;
    let seeds: Vec<u64> = seeds.collect();
    let mut figures = Vec::new();
    for variant in &air.variants {
        let trial = experiment(variant);
        let runs: Vec<AirScore> = seeds
            .par_iter()
            .map(|&seed| {
                let score = evaluate_air_ball(seed, &trial);
                bar.inc(1);
                score
            })
            .collect();
        let method = match trial.robots {
            1 => "one robot".to_owned(),
            robots => format!("{robots} robots"),
        };
        let name = csv_quote(&variant.name);
        for (seed, run) in seeds.iter().zip(&runs) {
            if let Some(error) = run.error() {
                rows.row(format_args!("{name},{method},{seed},,{error:.5}"))?;
            }
        }
        figures.extend(metrics_of(&variant.name, &method, &runs));
    }
    Ok(figures)
}

fn experiment(variant: &AirVariant) -> AirExperiment {
    let default = AirExperiment::default();
    AirExperiment {
        motion: variant.motion,
        robots: variant.robots.clamp(1, 8),
        faulty_robots: variant.liars,
        ray_std_deg: variant.ray_std_deg.unwrap_or(default.ray_std_deg),
        outlier_share: variant.outlier_share.unwrap_or(default.outlier_share),
        speed: variant.speed.unwrap_or(default.speed),
        sized: variant.sized.unwrap_or(default.sized),
        error_time: variant.error_time.unwrap_or(default.error_time),
    }
}

fn metrics_of(variant: &str, method: &str, runs: &[AirScore]) -> Vec<Metric> {
    let values = |get: fn(&AirScore) -> Option<f64>, scale: f64| -> Vec<f64> {
        runs.iter()
            .filter_map(get)
            .map(|value| scale * value)
            .collect()
    };
    let shares = |name: &'static str, count: fn(&AirScore) -> (usize, usize)| {
        let clusters: Vec<(usize, usize)> =
            runs.iter().map(count).filter(|pair| pair.1 > 0).collect();
        (!clusters.is_empty())
            .then(|| Metric::clustered_proportion(variant, method, name, &clusters))
    };
    let mut figures = vec![
        Metric::mean(
            variant,
            method,
            "error in the air, cm",
            &values(AirScore::error, 100.0),
        ),
        Metric::mean(
            variant,
            method,
            "NEES (3 is honest)",
            &values(AirScore::nees, 1.0),
        ),
        Metric::mean(
            variant,
            method,
            "error of the landing point 0.25 s ahead or more, cm",
            &values(AirScore::landing_error, 100.0),
        ),
    ];
    figures.retain(|figure| figure.value.is_some());
    figures.extend(shares("errors within the 95 % ellipsoid, %", |run| {
        (run.covered, run.errors)
    }));
    figures.extend(shares("images in the air called so, %", |run| {
        (run.airborne_found, run.airborne)
    }));
    figures.extend(shares("images on the ground called in the air, %", |run| {
        (run.false_alarms, run.on_ground)
    }));
    figures.extend(shares(
        "images with a place off by 0.5 m and 3 standard deviations, %",
        |run| (run.misplaced, run.images),
    ));
    figures.extend(shares(
        "images in which the wrong robot alone is named, %",
        |run| (run.faulty_named, run.faulty_images),
    ));
    figures
}
