//! Fusion, team, eyes and mirrors in a few figures each; `mirrorball eval` has their whole tables.

use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use localize::Field;
use localize::robot::RobotConfig;
use localize::synthetic::team_ball::{TeamExperiment, evaluate_team_ball};
use sim::fusion_experiment::{Course, Estimator, FusionExperiment};

use super::{Figure, figure};
use crate::eval::vision;
use pipeline::paths;

/// Figures of `fused`.
pub(super) const FUSION_NAMES: &[&str] = &[
    "fusion_all_mean",
    "fusion_all_mean_heading",
    "fusion_all_blind",
    "fusion_late_along",
    "team_ball_ratio",
];

/// Everything that can go wrong at once on a drive, late frames, and a far ball.
pub(super) fn measure_fusion_and_team(figures: &mut Vec<Figure>) -> Result<()> {
    let robot = RobotConfig::load(&paths::find_resource("config/robots/default.toml")?)?;
    let field = Field::load(&robot.field)?;
    let experiment = FusionExperiment {
        seeds: 1..4,
        disturbances: vec![Course::All, Course::Late],
        estimators: vec![Estimator::Joint],
        ..FusionExperiment::default()
    };
    let rows = experiment.run(&robot, &field)?;
    let of = |course| rows.iter().find(|row| row.course == course);
    let (all, late) = of(Course::All)
        .zip(of(Course::Late))
        .context("a course is missing")?;
    let cm = |metres: f32| 100.0 * f64::from(metres);
    figures.extend([
        figure("fusion_all_mean", cm(all.position), "cm", "<= 1.5"),
        figure(
            "fusion_all_mean_heading",
            f64::from(all.heading_deg),
            "degrees",
            "<= 0.3",
        ),
        figure(
            "fusion_all_blind",
            cm(all.blind.unwrap_or(f32::NAN)),
            "cm",
            "<= 10",
        ),
        figure("fusion_late_along", cm(late.along.abs()), "cm", "<= 2"),
    ]);
    let ball = evaluate_team_ball(0..20, &TeamExperiment::default());
    figures.push(figure(
        "team_ball_ratio",
        f64::from(ball.ratio),
        "of the best",
        "<= 0.6",
    ));
    Ok(())
}

/// Figures of `seen`.
pub(super) const VISION_NAMES: &[&str] = &[
    "eyes_points_right",
    "eyes_markings",
    "eyes_ball",
    "eyes_robots",
];

/// What the eyes find in the recording that comes with Mirrorball.
pub(super) fn measure_detection_rates(figures: &mut Vec<Figure>) -> Result<()> {
    let shares = vision::detection_rates(&paths::find_resource("samples/sequence")?)?;
    let wanted = [">= 97", ">= 60", ">= 97", ">= 95"];
    for ((&name, value), wanted) in VISION_NAMES.iter().zip(shares).zip(wanted) {
        figures.push(figure(name, value.unwrap_or(f64::NAN), "%", wanted));
    }
    Ok(())
}

/// Figures of `mirrors`.
pub(super) const MIRRORS: &[&str] = &["mirror_report", "mirror_report_1000"];

/// The whole command, Python's start included: the least of five, and once with a thousand imperfect mirrors.
pub(super) fn measure_mirror_report(figures: &mut Vec<Figure>) -> Result<()> {
    if !cfg!(feature = "python") {
        return Ok(());
    }
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        least = least.min(time_mirror_report(0)?);
    }
    figures.push(figure("mirror_report", least, "ms", "<= 2000"));
    figures.push(figure(
        "mirror_report_1000",
        time_mirror_report(1000)?,
        "ms",
        "<= 10000",
    ));
    Ok(())
}

fn time_mirror_report(mirrors: u32) -> Result<f64> {
    let folder = tempfile::tempdir().context("no folder for the report")?;
    let mut command = Command::new(std::env::current_exe().context("where am I?")?);
    command
        .args(["mirror", "report", "lima2001", "--mirrors"])
        .arg(mirrors.to_string())
        .arg("--out")
        .arg(folder.path());
    let started = Instant::now();
    let done = command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .context("cannot run myself")?;
    ensure!(
        done.success(),
        "mirror report failed: run it by itself to see why"
    );
    Ok(started.elapsed().as_secs_f64() * 1e3)
}
