//! What does the exact search prove, and how soon does a robot at an ambiguous place know where it is? Synthetic points.

use std::path::PathBuf;

use anyhow::Result;
use indicatif::ProgressBar;
use localize::synthetic::certainty::{Behaviour, CertaintyExperiment, CertaintyRun, run_certainty};
use localize::synthetic::certificates::{CertificateScore, evaluate_certificates};
use localize::synthetic::drive::SyntheticDriveConfig;
use localize::{Field, LocalizeConfig, Localizer};
use rayon::prelude::*;
use serde::Deserialize;

use super::metric::Metric;
use super::output::{CsvRows, csv_quote};

/// Images at random poses, whose certificates are checked.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CertificateRuns {
    /// The field.
    pub field: PathBuf,
    /// Random poses that are matched to each image to find one that explains more than the certificate allows.
    pub starts: usize,
    /// Circumstances to compare.
    pub variants: Vec<CertificateVariant>,
}

/// Circumstances of certificates.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CertificateVariant {
    /// Its name in tables.
    pub name: String,
    /// Largest range of line points, metres.
    pub range_max: f32,
    /// Blocks opened for the certificate.
    pub blocks: usize,
}

/// Robots at ambiguous places that move in several ways.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CertaintyRuns {
    /// The field.
    pub field: PathBuf,
    /// Speed of the robot, m/s.
    pub speed: f32,
    /// Longest time of a run, seconds.
    pub seconds: f32,
    /// Time for which the robot stands first, seconds.
    pub standing: f32,
    /// The ways of moving.
    pub behaviours: Vec<Behaviour>,
    /// Circumstances to compare.
    pub variants: Vec<CertaintyVariant>,
}

/// Sensors of a robot at an ambiguous place. Missing values are those of `SyntheticDriveConfig`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CertaintyVariant {
    /// Its name in tables.
    pub name: String,
    /// Largest range of line points, metres.
    pub range_max: f32,
    /// Range that the advice expects; that of the line points if left out.
    pub expected_range: Option<f32>,
    /// Share of all directions that is covered.
    pub occluded_share: Option<f32>,
    /// Share of outliers.
    pub outlier_share: Option<f32>,
}

/// Checks the certificates of one image per seed.
pub(crate) fn run_certificates(
    runs: &CertificateRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let field = Field::load(&runs.field)?;
    bar.set_length(runs.variants.len() as u64);
    rows.header(
        "variant,method,seed,answer_share,others_share_max,attained,best_matched_share,right",
    )?;
    let mut figures = Vec::new();
    for variant in &runs.variants {
        let mut config = LocalizeConfig::default();
        config.branch_and_bound.certificate_blocks = variant.blocks;
        let drive = SyntheticDriveConfig {
            range_max: variant.range_max,
            ..SyntheticDriveConfig::default()
        };
        let scores = evaluate_certificates(&field, &config, &drive, seeds.clone(), runs.starts);
        bar.inc(1);
        for score in &scores {
            rows.row(format_args!(
                "{},exact,{},{:.4},{:.4},{},{:.4},{}",
                csv_quote(&variant.name),
                score.seed,
                score.answer_share,
                score.others_share_max,
                u8::from(score.is_attained),
                score.best_matched_share,
                u8::from(score.is_right)
            ))?;
        }
        figures.extend(certificate_metrics(&variant.name, &scores));
    }
    Ok(figures)
}

/// Share of the points by which an answer is clear: more than a pose between those of the grid exceeds the bound.
const CLEAR_MARGIN: f32 = 0.05;

fn certificate_metrics(variant: &str, scores: &[CertificateScore]) -> Vec<Metric> {
    let percent = |get: &dyn Fn(&CertificateScore) -> f32| -> Vec<f64> {
        scores
            .iter()
            .map(|score| 100.0 * f64::from(get(score)))
            .collect()
    };
    let count = |holds: &dyn Fn(&CertificateScore) -> bool| {
        scores.iter().filter(|score| holds(score)).count()
    };
    let share = |name, hits| Metric::proportion(variant, "exact", name, hits, scores.len());
    let clear =
        |score: &CertificateScore| score.others_share_max < score.answer_share - CLEAR_MARGIN;
    let excess = |score: &CertificateScore| score.best_matched_share - score.others_share_max;
    let mut figures = vec![
        Metric::mean(
            variant,
            "exact",
            "the answer explains, %",
            &percent(&|s| s.answer_share),
        ),
        Metric::mean(
            variant,
            "exact",
            "no other pose explains more than, %",
            &percent(&|s| s.others_share_max),
        ),
        share("the bound is attained, %", count(&|s| s.is_attained)),
        share(
            "the bound is 5 % of the points below the answer's share, %",
            count(&clear),
        ),
        Metric::maximum(
            variant,
            "exact",
            "most by which a matched pose exceeds the bound, % of the points",
            &percent(&excess),
        ),
    ];
    let certain = scores.iter().filter(|score| clear(score));
    let right = certain.clone().filter(|score| score.is_right).count();
    figures.push(Metric::proportion(
        variant,
        "exact",
        "right where it is, %",
        right,
        certain.count(),
    ));
    figures
}

