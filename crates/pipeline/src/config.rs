//! What may be set? All settings of the stages, from a preset and an overlay file, checked.

use std::path::Path;

use anyhow::{Result, anyhow};
use localize::config::{LocalizeConfig, SettingError};
use localize::team::TeamConfig;
use localize::toml_file::{self, TomlFileError};
use localize::toml_location::key_location;
use localize::world::WorldConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vision::config::VisionConfig;

mod renamed_keys;

pub use renamed_keys::{RENAMED_KEYS, RENAMED_VALUES};

pub(crate) use renamed_keys::translate;

/// The name under which a log and a recording folder hold these settings.
pub const PIPELINE_FILE: &str = "pipeline.toml";

/// Settings of all stages. A preset or an overlay file changes single values.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use pipeline::PipelineConfig;
/// use pipeline::config::apply_overlay;
///
/// let paper = PipelineConfig::preset("minho2016")?;
/// let overlay = "vision.scan.range_max = 7.0".parse()?;
/// assert_eq!(apply_overlay(&paper, overlay)?.vision.scan.range_max, 7.0);
///
/// let error = apply_overlay(&paper, "vision.scan.range_max = -1".parse()?).unwrap_err();
/// assert!(error.to_string().starts_with("vision.scan.range_max = -1: must be between"));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// From an image to features.
    pub vision: VisionConfig,
    /// From features and motion to a pose.
    pub localize: LocalizeConfig,
    /// Tracking of ball and robots.
    pub world: WorldConfig,
    /// Fusion of what team-mates report.
    pub team: TeamConfig,
}

impl PipelineConfig {
    /// A preset, overridden by the values of an overlay file.
    pub fn load(preset: &str, overlay: Option<&Path>) -> Result<Self> {
        let base = PipelineConfig::preset(preset)?;
        let Some(path) = overlay else {
            return Ok(base);
        };
        let (overlay, text): (toml::Table, _) = toml_file::read(path)?;
        renamed_keys::refuse_renamed(&overlay, Some((path, &text)))?;
        // Alone first: an unknown key or a wrong type is named with its line.
        PipelineConfig::parse(&text).map_err(|error| TomlFileError::parse(path, error))?;
        apply_overlay(&base, overlay).map_err(|error| {
            let key = error.downcast_ref().map(|SettingError { key, .. }| key);
            let place = key_location(path, &text, key.map_or("", String::as_str));
            anyhow!("{place}: {error:#}")
        })
    }

    /// Parses settings; values are not checked. Here, so that the parser of all settings is compiled once.
    ///
    /// # Errors
    /// Invalid TOML, an unknown key, or a value of another type, with its line.
    pub fn parse(text: &str) -> Result<Self, toml::de::Error> {
        toml::from_str(text)
    }

    /// All settings as a table.
    ///
    /// # Errors
    /// A whole number above 2^63 - 1.
    pub fn to_table(&self) -> Result<toml::Table, toml::ser::Error> {
        toml::Table::try_from(self)
    }

    /// Refuses values that cannot work, and names the first.
    pub fn check(&self) -> Result<(), SettingError> {
        self.vision.check()?;
        self.localize.check()?;
        self.world.check()?;
        self.team.check()
    }
}

/// Settings overridden by those of an overlay, checked.
pub fn apply_overlay(base: &PipelineConfig, overlay: toml::Table) -> Result<PipelineConfig> {
    renamed_keys::refuse_renamed(&overlay, None)?;
    let mut merged = base.to_table()?;
    merge_tables(&mut merged, overlay);
    let config: PipelineConfig = merged
        .try_into()
        .map_err(|error| anyhow!(toml_file::in_plain_words(&error)))?;
    config.check()?;
    Ok(config)
}

/// Replaces values of `base` by those of `overlay`, table by table.
pub fn merge_tables(base: &mut toml::Table, overlay: toml::Table) {
    for (key, value) in overlay {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(overlay)) => {
                merge_tables(base, overlay);
            }
            (_, value) => drop(base.insert(key, value)),
        }
    }
}
