//! `mirrorball bench`: how fast and how exact is it on this machine? Each stage's figures beside what is wanted.

mod baseline;
mod fusion_accuracy;
mod localization_accuracy;
mod localization_time;
mod simulation_time;
mod vision_time;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use serde::Serialize;

use self::baseline::{Baseline, BaselineFigure, FigureComparison};
use crate::commands::arguments::UsageError;
use pipeline::score::sample_statistics;

/// Measure every stage on this machine: times (medians, one core) and accuracies.
///
/// Each figure stands beside the one that is wanted. Let the machine rest meanwhile.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball bench --save baseline.json, later: mirrorball bench --baseline baseline.json"
)]
pub struct Args {
    /// Measure only the figures whose name contains this.
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Keep the figures in a file, to compare with later.
    #[arg(long, value_name = "FILE.json")]
    save: Option<PathBuf>,
    /// Compare with figures kept earlier.
    #[arg(long, value_name = "FILE.json")]
    baseline: Option<PathBuf>,
}

/// One measured figure.
#[derive(Debug, Serialize)]
pub struct Figure {
    name: &'static str,
    value: f64,
    unit: &'static str,
    /// Bound to be met, as text with its direction.
    wanted: &'static str,
}

#[derive(Serialize)]
struct Outcome {
    machine: String,
    figures: Vec<Figure>,
    /// Beside the baseline's, if one was given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    compared: Vec<FigureComparison>,
    /// What the baseline has and this run has not.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    gone: Vec<String>,
}

impl Outcome {
    fn to_baseline(&self) -> Baseline {
        let figures = self.figures.iter().map(|figure| BaselineFigure {
            name: figure.name.to_owned(),
            value: figure.value,
            unit: figure.unit.to_owned(),
            wanted: figure.wanted.to_owned(),
        });
        Baseline {
            machine: self.machine.clone(),
            figures: figures.collect(),
        }
    }
}

/// Repetitions of a stage's measurement, at least.
const REPEATS: usize = 300;

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    let mut report = Outcome {
        machine: machine(),
        figures: Vec::new(),
        compared: Vec::new(),
        gone: Vec::new(),
    };
    // Before minutes of measuring.
    let earlier = args.baseline.as_deref().map(Baseline::load).transpose()?;
    type Bench = fn(&mut Vec<Figure>) -> Result<()>;
    let benches: [(&[&str], Bench); 10] = [
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
    for (names, bench) in benches {
        if names.iter().any(|name| name.contains(&args.only)) {
            bench(&mut report.figures)?;
        }
    }
    report
        .figures
        .retain(|figure| figure.name.contains(&args.only));
    if report.figures.is_empty() {
        return Err(UsageError(format!("no figure's name contains {:?}", args.only)).into());
    }
    let kept = report.to_baseline();
    if let Some(path) = &args.save {
        kept.save(path)?;
    }
    if let Some(earlier) = &earlier {
        report.compared = kept.compare_with(earlier);
        report.gone = kept.missing(earlier);
        // What was not asked for is not missing.
        report.gone.retain(|name| name.contains(&args.only));
    }
    if json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!("{}", report.machine);
    baseline::print(&kept, earlier.as_ref(), &report.compared, &report.gone);
    if let Some(path) = &args.save {
        println!("kept in {}", path.display());
    }
    Ok(())
}

/// Processor and number of cores, as the system names them.
pub(crate) fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!(
        "{}, {cores} cores, {}",
        name.map_or("unknown processor", |(_, name)| name.trim()),
        std::env::consts::OS
    )
}

/// A stage is measured for so long at least: other guests of a shared machine come and go within a second.
const MIN_DURATION: Duration = Duration::from_secs(2);

/// Median time of a call in milliseconds.
fn median_ms(repeats: usize, mut call: impl FnMut()) -> f64 {
    let mut once = || {
        let started = Instant::now();
        call();
        started.elapsed().as_secs_f64() * 1e3
    };
    // The first calls fill caches.
    for _ in 0..repeats.div_ceil(10) {
        once();
    }
    let (started, mut times) = (Instant::now(), Vec::new());
    while times.len() < repeats || started.elapsed() < MIN_DURATION {
        times.push(once());
    }
    sample_statistics(times).map_or(f64::NAN, |spread| spread.median)
}

fn figure(name: &'static str, value: f64, unit: &'static str, wanted: &'static str) -> Figure {
    Figure {
        name,
        value,
        unit,
        wanted,
    }
}
