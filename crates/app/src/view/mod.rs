//! `mirrorball view`: what does the robot see and believe? A window for the person beside the field, on a log, on a
//! simulation of its own, or on a run that goes on beside it.
//!
//! Panels (`panels/`) draw what the session (`session`) holds; sources (`source/`) bring it; whatever takes time runs in
//! threads of its own. The threads that drive never wait for any of it.

mod brush;
mod devices;
mod ink;
mod inverse;
mod keys;
mod layers;
mod layout;
mod meter;
mod named;
mod panels;
mod panzoom;
mod report;
mod series;
mod session;
mod settings;
mod shell;
mod source;
mod stage;
#[cfg(test)]
mod tests;
mod window;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use layout::Preset;
use session::Session;
pub use window::{AfterRun, beside};

/// Look at a log, at a simulation of the view's own, or at a robot over the network.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball view game.mcap\n         mirrorball view config/scenarios/demo.toml\n         mirrorball view 192.168.1.11:8765\n\n`?` in the window lists its keys."
)]
pub struct Args {
    /// A log (.mcap), a scenario (.toml), or host:port of a robot's live stream.
    source: Option<PathBuf>,
    /// Start at this second.
    #[arg(long, value_name = "SECONDS")]
    at: Option<f64>,
    /// Start with these panels; else with those of the last time.
    #[arg(long, value_enum)]
    preset: Option<Task>,
    /// Write a picture of the window, and leave.
    #[arg(long, value_name = "FILE.png")]
    screenshot: Option<PathBuf>,
    /// Leave after so many seconds.
    #[arg(long, value_name = "SECONDS")]
    leave_after: Option<f64>,
}

/// Arrangements of panels by the task they are for.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Task {
    /// Camera, field, timeline and plots.
    Watch,
    /// The camera large, with its settings.
    Eyes,
    /// The field large, with errors.
    Place,
    /// A simulation and what is done to it.
    Simulate,
    /// Colours, mask and map.
    Calibrate,
    /// Every device.
    Health,
}

/// What `--json` prints.
#[derive(serde::Serialize)]
struct Outcome {
    frames: u64,
    seconds: f64,
    frames_per_s: f64,
    cycles: u64,
    dropped_cycles: u64,
    /// What went wrong last.
    #[serde(skip)]
    fault: Option<String>,
}

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    for seconds in [args.at, args.leave_after].into_iter().flatten() {
        ensure!(seconds.is_finite(), "{seconds} is no time");
    }
    window::display()?;
    let mut session = match &args.source {
        Some(path) => Session::open(path)?,
        None => Session::default(),
    };
    if let Some(at) = args.at {
        session.seek(at);
    }
    let wishes = window::Wishes {
        preset: args.preset.map(Task::preset),
        screenshot: args.screenshot.clone(),
        leave_after: args.leave_after,
        ..window::Wishes::default()
    };
    let outcome = window::show(session, wishes)?;
    if let (Some(_), Some(fault)) = (&args.screenshot, &outcome.fault) {
        bail!("{fault}");
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    }
    Ok(())
}

/// Shows a log with its run computed again beside the recorded one.
pub fn again(log: &Path) -> Result<()> {
    window::display()?;
    let mut session = Session::open(log)?;
    let config = session.ran_with.clone();
    session.compute_again(&config);
    window::show(session, window::Wishes::default()).map(drop)
}

impl Task {
    fn preset(self) -> Preset {
        match self {
            Task::Watch => Preset::Watch,
            Task::Eyes => Preset::Eyes,
            Task::Place => Preset::Place,
            Task::Simulate => Preset::Simulate,
            Task::Calibrate => Preset::Calibrate,
            Task::Health => Preset::Health,
        }
    }
}
