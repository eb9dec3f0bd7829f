//! How much more accurate is the team's distant ball than the best robot's? Synthetic drives, and rendered ones as a check.

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use localize::synthetic::team_ball::{BallScore, TeamExperiment, evaluate_team_ball};
use rayon::prelude::*;

use super::experiment::{MultiRobotRuns, ScenarioVariant, TeamRuns, TeamVariant};
use super::metric::Metric;
use super::output::{CsvRows, csv_quote};
use pipeline::PipelineConfig;
use pipeline::config::apply_overlay;
use pipeline::multi_robot::{MultiRobotSimulation, RobotSummary};
use pipeline::simulation::load_scenario_with_overrides;

/// Mean errors of the ball in one run, metres.
struct BallErrors {
    /// Of each robot alone.
    single_robots: Vec<f64>,
    /// Of the team.
    team: Option<f64>,
    /// Normalized estimation error squared of the team's ball, if it was scored.
    nees: Option<f64>,
}

const HEADER: &str = "variant,method,seed,robot,error_m";

/// Runs synthetic drives without images.
pub(crate) fn run_synthetic(
    team: &TeamRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    bar.set_length(team.variants.len() as u64 * (seeds.end - seeds.start));
    rows.header(HEADER)?;
    let mut figures = Vec::new();
    for variant in &team.variants {
        let trial = team_experiment(variant);
        let seeds: Vec<u64> = seeds.clone().collect();
        let runs: Vec<BallErrors> = seeds
            .par_iter()
            .map(|&seed| {
                let score = evaluate_team_ball(seed..seed + 1, &trial);
                bar.inc(1);
                ball_errors(&score)
            })
            .collect();
        write_rows(rows, &variant.name, &seeds, &runs)?;
        figures.extend(metrics_of(&variant.name, &runs));
    }
    Ok(figures)
}

fn team_experiment(variant: &TeamVariant) -> TeamExperiment {
    let default = TeamExperiment::default();
    TeamExperiment {
        frames_per_message: variant
            .frames_per_message
            .unwrap_or(default.frames_per_message)
            .max(1),
        loss: variant.loss.unwrap_or(default.loss),
        delay_max: variant.delay_max.unwrap_or(default.delay_max),
        faulty_robots: variant.liars.unwrap_or(default.faulty_robots),
        ball_distance_min: variant.beyond.unwrap_or(default.ball_distance_min),
        seconds: variant.seconds.unwrap_or(default.seconds),
    }
}

fn ball_errors(score: &BallScore) -> BallErrors {
    let honest = score
        .single_robot
        .iter()
        .copied()
        .filter(|error| *error > 0.0);
    let scored = score.frames > 0;
    BallErrors {
        single_robots: honest.map(f64::from).collect(),
        team: scored.then_some(f64::from(score.fused)),
        nees: scored.then_some(f64::from(score.nees)),
    }
}

/// Runs rendered scenarios one after the other: each uses all cores.
pub(crate) fn run_rendered(
    scenarios: &MultiRobotRuns,
    seeds: std::ops::Range<u64>,
    rows: &mut CsvRows,
    bar: &ProgressBar,
) -> Result<Vec<Metric>> {
    bar.set_length(
        (scenarios.variants.len() * scenarios.presets.len()) as u64 * (seeds.end - seeds.start),
    );
    rows.header(HEADER)?;
    let seeds: Vec<u64> = seeds.collect();
    let mut figures = Vec::new();
    for variant in &scenarios.variants {
        for preset in &scenarios.presets {
            let mut runs = Vec::new();
            for &seed in &seeds {
                let summaries = run_scenario(variant, preset, seed)
                    .with_context(|| format!("variant {:?}", variant.name))?;
                bar.inc(1);
                runs.push(BallErrors::from_summaries(&summaries));
            }
            let name = match scenarios.presets.len() {
                1 => variant.name.clone(),
                _ => format!("{}, {preset}", variant.name),
            };
            write_rows(rows, &name, &seeds, &runs)?;
            figures.extend(metrics_of(&name, &runs));
        }
    }
    Ok(figures)
}

fn run_scenario(variant: &ScenarioVariant, preset: &str, seed: u64) -> Result<Vec<RobotSummary>> {
    let path = variant.scenario.as_deref().context("no scenario")?;
    let (scenario, _) = load_scenario_with_overrides(path, &variant.set, Some(seed))?;
    let config = apply_overlay(&PipelineConfig::preset(preset)?, variant.config.clone())?;
    MultiRobotSimulation::new((path, &scenario), &config, scenario.duration, None)?
        .run(|_| Ok(std::ops::ControlFlow::Continue(())))
}

impl BallErrors {
    fn from_summaries(summaries: &[RobotSummary]) -> Self {
        let single_robots = summaries
            .iter()
            .filter_map(|robot| Some(robot.own_far_ball_m?.mean));
        let team: Vec<f64> = summaries
            .iter()
            .filter_map(|robot| Some(robot.team_far_ball_m?.mean))
            .collect();
        BallErrors {
            single_robots: single_robots.collect(),
            team: (!team.is_empty()).then(|| team.iter().sum::<f64>() / team.len() as f64),
            nees: None,
        }
    }

    fn best_robot(&self) -> Option<f64> {
        self.single_robots.iter().copied().reduce(f64::min)
    }

    fn mean_robot(&self) -> Option<f64> {
        let count = self.single_robots.len() as f64;
        (count > 0.0).then(|| self.single_robots.iter().sum::<f64>() / count)
    }
}

fn write_rows(rows: &mut CsvRows, variant: &str, seeds: &[u64], runs: &[BallErrors]) -> Result<()> {
    let variant = csv_quote(variant);
    for (seed, run) in seeds.iter().zip(runs) {
        for (robot, error) in run.single_robots.iter().enumerate() {
            rows.row(format_args!(
                "{variant},alone,{seed},{},{error:.5}",
                robot + 1
            ))?;
        }
        if let Some(error) = run.team {
            rows.row(format_args!("{variant},team,{seed},,{error:.5}"))?;
        }
    }
    Ok(())
}

fn metrics_of(variant: &str, runs: &[BallErrors]) -> Vec<Metric> {
    let centimetres = |get: fn(&BallErrors) -> Option<f64>| -> Vec<f64> {
        let values = runs.iter().filter_map(get);
        values.map(|error| 100.0 * error).collect()
    };
    let name = "error of the ball, cm";
    let ratios: Vec<f64> = runs
        .iter()
        .filter_map(|run| Some(run.team? / run.best_robot()?))
        .collect();
    let nees: Vec<f64> = runs.iter().filter_map(|run| run.nees).collect();
    let mut figures = vec![
        Metric::mean(
            variant,
            "mean robot",
            name,
            &centimetres(BallErrors::mean_robot),
        ),
        Metric::mean(
            variant,
            "best robot",
            name,
            &centimetres(BallErrors::best_robot),
        ),
        Metric::mean(variant, "team", name, &centimetres(|run| run.team)),
        Metric::mean(variant, "team", "over the best robot's", &ratios),
        Metric::mean(variant, "team", "NEES (2 is honest)", &nees),
    ];
    figures.retain(|figure| figure.value.is_some());
    figures
}
