//! Does the global search find the pose from one set of line points? Each preset's search at random poses, without images.

use std::time::Instant;

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use localize::frames::wrap_angle;
use localize::global_search::branch_and_bound::{BranchAndBound, HeadingPrior, half_turn};
use localize::global_search::{GlobalSearch, SearchInput};
use localize::matching::Matcher;
use localize::random::standard_normal;
use localize::synthetic::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
use localize::{DistanceField, Field, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::experiment::Searches;
use super::metric::{Metric, PoseTolerance};
use super::output::CsvRows;
use pipeline::PipelineConfig;

/// A pose within these errors is correct: metres, radians (5°).
const CORRECT_WITHIN: PoseTolerance = PoseTolerance {
    position: 0.25,
    heading: 0.087,
};

/// Runs each preset's search on the same line points, one after the other, so that times are comparable.
pub(crate) fn run(
    searches: &Searches,
    seed: u64,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let field = Field::load(&searches.field)?;
    let compass = searches.compass_std_deg.map(f32::to_radians);
    let drive = SyntheticDriveConfig::default();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let trials: Vec<_> = (0..searches.count)
        .map(|_| {
            let truth = random_pose(&field, &mut rng);
            let points = simulate_line_points(&field, &drive, truth, &mut rng);
            let prior = compass.map(|std| HeadingPrior {
                heading: truth.theta + std * standard_normal(&mut rng),
                std,
            });
            (truth, points, prior)
        })
        .collect();
    bar.set_length((searches.presets.len() * trials.len()) as u64);
    rows.header("method,number,true_x_m,true_y_m,true_theta_rad,x_m,y_m,theta_rad,right")?;
    let mut figures = Vec::new();
    for preset in &searches.presets {
        let config = PipelineConfig::preset(preset)?.localize;
        let distances = DistanceField::new(&field, &config.distance_field);
        let mut search = BranchAndBound::new(&field, &distances, config.branch_and_bound.clone());
        let mut matcher = Matcher::new(config.matching.clone());
        let mut global_search = GlobalSearch::new(&field, &distances, &config.global_search);
        let (mut correct, mut errors, mut times) =
            (0, [Vec::new(), Vec::new(), Vec::new()], Vec::new());
        for (number, (truth, points, prior)) in trials.iter().enumerate() {
            global_search.reset();
            let input = SearchInput {
                distances: &distances,
                points,
                heading_prior: *prior,
                single_image: true,
                goals: &[],
            };
            let started = Instant::now();
            let hypotheses = global_search
                .find_hypotheses(&mut search, &mut matcher, &input)
                .hypotheses;
            times.push(started.elapsed().as_secs_f64() * 1e3);
            bar.inc(1);
            let [x, y, theta] = [truth.x, truth.y, truth.theta];
            let Some(pose) = hypotheses.first().map(|hypothesis| hypothesis.pose) else {
                rows.row(format_args!(
                    "{preset},{number},{x:.5},{y:.5},{theta:.6},,,,0"
                ))?;
                continue;
            };
            let error = match pose_error(pose, *truth) {
                error if prior.is_some() || CORRECT_WITHIN.contains(error) => error,
                _ => pose_error(half_turn(pose), *truth),
            };
            let hit = CORRECT_WITHIN.contains(error);
            rows.row(format_args!(
                "{preset},{number},{x:.5},{y:.5},{theta:.6},{:.5},{:.5},{:.6},{}",
                pose.x,
                pose.y,
                pose.theta,
                u8::from(hit)
            ))?;
            if hit {
                correct += 1;
                for (values, value) in errors.iter_mut().zip(error) {
                    values.push(f64::from(value.abs()));
                }
            }
        }
        let centimetres = |values: &[f64]| values.iter().map(|v| 100.0 * v).collect::<Vec<_>>();
        figures.push(Metric::proportion(
            "",
            preset,
            "right, %",
            correct,
            trials.len(),
        ));
        figures.push(Metric::mean(
            "",
            preset,
            "mean |x| of these, cm",
            &centimetres(&errors[0]),
        ));
        figures.push(Metric::mean(
            "",
            preset,
            "mean |y| of these, cm",
            &centimetres(&errors[1]),
        ));
        figures.push(Metric::mean(
            "",
            preset,
            "mean |θ| of these, rad",
            &errors[2],
        ));
        figures.push(Metric::median("", preset, "time, ms", times));
    }
    (!figures.is_empty())
        .then_some(figures)
        .context("searches: no presets (expected at least one)")
}

fn pose_error(pose: Pose, truth: Pose) -> [f32; 3] {
    [
        pose.x - truth.x,
        pose.y - truth.y,
        wrap_angle(pose.theta - truth.theta),
    ]
}
