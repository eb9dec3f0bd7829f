//! How do error and histogram look about the truth? One sight, over all places under its heading, and over headings.

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

/// Mean error of all points (minho2016 eq. 5 on the distance to the nearest marking) at each place, and the height of
/// the histograms' peaks (V.B) at each heading; both in one file, told apart by `layer`.
pub fn run(
    landscape: &Landscape,
    seed: u64,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let Landscape { step, reach, .. } = *landscape;
    ensure!(step > 0.0 && reach > 0.0, "step and reach must be positive");
    let field = Field::load(&landscape.field)?;
    let distances = DistanceField::new(&field, &PipelineConfig::default().localize.distance_field);
    let [x, y, theta_deg] = landscape.pose;
    let truth = Pose::new(x, y, theta_deg.to_radians());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let points = simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng);
    let (sin, cos) = truth.theta.sin_cos();
    let turned: Vec<[f32; 2]> = points
        .iter()
        .map(|point| {
            let (x, y) = (point.at.x, point.at.y);
            [cos * x - sin * y, sin * x + cos * y]
        })
        .collect();
    let error = |x: f32, y: f32| -> f32 {
        let each = turned.iter().map(|[px, py]| {
            let d = distances.nearest(x + px, y + py).signed_distance;
            1.0 - reach * reach / (reach * reach + d * d)
        });
        each.sum::<f32>() / turned.len().max(1) as f32
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
        let at_y = -half_y + line as f32 * step;
        for column in 0..=columns {
            let at_x = -half_x + column as f32 * step;
            let value = error(at_x, at_y);
            if value < best.0 {
                best = (value, at_x, at_y);
            }
            rows.row(format_args!(
                "error,{at_x:.3},{at_y:.3},{:.6},{value:.5}",
                truth.theta
            ))?;
        }
        bar.inc(1);
    }
    let config = HeadingHistogramConfig::default();
    let turns = (config.search_range_deg / config.step_deg) as i32;
    for turn in -turns..=turns {
        let heading = truth.theta + (turn as f32 * config.step_deg).to_radians();
        let peak = histogram_peak(&points, heading, &config);
        rows.row(format_args!(
            "histogram,{x:.3},{y:.3},{heading:.6},{peak:.3}"
        ))?;
    }
    // As the paper does, from a heading that is known to 20° only.
    let last = truth.theta + 20f32.to_radians();
    let heading = histogram_heading(&points, last, &config);
    let off = heading.map(|heading| {
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
        Metric::without_interval("", "histogram", "heading off, °", off),
    ])
}
