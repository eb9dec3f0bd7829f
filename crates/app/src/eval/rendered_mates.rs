//! How well do team-mates locate a robot whose mirror is covered? Rendered games, each robot with its own vision.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use localize::localizer::SightingOutcome;
use nalgebra::Matrix2;
use pipeline::PipelineConfig;
use pipeline::config::apply_overlay;
use pipeline::cycle::Cycle;
use pipeline::multi_robot::MultiRobotSimulation;
use pipeline::simulation::load_scenario_with_overrides;
use serde::Deserialize;

use super::cooperative::{NEES_95, WANTED_ERROR};
use super::metric::Metric;
use super::output::{CsvRows, csv_quote};

/// 99.7 % of a χ² distribution with two degrees of freedom are below this, as of a normal one below 3 standard deviations.
const NEES_3_SIGMA: f64 = 11.83;

/// Rendered games in which the mirror of the first robot is covered.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RenderedMatesRuns {
    /// Most seeds, since a rendered game takes as long as it lasts; all if left out.
    pub seeds_max: Option<u64>,
    /// Games; each is run with every seed, without team-mates' corrections and with them.
    pub variants: Vec<RenderedMatesVariant>,
}

/// A game with an occlusion of the first robot's mirror.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RenderedMatesVariant {
    /// Its name in tables.
    pub name: String,
    /// Its scenario.
    pub scenario: PathBuf,
    /// Values that override the scenario's.
    #[serde(default)]
    pub set: toml::Table,
    /// Values that override the settings (the keys of `--config`).
    #[serde(default)]
    pub config: toml::Table,
}

/// Figures of the first robot while its mirror is covered, and of all robots while they see lines.
#[derive(Debug, Default)]
struct GameScore {
    /// Squared errors of the position in the last second of the occlusion, m².
    last_squared: Vec<f64>,
    /// NEES of the position in each covered image after the first second, if it has a pose.
    nees: Vec<f64>,
    /// Images covered after the first second.
    images: usize,
    /// One of them has no pose.
    lost: bool,
    /// Errors of the position of the uncovered robots, and of the first one until its mirror is covered, metres.
    sighted_errors: Vec<f64>,
    /// Sightings that corrected those.
    used_in_sight: usize,
    /// Sightings that corrected the covered robot.
    used: usize,
    /// Those that did not.
    refused: usize,
}

/// Runs each game with each seed.
pub(crate) fn run(
    runs: &RenderedMatesRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    let end = runs.seeds_max.map_or(seeds.end, |most| {
        seeds.end.min(seeds.start.saturating_add(most))
    });
    let seeds = seeds.start..end;
    bar.set_length(2 * runs.variants.len() as u64 * (seeds.end - seeds.start));
    rows.header("variant,method,seed,robot,error_m")?;
    let mut figures = Vec::new();
    for variant in &runs.variants {
        for (method, enabled) in [("alone", false), ("team", true)] {
            let mut scores = Vec::new();
            // The robots of a game share the cores already.
            for seed in seeds.clone() {
                let score = play(variant, seed, enabled)
                    .with_context(|| format!("variant {:?}", variant.name))?;
                bar.inc(1);
                if let Some(error) = score.final_error() {
                    let name = csv_quote(&variant.name);
                    rows.row(format_args!("{name},{method},{seed},1,{error:.5}"))?;
                }
                scores.push(score);
            }
            figures.extend(metrics_of(&variant.name, method, &scores));
        }
    }
    Ok(figures)
}

fn play(variant: &RenderedMatesVariant, seed: u64, enabled: bool) -> Result<GameScore> {
    let path = &variant.scenario;
    let (scenario, _) = load_scenario_with_overrides(path, &variant.set, Some(seed))?;
    let occlusion = scenario.occlusions.first();
    let occlusion = occlusion.context("the scenario has no [[occlusions]]")?;
    let covered = (occlusion.start, occlusion.stop.min(scenario.duration));
    let mut config = apply_overlay(&PipelineConfig::default(), variant.config.clone())?;
    config.team.cooperative.enabled = enabled;
    let mut score = GameScore::default();
    MultiRobotSimulation::new((path, &scenario), &config, scenario.duration, None)?.run_observed(
        |_| Ok(ControlFlow::Continue(())),
        |index, cycle| score.add(index, cycle, covered),
    )?;
    Ok(score)
}

