//! `mirrorball view`: what does the robot see and believe? A window for the person beside the field, on a log, on a
//! simulation of its own, or on a run that goes on beside it.
//!
//! Panels (`panels/`) draw what the session (`session`) holds; sources (`source/`) bring it; whatever takes time runs in
//! threads of its own. The threads that drive never wait for any of it.

mod accessibility;
mod brush;
pub(crate) mod calibration_job;
mod device_monitor;
mod frame_rate;
mod inverse_ground_map;
mod layer_worker;
mod layout;
mod palette;
mod panels;
mod panzoom;
mod report;
mod session;
mod settings;
mod shell;
mod shortcuts;
mod source;
mod static_scene;
#[cfg(test)]
mod tests;
mod time_series;
mod window;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use layout::PanelLayout;
use session::Session;
pub(crate) use window::{AfterRun, run_with_window};

/// Look at a log, at a simulation of the view's own, or at a robot over the network.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball view game.mcap\n         mirrorball view config/scenarios/demo.toml\n         mirrorball view 192.168.1.11:8765\n\n`?` in the window lists its keys."
)]
pub(crate) struct Args {
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
    error: Option<String>,
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    for seconds in [args.at, args.leave_after].into_iter().flatten() {
        ensure!(seconds.is_finite(), "{seconds} is no time");
    }
    window::require_display()?;
    let mut session = match &args.source {
        Some(path) => Session::open(path)?,
        None => Session::default(),
    };
    if let Some(at) = args.at {
        session.seek(at);
    }
    let wishes = window::WindowOptions {
        layout: args.preset.map(Task::preset),
        screenshot: args.screenshot.clone(),
        close_after: args.leave_after,
        ..window::WindowOptions::default()
    };
    let outcome = window::run_window(session, wishes)?;
    if let (Some(_), Some(fault)) = (&args.screenshot, &outcome.error) {
        bail!("{fault}");
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    }
    Ok(())
}

/// Shows a log with its run computed again beside the recorded one.
pub(crate) fn show_recomputed(log: &Path) -> Result<()> {
    window::require_display()?;
    let mut session = Session::open(log)?;
    let config = session.source_config.clone();
    session.start_recompute(&config);
    window::run_window(session, window::WindowOptions::default()).map(drop)
}

impl Task {
    fn preset(self) -> PanelLayout {
        match self {
            Task::Watch => PanelLayout::Watch,
            Task::Eyes => PanelLayout::Vision,
            Task::Place => PanelLayout::Localization,
            Task::Simulate => PanelLayout::Simulate,
            Task::Calibrate => PanelLayout::Calibrate,
            Task::Health => PanelLayout::Health,
        }
    }
}
