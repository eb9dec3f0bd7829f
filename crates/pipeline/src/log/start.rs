//! How does the log of a run start? With robot, field, map, settings and seed, so that the run can be repeated.

use std::path::Path;

use anyhow::{Context, Result};

use super::config::LogConfig;
use super::header::Header;
use super::record::Recorder;
use crate::config::{PIPELINE_FILE, PipelineConfig};
use crate::feed::Pace;
use crate::setup::Setup;

/// Starts the log of a run that waits for the writer, such as a simulation. No cycle is dropped.
///
/// `source`: the command with its main argument.
pub fn start_log(
    path: &Path,
    source: &str,
    seed: Option<u64>,
    (setup, config): (&Setup, &PipelineConfig),
    log_config: &LogConfig,
) -> Result<Recorder> {
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let settings = config.to_table().context("cannot write the settings")?;
    let header = Header::new(source, seed)
        .with_robot(&setup.robot, map, setup.colours.as_ref())?
        .with_file(PIPELINE_FILE, settings.to_string());
    Recorder::create(path, &header, &setup.field, Pace::Lockstep, log_config)
}
