//! What do the cost functions look like around the true pose? One set of line points, over all positions and over headings.

use anyhow::{Result, ensure};
use indicatif::ProgressBar;
use localize::global_search::heading_histogram::{
    HeadingHistogramConfig, histogram_heading, histogram_peak,
};
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::{DistanceField, Field, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::experiment::Landscape;
use super::metric::Metric;
use super::output::CsvRows;
use pipeline::PipelineConfig;

/// Mean error of all points (minho2016 eq. 5 on the distance to the nearest marking) at each position, and the height of
/// the histograms' peaks (minho2016 V.B) at each heading. Both go into one file; column `layer` names the function.
pub(crate) fn run(
    landscape: &Landscape,
    seed: u64,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let Landscape { step, reach, .. } = *landscape;
    ensure!(
        step > 0.0 && reach > 0.0,
        "invalid step or reach: {step}, {reach} (expected above 0)"
    );
    let field = Field::load(&landscape.field)?;
    let distances = DistanceField::new(&field, &PipelineConfig::default().localize.distance_field);
    let [x, y, theta_deg] = landscape.pose;
    let truth = Pose::new(x, y, theta_deg.to_radians());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let points = simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng);
    let (sin, cos) = truth.theta.sin_cos();
    let rotated: Vec<[f32; 2]> = points
        .iter()
        .map(|point| {
            let (x, y) = (point.at.x, point.at.y);
            [cos * x - sin * y, sin * x + cos * y]
        })
        .collect();
    let error = |x: f32, y: f32| -> f32 {
        let errors = rotated.iter().map(|[px, py]| {
            let d = distances.nearest(x + px, y + py).signed_distance;
            1.0 - reach * reach / (reach * reach + d * d)
        });
        errors.sum::<f32>() / rotated.len().max(1) as f32
    };
    let (half_x, half_y) = field.carpet_half_extent();
    let (columns, lines) = (
        (2.0 * half_x / step) as usize,
        (2.0 * half_y / step) as usize,
    );
    bar.set_length(lines as u64);
    rows.header("layer,x_m,y_m,theta_rad,value")?;
    let mut best = (f32::MAX, 0.0, 0.0);
    for line in 0..=lines {
        let cell_y = -half_y + line as f32 * step;
        for column in 0..=columns {
            let cell_x = -half_x + column as f32 * step;
            let value = error(cell_x, cell_y);
            if value < best.0 {
                best = (value, cell_x, cell_y);
            }
            rows.row(format_args!(
                "error,{cell_x:.3},{cell_y:.3},{:.6},{value:.5}",
                truth.theta
            ))?;
        }
        bar.inc(1);
    }
    let config = HeadingHistogramConfig::default();
    let steps = (config.search_range_deg / config.step_deg) as i32;
    for offset in -steps..=steps {
        let heading = truth.theta + (offset as f32 * config.step_deg).to_radians();
        let peak = histogram_peak(&points, heading, &config);
        rows.row(format_args!(
            "histogram,{x:.3},{y:.3},{heading:.6},{peak:.3}"
        ))?;
    }
    // As in the paper, from a prior heading with an error of 20°.
    let prior_heading = truth.theta + 20f32.to_radians();
    let heading = histogram_heading(&points, prior_heading, &config);
    let heading_error = heading.map(|heading| {
        f64::from(localize::frames::wrap_angle(heading - truth.theta).abs()).to_degrees()
    });
    let distance = f64::from((best.1 - x).hypot(best.2 - y));
    Ok(vec![
        Metric::without_interval(
            "",
            "error surface",
            "lowest cell from the truth, cm",
            Some(100.0 * distance),
        ),
        Metric::without_interval("", "error surface", "error there", Some(f64::from(best.0))),
        Metric::without_interval(
            "",
            "error surface",
            "error at the truth",
            Some(f64::from(error(x, y))),
        ),
        Metric::without_interval("", "histogram", "heading off, °", heading_error),
    ])
}
