//! How well is the place found? Seeded drives, kidnaps and single frames of line points, scored against truth.

use anyhow::Result;
use localize::synthetic::drive::SyntheticDriveConfig;
use localize::synthetic::evaluation::{
    TrackingScore, evaluate_global_search, evaluate_kidnaps, evaluate_tracking,
};
use localize::{Field, LocalizeConfig};

use super::{Figure, figure};
use pipeline::paths;

/// Figures of `drives`.
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

/// The larger of the mean deviations in x and y, or of the largest ones, centimetres.
fn larger_axis_cm([x, y, _]: [f32; 3]) -> f64 {
    100.0 * f64::from(x.max(y))
}

/// Drives on 18 × 12 m as existing systems were measured on: 30 Hz, σ 3 to 5 cm, odometry biased by 3 %.
pub(super) fn measure_tracking(figures: &mut Vec<Figure>) -> Result<()> {
    let field = Field::load(&paths::find_resource("config/fields/msl_18x12.toml")?)?;
    let config = LocalizeConfig::default();
    let usual = SyntheticDriveConfig::default();
    // Ten minutes, by one robot after another.
    let score = evaluate_tracking(&field, &config, &usual, 0..20, 900);
    figures.extend([
        figure(
            "track_mean",
            larger_axis_cm(score.mean_error),
            "cm",
            "<= 0.7",
        ),
        figure(
            "track_mean_heading",
            f64::from(score.mean_error[2]),
            "degrees",
            "<= 0.12",
        ),
        figure("track_max", larger_axis_cm(score.max_error), "cm", "<= 4"),
        figure(
            "track_max_heading",
            f64::from(score.max_error[2]),
            "degrees",
            "<= 1",
        ),
        figure("track_nees", f64::from(score.nees), "", "about 3"),
        figure(
            "track_false_alarms",
            score.alarms as f64,
            "frames of 17400",
            "0",
        ),
    ]);
    let with = |drive: SyntheticDriveConfig| evaluate_tracking(&field, &config, &drive, 0..5, 900);
    let outliers = with(SyntheticDriveConfig {
        outlier_share: 0.5,
        ..usual.clone()
    });
    let near = with(SyntheticDriveConfig {
        range_max: 3.0,
        ..usual.clone()
    });
    let few = with(SyntheticDriveConfig {
        rays: 40,
        ..usual.clone()
    });
    figures.extend([
        figure(
            "track_half_outliers",
            larger_axis_cm(outliers.mean_error),
            "cm",
            "<= 1.2",
        ),
        figure("track_3_m", larger_axis_cm(near.mean_error), "cm", "<= 2.5"),
        figure(
            "track_3_m_lost",
            near.lost_frames as f64,
            "frames of 4350",
            "0",
        ),
        figure(
            "track_40_rays",
            larger_axis_cm(few.mean_error),
            "cm",
            "<= 1.2",
        ),
    ]);
    let covered = |covered: f32| -> TrackingScore {
        with(SyntheticDriveConfig {
            occluded_share: covered,
            ..usual.clone()
        })
    };
    let [eighth, quarter, half] = [0.125, 0.25, 0.5].map(covered);
    figures.extend([
        figure(
            "occluded_12_mean",
            larger_axis_cm(eighth.mean_error),
            "cm",
            "<= 2",
        ),
        figure(
            "occluded_12_max",
            larger_axis_cm(eighth.max_error),
            "cm",
            "<= 10",
        ),
        figure(
            "occluded_25_mean",
            larger_axis_cm(quarter.mean_error),
            "cm",
            "<= 2",
        ),
        figure(
            "occluded_25_max",
            larger_axis_cm(quarter.max_error),
            "cm",
            "<= 10",
        ),
        figure(
            "occluded_50_mean",
            larger_axis_cm(half.mean_error),
            "cm",
            "<= 2",
        ),
        figure(
            "occluded_50_mean_heading",
            f64::from(half.mean_error[2].to_radians()),
            "rad",
            "<= 0.01",
        ),
        figure(
            "occluded_50_max",
            larger_axis_cm(half.max_error),
            "cm",
            "<= 10",
        ),
    ]);
    measure_global_search(&field, &config, usual, figures);
    Ok(())
}

/// How often a place is found from one frame, and again after the robot was carried off.
fn measure_global_search(
    field: &Field,
    config: &LocalizeConfig,
    usual: SyntheticDriveConfig,
    figures: &mut Vec<Figure>,
) {
    let frames = 1000;
    let percent = |part: usize, of: usize| 100.0 * part as f64 / of as f64;
    let blind = evaluate_global_search(field, config, &usual, false, 1, frames);
    let led = evaluate_global_search(field, config, &usual, true, 1, frames);
    let covered = SyntheticDriveConfig {
        occluded_share: 0.25,
        ..usual
    };
    let carried = evaluate_kidnaps(field, config, &covered, 1, 200);
    figures.extend([
        figure(
            "find_no_prior",
            percent(blind.top_1, frames),
            "%",
            ">= 97.5",
        ),
        figure(
            "find_no_prior_first_five",
            percent(blind.top_5, frames),
            "%",
            ">= 99.5",
        ),
        figure("find_compass", percent(led.top_1, frames), "%", ">= 99.7"),
        figure(
            "kidnap_said",
            percent(carried.detected, carried.kidnaps),
            "%",
            ">= 99",
        ),
        figure(
            "kidnap_back",
            percent(carried.recovered, carried.kidnaps),
            "%",
            ">= 99",
        ),
    ]);
}
