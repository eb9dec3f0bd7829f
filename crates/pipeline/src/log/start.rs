//! What does a log of this run begin with? Robot, field, map, settings and seed, so that it can be run again.

use std::path::Path;

use anyhow::{Context, Result};

use crate::config::{PIPELINE_FILE, PipelineConfig};
use crate::feed::Pace;
use crate::log::{Header, LogConfig, Recorder};
use crate::setup::Setup;

/// Starts the log of a run that waits for its log: a simulation or a recording, nothing is dropped.
///
/// `source`: the command and its main argument.
pub fn start_log(
    path: &Path,
    source: &str,
    seed: Option<u64>,
    (setup, config): (&Setup, &PipelineConfig),
    log_config: &LogConfig,
) -> Result<Recorder> {
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let settings = toml::to_string(config).context("cannot write the settings")?;
    let header = Header::new(source, seed)
        .with_robot(&setup.robot, map, setup.colours.as_ref())?
        .with_file(PIPELINE_FILE, settings);
    Recorder::create(path, &header, &setup.field, Pace::Lockstep, log_config)
}
