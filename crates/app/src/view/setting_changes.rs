//! Which settings changed during a run, and what changed with them?

use pipeline::PipelineConfig;

use super::time_series::{Quantity, TimeSeries};
use crate::run::tuning::describe_changes;

/// Time before and after a change over which its effect is measured, seconds.
const EFFECT_SECONDS: f64 = 10.0;
/// Time after a change that is left out: the filter still remembers the former settings, seconds.
const SETTLING_SECONDS: f64 = 0.5;
/// What is compared before and after a change: name, quantity, factor to its unit, unit.
const EFFECTS: [(&str, Quantity, f32, &str); 6] = [
    ("points on markings", Quantity::OnMarkings, 100.0, "%"),
    ("residual", Quantity::Residual, 100.0, "cm"),
    ("line points", Quantity::LinePoints, 1.0, ""),
    ("position error", Quantity::PositionError, 100.0, "cm"),
    ("vision", Quantity::VisionTime, 1.0, "ms"),
    ("localization", Quantity::LocalizationTime, 1.0, "ms"),
];

/// A change of the settings.
#[derive(Debug, Clone)]
pub(crate) struct SettingChange {
    /// Stamp of the first cycle with them, seconds.
    pub(crate) time: f64,
    /// The changed settings: `vision.scan.range_max 9 → 7`.
    pub(crate) text: String,
    config: PipelineConfig,
}

/// The changes of a run, in time order.
#[derive(Debug, Default)]
pub(crate) struct SettingChanges(Vec<SettingChange>);

impl SettingChanges {
    /// All changes.
    pub(crate) fn all(&self) -> &[SettingChange] {
        &self.0
    }

    /// The settings before a change; None: those of the start.
    pub(crate) fn before(&self, number: usize) -> Option<&PipelineConfig> {
        Some(&self.0.get(number.checked_sub(1)?)?.config)
    }

    /// Adds a change; `first`: the settings of the start.
    pub(crate) fn push(&mut self, time: f64, config: &PipelineConfig, first: &PipelineConfig) {
        let before = self.0.last().map_or(first, |last| &last.config);
        let text = describe_changes(before, config).unwrap_or_else(|error| format!("{error:#}"));
        self.0.push(SettingChange {
            time,
            text,
            config: config.clone(),
        });
    }

    /// The same, with the settings as TOML.
    pub(crate) fn push_toml(&mut self, time: f64, config_toml: &str, first: &PipelineConfig) {
        match PipelineConfig::parse(config_toml) {
            Ok(config) => self.push(time, &config, first),
            // Settings of another version still show when they changed.
            Err(error) => self.0.push(SettingChange {
                time,
                text: format!("unreadable settings: {}", error.message()),
                config: first.clone(),
            }),
        }
    }
}

/// Mean values before and after a change at `time`; `until`: the next change.
pub(crate) fn effect_text(series: &TimeSeries, time: f64, until: f64) -> String {
    let mean = |from: f64, to: f64, quantity: Quantity| {
        let samples = series.samples();
        let start = samples.partition_point(|sample| sample.time < from);
        let end = samples.partition_point(|sample| sample.time < to);
        let values = samples[start..end.max(start)]
            .iter()
            .map(|sample| sample.value(quantity));
        let (sum, count) = values
            .filter(|value| value.is_finite())
            .fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
        (count > 0).then(|| sum / count as f32)
    };
    let end = until.min(time + SETTLING_SECONDS + EFFECT_SECONDS);
    let parts = EFFECTS.iter().filter_map(|(name, quantity, factor, unit)| {
        let before = mean(time - EFFECT_SECONDS, time, *quantity)? * factor;
        let after = mean(time + SETTLING_SECONDS, end, *quantity)? * factor;
        Some(format!("{name} {before:.2} → {after:.2} {unit}"))
    });
    let parts: Vec<String> = parts.collect();
    if parts.is_empty() {
        "no cycles before and after it yet".to_owned()
    } else {
        parts.join(", ")
    }
}