/// Runs each behaviour at the same ambiguous places.
pub(crate) fn run_certainty_drives(
    runs: &CertaintyRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let field = Field::load(&runs.field)?;
    let length = runs.variants.len() * runs.behaviours.len();
    bar.set_length(length as u64 * (seeds.end - seeds.start));
    rows.header("variant,method,seed,seconds,way_m,wrong_share")?;
    let seeds: Vec<u64> = seeds.collect();
    let mut figures = Vec::new();
    for variant in &runs.variants {
        let default = SyntheticDriveConfig::default();
        let experiment = CertaintyExperiment {
            drive: SyntheticDriveConfig {
                range_max: variant.range_max,
                occluded_share: variant.occluded_share.unwrap_or(default.occluded_share),
                outlier_share: variant.outlier_share.unwrap_or(default.outlier_share),
                ..default
            },
            speed: runs.speed,
            seconds: runs.seconds,
            standing: runs.standing,
        };
        let mut config = LocalizeConfig::default();
        config.advice.view_range = variant.expected_range.unwrap_or(variant.range_max);
        let base = Localizer::new(&field, config);
        for &behaviour in &runs.behaviours {
            let results: Vec<(u64, CertaintyRun)> = seeds
                .par_iter()
                .filter_map(|&seed| {
                    let run = run_certainty(&field, &base, &experiment, behaviour, seed);
                    bar.inc(1);
                    run.map(|run| (seed, run))
                })
                .collect();
            let method = behaviour_name(behaviour);
            for (seed, run) in &results {
                let seconds = run.seconds.map_or_else(String::new, |s| format!("{s:.3}"));
                rows.row(format_args!(
                    "{},{method},{seed},{seconds},{:.3},{:.4}",
                    csv_quote(&variant.name),
                    run.distance,
                    run.wrong_share
                ))?;
            }
            let runs_alone: Vec<CertaintyRun> = results.iter().map(|(_, run)| *run).collect();
            figures.extend(certainty_metrics(
                &variant.name,
                method,
                &runs_alone,
                f64::from(runs.seconds),
            ));
        }
    }
    Ok(figures)
}

fn behaviour_name(behaviour: Behaviour) -> &'static str {
    match behaviour {
        Behaviour::Stand => "stands",
        Behaviour::Turn => "turns",
        Behaviour::Straight => "drives straight on",
        Behaviour::Random => "drives at random",
        Behaviour::Advice => "follows the advice",
    }
}

fn certainty_metrics(
    variant: &str,
    method: &str,
    runs: &[CertaintyRun],
    limit: f64,
) -> Vec<Metric> {
    let seconds: Vec<f64> = runs
        .iter()
        .map(|run| run.seconds.map_or(limit, f64::from))
        .collect();
    let distances: Vec<f64> = runs.iter().map(|run| f64::from(run.distance)).collect();
    let undecided = runs.iter().filter(|run| run.seconds.is_none()).count();
    let wrong: Vec<f64> = runs
        .iter()
        .map(|run| 100.0 * f64::from(run.wrong_share))
        .collect();
    vec![
        Metric::mean(
            variant,
            method,
            "time until the right pose is tracked for good, s",
            &seconds,
        ),
        Metric::median(variant, method, "median of it, s", seconds.clone()),
        Metric::mean(variant, method, "distance until then, m", &distances),
        Metric::proportion(
            variant,
            method,
            "not right at the end, %",
            undecided,
            runs.len(),
        ),
        Metric::mean(
            variant,
            method,
            "images that track a wrong place, %",
            &wrong,
        ),
    ]
}
