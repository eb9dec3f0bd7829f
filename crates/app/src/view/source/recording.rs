//! Opens a recording folder: its poses are computed once, into a log that the view then plays.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use pipeline::log::{ImageCompression, LogConfig, start_log};
use pipeline::recording::Recording;
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

use crate::commands::locate::EXTERNAL_POINT_STD;

/// Computes the log of a recording folder in a temporary folder, which is returned with the log's path.
pub(crate) fn log_of_recording(folder: &Path) -> Result<(tempfile::TempDir, PathBuf)> {
    let config = PipelineConfig::default();
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let recording = Recording::open(folder, EXTERNAL_POINT_STD)?;
    let mut pipeline = Pipeline::new(&setup, &config)?;
    let place = tempfile::tempdir().context("cannot make a temporary folder for the recording")?;
    let log = place.path().join("recording.mcap");
    let source = format!("locate {}", folder.display());
    // Exact images, so that vision can be computed again with other settings.
    let log_config = LogConfig {
        images: ImageCompression::Png,
        ..LogConfig::default()
    };
    let mut recorder = start_log(&log, &source, None, (&setup, &config), &log_config)?;
    let bar = crate::progress::bar(recording.frames() as u64, "frames");
    for cycle in recording.filter_map(|sample| pipeline.process_sample(sample)) {
        recorder.record_cycle(Arc::new(cycle))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    recorder.finish()?;
    Ok((place, log))
}
