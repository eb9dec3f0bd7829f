//! `mirrorball bench`: how fast and how accurate is it on this machine? Each stage's figures next to their bounds.

mod against;
mod baseline;
mod fusion_accuracy;
mod localization_accuracy;
mod localization_time;
mod measure;
mod simulation_time;
mod team_sightings;
mod vision_time;

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde::Serialize;

use self::against::{PairedFigure, compare_against};
use self::baseline::{Baseline, FigureComparison};
use self::measure::Figures;
use crate::commands::arguments::UsageError;
use crate::commands::inputs::Inputs;
use crate::machine::machine;

/// Measure every stage on this machine: times (medians, one core) and accuracies.
///
/// Each figure is printed next to its bound. Leave the machine idle meanwhile.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball bench --save baseline.json, later: mirrorball bench --baseline baseline.json\n\
                  Example: mirrorball bench --only 480 --against old/mirrorball"
)]
pub(crate) struct Args {
    /// Measure only the figures whose name contains this.
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Write the figures to a file, for a later comparison.
    #[arg(long, value_name = "FILE.json")]
    save: Option<PathBuf>,
    /// Compare with the figures of a file that --save wrote.
    #[arg(long, value_name = "FILE.json")]
    baseline: Option<PathBuf>,
    /// Compare with another executable: both measure each timed figure five times in alternation, so that a busy machine
    /// still gives ratios.
    #[arg(long, value_name = "EXE", conflicts_with_all = ["save", "baseline"])]
    against: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    /// Machine and figures.
    #[serde(flatten)]
    run: Baseline,
    /// Each figure compared with the baseline's, if one was given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    compared: Vec<FigureComparison>,
    /// Names of figures that only the baseline has.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    gone: Vec<String>,
}

/// What `--against --json` prints.
#[derive(Serialize)]
struct PairedOutcome {
    machine: String,
    paired: Vec<PairedFigure>,
}

type Bench = fn(&mut Figures) -> Result<()>;

/// Every measurement, with the names of its figures.
const BENCHES: [(&[&str], Bench); 10] = [
    (vision_time::NAMES, vision_time::measure_vision),
    (vision_time::LARGE_NAMES, vision_time::measure_vision_large),
    (
        localization_time::NAMES,
        localization_time::measure_localization,
    ),
    (
        localization_time::PAPERS,
        localization_time::measure_paper_methods,
    ),
    (
        localization_accuracy::DRIVES,
        localization_accuracy::measure_tracking,
    ),
    (
        fusion_accuracy::FUSION_NAMES,
        fusion_accuracy::measure_fusion_and_team,
    ),
    (
        fusion_accuracy::VISION_NAMES,
        fusion_accuracy::measure_detection_rates,
    ),
    (
        simulation_time::RENDERING_NAMES,
        simulation_time::measure_rendering,
    ),
    (
        simulation_time::SIMULATION_NAMES,
        simulation_time::measure_simulation,
    ),
    (
        fusion_accuracy::MIRRORS,
        fusion_accuracy::measure_mirror_report,
    ),
];

/// Those whose figures are times.
const TIMED: [&[&str]; 6] = [
    vision_time::NAMES,
    vision_time::LARGE_NAMES,
    localization_time::NAMES,
    localization_time::PAPERS,
    simulation_time::RENDERING_NAMES,
    simulation_time::SIMULATION_NAMES,
];

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    if let Some(other) = &args.against {
        return run_against(other, &args.only, json);
    }
    // A bad file must show before minutes of measuring.
    Inputs::of(args.baseline.as_deref()).ensure_kept([args.save.as_deref()])?;
    let earlier = args.baseline.as_deref().map(Baseline::load).transpose()?;
    let mut figures = Figures::only(&args.only);
    for (names, bench) in BENCHES {
        if names.iter().any(|name| figures.wants(name)) {
            bench(&mut figures)?;
        }
    }
    let figures = figures.measured;
    if figures.is_empty() {
        return Err(unknown_figure(&args.only));
    }
    let mut outcome = Outcome {
        run: Baseline {
            machine: machine(),
            figures,
        },
        compared: Vec::new(),
        gone: Vec::new(),
    };
    if let Some(path) = &args.save {
        outcome.run.save(path)?;
    }
    if let Some(earlier) = &earlier {
        outcome.compared = outcome.run.compare_with(earlier);
        outcome.gone = outcome.run.missing(earlier);
        // A figure that --only excludes is not missing.
        outcome.gone.retain(|name| name.contains(&args.only));
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    println!("{}", outcome.run.machine);
    baseline::print(
        &outcome.run,
        earlier.as_ref(),
        &outcome.compared,
        &outcome.gone,
    );
    if let Some(path) = &args.save {
        println!("saved to {}", path.display());
    }
    Ok(())
}

fn run_against(other: &Path, only: &str, json: bool) -> Result<()> {
    let names: Vec<&str> = TIMED.concat();
    let names: Vec<&str> = names
        .into_iter()
        .filter(|name| name.contains(only))
        .collect();
    if names.is_empty() {
        return Err(unknown_figure(only));
    }
    let paired = compare_against(other, &names, |figure| {
        if !json {
            println!("{}", figure.line());
        }
    })?;
    if json {
        let machine = machine();
        println!(
            "{}",
            serde_json::to_string(&PairedOutcome { machine, paired })?
        );
    }
    Ok(())
}

fn unknown_figure(only: &str) -> anyhow::Error {
    UsageError(format!("no figure's name contains {only:?}")).into()
}
