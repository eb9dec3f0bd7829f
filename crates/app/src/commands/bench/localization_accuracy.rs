//! How accurate is localization? Seeded drives, kidnaps and single sets of line points, scored against truth.

use anyhow::Result;
use localize::synthetic::drive::SyntheticDriveConfig;
use localize::synthetic::evaluation::{
    TrackingScore, evaluate_global_search, evaluate_kidnaps, evaluate_tracking,
};
use localize::{Field, LocalizeConfig};

use super::measure::{BenchFigure, Figures};
use pipeline::paths;

/// Figures of `measure_tracking`.
pub(super) const DRIVES: &[&str] = &[
    "track_mean",
    "track_mean_heading",
    "track_max",
    "track_max_heading",
    "track_nees",
    "track_false_alarms",
    "track_half_outliers",
    "track_3_m",
    "track_3_m_lost",
    "track_40_rays",
    "occluded_12_mean",
    "occluded_12_max",
    "occluded_25_mean",
    "occluded_25_max",
    "occluded_50_mean",
    "occluded_50_mean_heading",
    "occluded_50_max",
    "find_no_prior",
    "find_no_prior_first_five",
    "find_compass",
    "kidnap_said",
    "kidnap_back",
];

/// The larger of the errors in x and y, centimetres.
fn larger_axis_cm([x, y, _]: [f32; 3]) -> f64 {
    100.0 * f64::from(x.max(y))
}

/// Drives on 18 × 12 m with the noise that published systems were measured with: 30 Hz, σ 3 to 5 cm, odometry biased by 3 %.
pub(super) fn measure_tracking(figures: &mut Figures) -> Result<()> {
    let field = Field::load(&paths::find_resource("config/fields/msl_18x12.toml")?)?;
    let config = LocalizeConfig::default();
    let usual = SyntheticDriveConfig::default();
    // Ten minutes in all: 20 drives of 30 s.
    let score = evaluate_tracking(&field, &config, &usual, 0..20, 900);
    figures.extend([
        BenchFigure::new(
            "track_mean",
            larger_axis_cm(score.mean_error),
            "cm",
            "<= 0.7",
        ),
        BenchFigure::new(
            "track_mean_heading",
            f64::from(score.mean_error[2]),
            "degrees",
            "<= 0.12",
        ),
        BenchFigure::new("track_max", larger_axis_cm(score.max_error), "cm", "<= 4"),
        BenchFigure::new(
            "track_max_heading",
            f64::from(score.max_error[2]),
            "degrees",
            "<= 1",
        ),
        BenchFigure::new("track_nees", f64::from(score.nees), "", "about 3"),
        BenchFigure::new(
            "track_false_alarms",
            score.alarms as f64,
            "frames of 17400",
            "0",
        ),
    ]);
    let evaluate =
        |drive: SyntheticDriveConfig| evaluate_tracking(&field, &config, &drive, 0..5, 900);
    let outliers = evaluate(SyntheticDriveConfig {
        outlier_share: 0.5,
        ..usual.clone()
    });
    let short_range = evaluate(SyntheticDriveConfig {
        range_max: 3.0,
        ..usual.clone()
    });
    let few_rays = evaluate(SyntheticDriveConfig {
        rays: 40,
        ..usual.clone()
    });
    figures.extend([
        BenchFigure::new(
            "track_half_outliers",
            larger_axis_cm(outliers.mean_error),
            "cm",
            "<= 1.2",
        ),
        BenchFigure::new(
            "track_3_m",
            larger_axis_cm(short_range.mean_error),
            "cm",
            "<= 2.5",
        ),
        BenchFigure::new(
            "track_3_m_lost",
            short_range.lost_frames as f64,
            "frames of 4350",
            "0",
        ),
        BenchFigure::new(
            "track_40_rays",
            larger_axis_cm(few_rays.mean_error),
            "cm",
            "<= 1.2",
        ),
    ]);
    measure_occlusion(&field, &config, &usual, figures);
    measure_global_search(&field, &config, usual, figures);
    Ok(())
}

/// Tracking accuracy with an eighth, a quarter and half of the directions covered.
fn measure_occlusion(
    field: &Field,
    config: &LocalizeConfig,
    usual: &SyntheticDriveConfig,
    figures: &mut Figures,
) {
    let occluded = |occluded_share: f32| -> TrackingScore {
        let drive = SyntheticDriveConfig {
            occluded_share,
            ..usual.clone()
        };
        evaluate_tracking(field, config, &drive, 0..5, 900)
    };
    let [eighth, quarter, half] = [0.125, 0.25, 0.5].map(occluded);
    figures.extend([
        BenchFigure::new(
            "occluded_12_mean",
            larger_axis_cm(eighth.mean_error),
            "cm",
            "<= 2",
        ),
        BenchFigure::new(
            "occluded_12_max",
            larger_axis_cm(eighth.max_error),
            "cm",
            "<= 10",
        ),
        BenchFigure::new(
            "occluded_25_mean",
            larger_axis_cm(quarter.mean_error),
            "cm",
            "<= 2",
        ),
        BenchFigure::new(
            "occluded_25_max",
            larger_axis_cm(quarter.max_error),
            "cm",
            "<= 10",
        ),
        BenchFigure::new(
            "occluded_50_mean",
            larger_axis_cm(half.mean_error),
            "cm",
            "<= 2",
        ),
        BenchFigure::new(
            "occluded_50_mean_heading",
            f64::from(half.mean_error[2].to_radians()),
            "rad",
            "<= 0.01",
        ),
        BenchFigure::new(
            "occluded_50_max",
            larger_axis_cm(half.max_error),
            "cm",
            "<= 10",
        ),
    ]);
}

/// Success rates of the global search from one set of line points, and of the recovery from kidnaps.
fn measure_global_search(
    field: &Field,
    config: &LocalizeConfig,
    usual: SyntheticDriveConfig,
    figures: &mut Figures,
) {
    let frames = 1000;
    let percent = |part: usize, total: usize| 100.0 * part as f64 / total as f64;
    let no_prior = evaluate_global_search(field, config, &usual, false, 1, frames);
    let with_compass = evaluate_global_search(field, config, &usual, true, 1, frames);
    let occluded = SyntheticDriveConfig {
        occluded_share: 0.25,
        ..usual
    };
    let kidnaps = evaluate_kidnaps(field, config, &occluded, 1, 200);
    figures.extend([
        BenchFigure::new(
            "find_no_prior",
            percent(no_prior.top_1, frames),
            "%",
            ">= 97.5",
        ),
        BenchFigure::new(
            "find_no_prior_first_five",
            percent(no_prior.top_5, frames),
            "%",
            ">= 99.5",
        ),
        BenchFigure::new(
            "find_compass",
            percent(with_compass.top_1, frames),
            "%",
            ">= 99.7",
        ),
        BenchFigure::new(
            "kidnap_said",
            percent(kidnaps.detected, kidnaps.kidnaps),
            "%",
            ">= 99",
        ),
        BenchFigure::new(
            "kidnap_back",
            percent(kidnaps.recovered, kidnaps.kidnaps),
            "%",
            ">= 99",
        ),
    ]);
}
