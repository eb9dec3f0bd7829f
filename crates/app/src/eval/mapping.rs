//! How true is a field that was mapped from a drive, and how well does the robot know its place on it? Synthetic drives.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use indicatif::ProgressBar;
use localize::Field;
use localize::field_mapping::FieldMappingConfig;
use localize::synthetic::field_mapping::{MappingScore, evaluate_mapping};
use localize::synthetic::rough_drive::RoughDriveConfig;
use rayon::prelude::*;
use serde::Deserialize;

use super::metric::Metric;
use super::output::{CsvRows, csv_quote};

/// Drives past the markings of unknown fields.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MappingRuns {
    /// Circumstances to compare.
    pub variants: Vec<MappingVariant>,
}

/// A field and how it is driven past.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MappingVariant {
    /// Its name in tables.
    pub name: String,
    /// The true field.
    pub field: PathBuf,
    /// Length of the drive, seconds.
    pub seconds: f64,
    /// Radius of each wheel over the configured one.
    #[serde(default = "unequal")]
    pub radius_ratio: [f64; 3],
    /// Standard deviation of the tilt from image to image, degrees.
    #[serde(default)]
    pub tilt_std_deg: f64,
    /// Error of the ground map, as `PointErrors::map_error` states it.
    #[serde(default)]
    pub map_error: f64,
}

fn unequal() -> [f64; 3] {
    [1.03, 1.02, 1.04]
}

/// Images per second: a map needs no more.
const FRAME_RATE: f64 = 15.0;
/// Fastest motion of these drives, m/s and rad/s.
const SPEED_MAX: [f64; 2] = [1.2, 1.0];

/// Runs each variant with each seed.
pub(crate) fn run(
    runs: &MappingRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    bar.set_length(runs.variants.len() as u64 * (seeds.end - seeds.start));
    rows.header(
        "variant,method,seed,marking_error_m,marking_error_max_m,false_share,found_share,\
         position_error_m,position_error_true_field_m,tracked_share",
    )?;
    let seeds: Vec<u64> = seeds.collect();
    let mut figures = Vec::new();
    for variant in &runs.variants {
        ensure!(
            variant.seconds > 0.0 && variant.radius_ratio.iter().all(|ratio| *ratio > 0.0),
            "variant {:?}: seconds and radii must be positive",
            variant.name
        );
        let field = Field::load(&variant.field)?;
        let drive = drive(variant);
        let config = FieldMappingConfig {
            line_width: field.config.line_width,
            ..FieldMappingConfig::default()
        };
        let scores: Vec<(u64, Option<MappingScore>)> = seeds
            .par_iter()
            .map(|&seed| {
                let score = evaluate_mapping(&field, &drive, &config, variant.seconds, seed);
                bar.inc(1);
                (seed, score.ok())
            })
            .collect();
        let number =
            |value: Option<f32>| value.map_or_else(String::new, |value| format!("{value:.5}"));
        for (seed, score) in &scores {
            let Some(score) = score else { continue };
            rows.row(format_args!(
                "{},mapped,{seed},{:.5},{:.5},{:.4},{:.4},{},{},{:.4}",
                csv_quote(&variant.name),
                score.marking_error,
                score.marking_error_max,
                score.false_share,
                score.found_share,
                number(score.position_error),
                number(score.position_error_true_field),
                score.tracked_share
            ))?;
        }
        let mapped: Vec<MappingScore> = scores.iter().filter_map(|(_, score)| *score).collect();
        figures.extend(metrics_of(&variant.name, &mapped, seeds.len()));
    }
    Ok(figures)
}

fn drive(variant: &MappingVariant) -> RoughDriveConfig {
    let mut drive = RoughDriveConfig::blind_with_unequal_wheels();
    drive.blind = None;
    drive.dazzled_outlier_share = 0.0;
    drive.frame_rate = FRAME_RATE;
    drive.speed_max = SPEED_MAX;
    drive.wheels.radius_ratio = variant.radius_ratio;
    drive.points.tilt_std_deg = variant.tilt_std_deg;
    drive.points.map_error = variant.map_error;
    drive
}

fn metrics_of(variant: &str, scores: &[MappingScore], drives: usize) -> Vec<Metric> {
    let values = |get: &dyn Fn(&MappingScore) -> Option<f32>, scale: f64| -> Vec<f64> {
        let found = scores.iter().filter_map(get);
        found.map(|value| scale * f64::from(value)).collect()
    };
    let mean = |name, get: &dyn Fn(&MappingScore) -> Option<f32>, scale| {
        Metric::mean(variant, "mapped", name, &values(get, scale))
    };
    vec![
        Metric::proportion(
            variant,
            "mapped",
            "drives with a map, %",
            scores.len(),
            drives,
        ),
        mean(
            "error of the markings, root mean square, cm",
            &|s| Some(s.marking_error),
            100.0,
        ),
        Metric::maximum(
            variant,
            "mapped",
            "largest error of a marking, cm",
            &values(&|s| Some(s.marking_error_max), 100.0),
        ),
        mean("true markings found, %", &|s| Some(s.found_share), 100.0),
        mean(
            "mapped where nothing is painted, %",
            &|s| Some(s.false_share),
            100.0,
        ),
        mean(
            "squared error over stated variance (1 is honest)",
            &|s| Some(s.normalized_error),
            1.0,
        ),
        mean(
            "position error on the map, cm",
            &|s| s.position_error,
            100.0,
        ),
        mean(
            "position error on the true field, cm",
            &|s| s.position_error_true_field,
            100.0,
        ),
        mean(
            "images located within 0.5 m on the map, %",
            &|s| Some(s.tracked_share),
            100.0,
        ),
    ]
}