impl GameScore {
    fn add(&mut self, index: usize, cycle: &Cycle, (start, stop): (f64, f64)) {
        let seconds = cycle.stamp.seconds();
        let used = cycle.team.sightings.iter();
        let used = used.filter(|sighting| sighting.outcome == SightingOutcome::Used);
        let used = used.count();
        let error = position_error(cycle);
        let is_covered = index == 0 && (start + 1.0..stop).contains(&seconds);
        self.images += usize::from(is_covered);
        let Some((squared, nees)) = error else {
            self.lost |= is_covered;
            return;
        };
        // The first robot finds its pose again after the occlusion.
        if index > 0 || seconds < start {
            self.used_in_sight += used;
            self.sighted_errors.push(squared.sqrt());
        }
        if !is_covered {
            return;
        }
        self.used += used;
        self.refused += cycle.team.sightings.len() - used;
        self.nees.push(nees);
        if seconds > stop - 1.0 {
            self.last_squared.push(squared);
        }
    }

    /// Root of the mean square in the last covered second, metres. None if the robot was lost.
    fn final_error(&self) -> Option<f64> {
        let count = self.last_squared.len() as f64;
        (count > 0.0 && !self.lost).then(|| (self.last_squared.iter().sum::<f64>() / count).sqrt())
    }
}

/// Squared error of the position, m², and its NEES. None without a pose or ground truth.
fn position_error(cycle: &Cycle) -> Option<(f64, f64)> {
    let truth = cycle.inputs.truth.as_ref()?;
    let difference = cycle.estimate.pose?.difference(truth.pose);
    let difference = difference.fixed_rows::<2>(0).map(f64::from);
    let covariance = cycle.estimate.covariance.map(f64::from);
    let covariance: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let inverse = covariance.try_inverse()?;
    Some((
        difference.norm_squared(),
        difference.dot(&(inverse * difference)),
    ))
}

fn metrics_of(variant: &str, method: &str, scores: &[GameScore]) -> Vec<Metric> {
    let of_games = |get: &dyn Fn(&GameScore) -> Option<f64>| -> Vec<f64> {
        scores.iter().filter_map(get).collect()
    };
    let mean = |name: &'static str, values: &[f64]| Metric::mean(variant, method, name, values);
    let share = |name: &'static str, hits: usize, count: usize| {
        Metric::proportion(variant, method, name, hits, count)
    };
    let errors = of_games(&|score| Some(100.0 * score.final_error()?));
    let near = errors
        .iter()
        .filter(|error| **error <= 100.0 * WANTED_ERROR);
    let near = near.count();
    let images = scores.iter().flat_map(|score| &score.nees);
    let count = scores.iter().map(|score| score.images).sum();
    let below = |limit: f64| images.clone().filter(|nees| **nees <= limit).count();
    let mean_of = |values: &[f64]| {
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let mut figures = vec![
        mean(
            "error of the position in the last covered second, cm",
            &errors,
        ),
        share("games within 10 cm, %", near, scores.len()),
        mean(
            "NEES of the position while covered (2 is honest)",
            &of_games(&|score| mean_of(&score.nees)),
        ),
        share("covered images within 3 σ, %", below(NEES_3_SIGMA), count),
        share(
            "covered images within the 95 % bound, %",
            below(NEES_95),
            count,
        ),
        mean(
            "sightings used while covered, of 100",
            &of_games(&|score| {
                let all = score.used + score.refused;
                (all > 0).then(|| 100.0 * score.used as f64 / all as f64)
            }),
        ),
        mean(
            "sightings that moved robots that see lines",
            &of_games(&|score| Some(score.used_in_sight as f64)),
        ),
        mean(
            "error of robots that see lines, mm",
            &of_games(&|score| Some(1000.0 * mean_of(&score.sighted_errors)?)),
        ),
    ];
    figures.retain(|figure| figure.value.is_some());
    figures
}
