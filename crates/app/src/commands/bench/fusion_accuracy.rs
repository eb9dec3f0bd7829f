//! How accurate are fusion, team ball and vision, and how fast is a mirror report? A few figures each.

use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use localize::Field;
use localize::robot::RobotConfig;
use localize::synthetic::team_ball::{TeamExperiment, evaluate_team_ball};
use sim::fusion_experiment::{Disturbance, Estimator, FusionExperiment};

use super::measure::{BenchFigure, Figures};
use crate::eval::vision;
use pipeline::paths;

/// Figures of `measure_fusion_and_team`.
pub(super) const FUSION_NAMES: &[&str] = &[
    "fusion_all_mean",
    "fusion_all_mean_heading",
    "fusion_all_blind",
    "fusion_late_along",
    "team_ball_ratio",
];

/// Drives with all disturbances, drives with late images, and a distant ball.
pub(super) fn measure_fusion_and_team(figures: &mut Figures) -> Result<()> {
    let robot = RobotConfig::load(&paths::find_resource("config/robots/default.toml")?)?;
    let field = Field::load(&robot.field)?;
    let experiment = FusionExperiment {
        seeds: 1..4,
        disturbances: vec![Disturbance::All, Disturbance::Late],
        estimators: vec![Estimator::Joint],
        ..FusionExperiment::default()
    };
    let rows = experiment.run(&robot, &field)?;
    let of = |course| rows.iter().find(|row| row.disturbance == course);
    let (all, late) = of(Disturbance::All)
        .zip(of(Disturbance::Late))
        .context("a course is missing")?;
    let cm = |metres: f32| 100.0 * f64::from(metres);
    figures.extend([
        BenchFigure::new("fusion_all_mean", cm(all.position), "cm", "<= 1.5"),
        BenchFigure::new(
            "fusion_all_mean_heading",
            f64::from(all.heading_deg),
            "degrees",
            "<= 0.3",
        ),
        BenchFigure::new(
            "fusion_all_blind",
            cm(all.blind.unwrap_or(f32::NAN)),
            "cm",
            "<= 10",
        ),
        BenchFigure::new("fusion_late_along", cm(late.along.abs()), "cm", "<= 2"),
    ]);
    let ball = evaluate_team_ball(0..20, &TeamExperiment::default());
    figures.push(BenchFigure::new(
        "team_ball_ratio",
        f64::from(ball.ratio),
        "of the best",
        "<= 0.6",
    ));
    Ok(())
}

/// Figures of `measure_detection_rates`.
pub(super) const VISION_NAMES: &[&str] = &[
    "eyes_points_right",
    "eyes_markings",
    "eyes_ball",
    "eyes_robots",
];

/// Detection rates on the sample recording.
pub(super) fn measure_detection_rates(figures: &mut Figures) -> Result<()> {
    let shares = vision::detection_rates(&paths::find_resource("samples/sequence")?)?;
    let wanted = [">= 97", ">= 60", ">= 97", ">= 95"];
    for ((&name, value), wanted) in VISION_NAMES.iter().zip(shares).zip(wanted) {
        figures.push(BenchFigure::new(
            name,
            value.unwrap_or(f64::NAN),
            "%",
            wanted,
        ));
    }
    Ok(())
}

/// Figures of `measure_mirror_report`.
pub(super) const MIRRORS: &[&str] = &["mirror_report", "mirror_report_1000"];

/// Times the whole command with Python's start: the minimum of five runs, and one run with 1000 imperfect mirrors.
pub(super) fn measure_mirror_report(figures: &mut Figures) -> Result<()> {
    if !cfg!(feature = "python") {
        return Ok(());
    }
    let mut fastest = f64::INFINITY;
    for _ in 0..5 {
        fastest = fastest.min(time_mirror_report(0)?);
    }
    figures.push(BenchFigure::new("mirror_report", fastest, "ms", "<= 2000"));
    figures.push(BenchFigure::new(
        "mirror_report_1000",
        time_mirror_report(1000)?,
        "ms",
        "<= 10000",
    ));
    Ok(())
}

fn time_mirror_report(mirrors: u32) -> Result<f64> {
    let folder = tempfile::tempdir().context("cannot make a temporary folder for the report")?;
    let mut command = Command::new(std::env::current_exe().context("cannot find this executable")?);
    command
        .args(["mirror", "report", "lima2001", "--mirrors"])
        .arg(mirrors.to_string())
        .arg("--out")
        .arg(folder.path());
    let started = Instant::now();
    let status = command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .context("cannot run this executable")?;
    ensure!(
        status.success(),
        "mirrorball mirror report failed. Run `mirrorball mirror report lima2001` to see why"
    );
    Ok(started.elapsed().as_secs_f64() * 1e3)
}
