//! The settings in use, and the edited table they come from.

use std::path::Path;

use anyhow::{Context, Result};
use pipeline::PipelineConfig;
use pipeline::config::apply_overlay;
use vision::output_file::write_file;

use super::settings::{self, Setting};
use super::status_message::StatusMessage;

/// Settings of the simulation, of the rendered layers, and of a recomputed log.
pub(crate) struct SettingsState {
    all: Vec<Setting>,
    config: PipelineConfig,
    /// Edited settings, perhaps invalid.
    edited_table: toml::Table,
    /// Outcome of the last edit, save or load.
    pub(crate) message: Option<StatusMessage>,
}

impl SettingsState {
    /// Starts from the settings that a source runs with.
    pub(crate) fn new(config: PipelineConfig) -> Self {
        SettingsState {
            all: settings::list_settings(),
            edited_table: config.to_table().unwrap_or_default(),
            config,
            message: None,
        }
    }

    /// All settings with unit, meaning and default.
    pub(crate) fn all(&self) -> &[Setting] {
        &self.all
    }

    /// The valid settings in use.
    pub(crate) fn config(&self) -> &PipelineConfig {
        &self.config
    }

    /// The settings as edited; an invalid value stays visible until it is corrected.
    pub(crate) fn edited_table(&self) -> &toml::Table {
        &self.edited_table
    }

    /// Replaces all settings by valid ones.
    pub(crate) fn set_config(&mut self, config: PipelineConfig) {
        self.edited_table = config.to_table().unwrap_or_default();
        self.config = config;
    }

    /// The settings after an edit of one value.
    ///
    /// # Errors
    /// A value of the wrong type or out of bounds; the settings in use stay.
    pub(crate) fn edit_value(
        &mut self,
        path: &[String],
        value: toml::Value,
    ) -> Result<PipelineConfig> {
        match value.as_str() {
            Some(settings::NOT_SET) => settings::remove(&mut self.edited_table, path),
            _ => settings::set(&mut self.edited_table, path, value),
        }
        apply_overlay(&PipelineConfig::default(), self.edited_table.clone())
            .with_context(|| format!("invalid value for {}", path.join(".")))
    }

    /// Writes the settings that differ from the defaults; returns a summary.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn save_overlay(&self, path: &Path) -> Result<String> {
        let overlay = settings::diff_overlay(&PipelineConfig::default(), &self.config);
        let count = self
            .all
            .iter()
            .filter(|setting| settings::get(&overlay, &setting.path).is_some())
            .count();
        write_file(path, overlay.to_string())
            .with_context(|| format!("cannot write {}", path.display()))?;
        Ok(format!("wrote {count} settings to {}", path.display()))
    }
}
