//! `mirrorball view`: what does the robot detect and estimate? A window on a log, on a simulation of its own, or on a
//! running robot.
//!
//! Panels (`panels/`) draw what the session (`session`) holds. Sources (`source/`) deliver the cycles. Slow work runs in
//! separate threads. The pipeline's threads never wait for the view.

mod accessibility;
mod actions;
mod birds_eye;
mod brush;
pub(crate) mod calibration_job;
mod calibration_state;
mod current_panel;
mod curves;
mod device_monitor;
mod dialogs;
mod dropped_files;
mod file_dialog;
mod frame_pacing;
mod frame_rate;
mod ground_placement;
mod inverse_ground_map;
mod keyboard_pointer;
mod labels;
mod layer_worker;
mod layout;
mod layout_file;
mod line_simplification;
mod log_damage;
mod menu;
mod palette;
mod panel_command;
mod panels;
mod panzoom;
mod pen;
mod pen_texture;
mod pixel_info;
mod report;
mod robot_folder;
mod run_findings;
mod search;
mod selection;
mod session;
mod setting_changes;
mod settings;
mod settings_state;
mod setup_job;
mod shell;
mod shortcut_table;
mod shortcuts;
mod source;
mod static_scene;
mod status_message;
#[cfg(test)]
mod tests;
mod tiles;
mod time_series;
mod undo;
mod window;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use layout::PanelLayout;
use layout_file::SavedLayout;
use session::Session;
pub(crate) use window::{AfterRun, run_with_window};

/// Show a log, a simulation or a robot's live stream in a window.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball view game.mcap\n         mirrorball view samples/sequence\n         mirrorball view config/scenarios/demo.toml\n         mirrorball view 192.168.1.11:8765\n\nPress `?` in the window for its shortcuts."
)]
pub(crate) struct Args {
    /// A log (.mcap), a recording folder, a scenario (.toml), or host:port of a robot's live stream.
    source: Option<PathBuf>,
    /// Another log, or another robot's live stream, on the same timeline. Can be repeated.
    #[arg(long = "with", value_name = "LOG")]
    beside: Vec<PathBuf>,
    /// Time to show first, seconds: a stamp of the log. Those of a robot's log count from the start of its computer.
    #[arg(long, value_name = "SECONDS")]
    at: Option<f64>,
    /// Begin to play at once.
    #[arg(long)]
    play: bool,
    /// Panel layout at start. Default: the layout of the last session.
    #[arg(long, value_enum)]
    preset: Option<Task>,
    /// Panel layout at start, from a file that the View menu wrote.
    #[arg(long, value_name = "FILE.json", conflicts_with = "preset")]
    layout: Option<PathBuf>,
    /// Write a screenshot of the window, then exit.
    #[arg(long, value_name = "FILE.png")]
    screenshot: Option<PathBuf>,
    /// Exit after this many seconds.
    #[arg(long, value_name = "SECONDS")]
    leave_after: Option<f64>,
}

/// Panel layouts, one per task.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Task {
    /// Camera, field, timeline and plots.
    Watch,
    /// Large camera image with the vision settings.
    Eyes,
    /// Large field with localization errors.
    Place,
    /// Simulation and its disturbances.
    Simulate,
    /// Colours, mask and ground map.
    Calibrate,
    /// State of every device.
    Health,
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    for seconds in [args.at, args.leave_after].into_iter().flatten() {
        ensure!(
            seconds.is_finite(),
            "invalid time: {seconds} (expected finite seconds)"
        );
    }
    for source in args.source.iter().chain(&args.beside) {
        ensure_exists(source)?;
    }
    let layout_file = args.layout.as_deref().map(SavedLayout::load).transpose()?;
    // Before a recording is computed or a simulation starts.
    window::require_display()?;
    let mut session = match &args.source {
        Some(path) => Session::open(path)?,
        None => Session::default(),
    };
    for path in &args.beside {
        session.open_beside(path)?;
    }
    if let Some(at) = args.at {
        if let Some((start, end)) = session.source.span() {
            ensure!(
                (start..=end).contains(&at),
                "--at {at}: no such moment (expected {start:.3} to {end:.3} s, the times of the log)"
            );
        }
        session.seek(at);
    }
    if args.play && !session.playback.playing {
        session.toggle_playback();
    }
    let options = window::WindowOptions {
        layout: args.preset.map(Task::preset),
        layout_file,
        screenshot: args.screenshot.clone(),
        close_after: args.leave_after,
        ..window::WindowOptions::default()
    };
    let outcome = window::run_window(session, options)?;
    if let (Some(_), Some(error)) = (&args.screenshot, &outcome.error) {
        bail!("{error}");
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    }
    Ok(())
}

/// Fails for a file that is not there: no display would show it.
fn ensure_exists(source: &Path) -> Result<()> {
    if !source::is_stream_address(source) {
        if let Some(port) = source::invalid_port(source) {
            bail!(
                "{}: invalid port: {port} (expected 0 to 65535)",
                source.display()
            );
        }
        std::fs::metadata(source).with_context(|| format!("cannot read {}", source.display()))?;
    }
    Ok(())
}

/// Shows a log, and recomputes its run for comparison with the recorded one.
pub(crate) fn show_recomputed(log: &Path) -> Result<()> {
    ensure_exists(log)?;
    window::require_display()?;
    let mut session = Session::open(log)?;
    session.start_recompute();
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
