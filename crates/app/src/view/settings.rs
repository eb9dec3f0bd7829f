//! Names, meanings, units and defaults of all settings, from the JSON schema of the configuration structs.

use schemars::schema_for;
use serde_json::Value as Json;

use pipeline::PipelineConfig;

/// Placeholder for an optional value that is not set.
pub(crate) const NOT_SET: &str = "not set";

/// Description of one setting.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Setting {
    /// Keys from the root, for example vision, scan, range_max.
    pub(crate) path: Vec<String>,
    /// Meaning: the doc comment of its field.
    pub(crate) help: String,
    /// Unit; empty for counts, ratios and choices.
    pub(crate) unit: &'static str,
    /// Allowed values of a choice; empty otherwise.
    pub(crate) choices: Vec<String>,
    /// Default value.
    pub(crate) default: toml::Value,
}

impl Setting {
    /// The keys joined by dots.
    pub(crate) fn name(&self) -> String {
        self.path.join(".")
    }
}

/// All settings of vision and localization, section by section.
pub(crate) fn list_settings() -> Vec<Setting> {
    let schema = Json::from(schema_for!(PipelineConfig));
    let defaults = PipelineConfig::default().to_table().unwrap_or_default();
    let mut settings = Vec::new();
    collect(&schema, &schema, &defaults, &mut Vec::new(), &mut settings);
    settings
}

/// The value at a path.
pub(crate) fn get<'a>(table: &'a toml::Table, path: &[String]) -> Option<&'a toml::Value> {
    let (last, sections) = path.split_last()?;
    let mut table = table;
    for section in sections {
        table = table.get(section)?.as_table()?;
    }
    table.get(last)
}

/// Sets the value at a path, and creates missing sections.
pub(crate) fn set(table: &mut toml::Table, path: &[String], value: toml::Value) {
    let Some((last, sections)) = path.split_last() else {
        return;
    };
    let mut table = table;
    for section in sections {
        let entry = table
            .entry(section.clone())
            .or_insert_with(|| toml::Table::new().into());
        let Some(inner) = entry.as_table_mut() else {
            return;
        };
        table = inner;
    }
    table.insert(last.clone(), value);
}

/// Removes the value at a path.
pub(crate) fn remove(table: &mut toml::Table, path: &[String]) {
    let Some((last, sections)) = path.split_last() else {
        return;
    };
    let mut table = table;
    for section in sections {
        let Some(inner) = table.get_mut(section).and_then(toml::Value::as_table_mut) else {
            return;
        };
        table = inner;
    }
    table.remove(last);
}

/// The settings of `config` that differ from `base`, as an overlay for `--config`.
pub(crate) fn diff_overlay(base: &PipelineConfig, config: &PipelineConfig) -> toml::Table {
    let tables = [base, config].map(|config| config.to_table().unwrap_or_default());
    let mut overlay = toml::Table::new();
    for setting in list_settings() {
        let [before, after] = [&tables[0], &tables[1]].map(|table| get(table, &setting.path));
        if let (true, Some(value)) = (before != after, after) {
            set(&mut overlay, &setting.path, round_to_f32(value));
        }
    }
    overlay
}

/// Rounds floats to the shortest decimal of their f32 value: 0.1 instead of 0.10000000149.
pub(crate) fn round_to_f32(value: &toml::Value) -> toml::Value {
    match value {
        toml::Value::Float(number) => {
            let short = format!("{:?}", *number as f32).parse();
            toml::Value::Float(short.unwrap_or(*number))
        }
        toml::Value::Array(values) => toml::Value::Array(values.iter().map(round_to_f32).collect()),
        other => other.clone(),
    }
}

fn collect(
    root: &Json,
    schema: &Json,
    defaults: &toml::Table,
    path: &mut Vec<String>,
    settings: &mut Vec<Setting>,
) {
    let Some(properties) = schema.get("properties").and_then(Json::as_object) else {
        return;
    };
    for (key, property) in properties {
        // An optional setting is missing in the table of defaults.
        let unset = toml::Value::from(NOT_SET);
        let default = defaults.get(key).unwrap_or(&unset);
        path.push(key.clone());
        let target = resolve_ref(root, property);
        match default {
            toml::Value::Table(inner) => collect(root, target, inner, path, settings),
            default => {
                let description = property.get("description").and_then(Json::as_str);
                let help = description.or(target.get("description").and_then(Json::as_str));
                let help = help.unwrap_or_default().replace('\n', " ");
                settings.push(Setting {
                    unit: infer_unit(key, &help, default),
                    choices: choices(target),
                    path: path.clone(),
                    default: round_to_f32(default),
                    help,
                });
            }
        }
        path.pop();
    }
}

/// Resolves a `$ref` of the schema.
fn resolve_ref<'a>(root: &'a Json, schema: &'a Json) -> &'a Json {
    let inner = schema
        .get("allOf")
        .and_then(|all| all.get(0))
        .unwrap_or(schema);
    let pointer = inner.get("$ref").and_then(Json::as_str);
    let target = pointer.and_then(|pointer| root.pointer(pointer.trim_start_matches('#')));
    target.unwrap_or(inner)
}

fn choices(schema: &Json) -> Vec<String> {
    let texts = |values: &Vec<Json>| -> Vec<String> {
        values
            .iter()
            .filter_map(|value| value.as_str().map(str::to_owned))
            .collect()
    };
    if let Some(values) = schema.get("enum").and_then(Json::as_array) {
        return texts(values);
    }
    let variants = schema.get("oneOf").and_then(Json::as_array);
    let mut names = Vec::new();
    for variant in variants.into_iter().flatten() {
        names.extend(
            variant
                .get("const")
                .and_then(Json::as_str)
                .map(str::to_owned),
        );
        names.extend(
            variant
                .get("enum")
                .and_then(Json::as_array)
                .into_iter()
                .flat_map(texts),
        );
    }
    names
}

/// The unit from the key's suffix, else from the doc comment.
fn infer_unit(key: &str, help: &str, default: &toml::Value) -> &'static str {
    let number = matches!(
        default,
        toml::Value::Float(_) | toml::Value::Integer(_) | toml::Value::Array(_)
    );
    if !number {
        return "";
    }
    for (suffix, unit) in [
        ("_deg", "°"),
        ("_px", "px"),
        ("_ms", "ms"),
        ("_hz", "Hz"),
        ("_percent", "%"),
    ] {
        if key.ends_with(suffix) || key.contains(&format!("{suffix}_")) {
            return unit;
        }
    }
    for (phrase, unit) in [
        ("m/s²", "m/s²"),
        ("m/s", "m/s"),
        ("metres per square root", "m/√m"),
        ("radians per square root", "rad/√rad"),
        ("degrees per", "°/m"),
        ("metres per second", "m/s"),
        ("line widths", "line widths"),
        ("standard deviations", "σ"),
        (", metres", "m"),
        ("metres.", "m"),
        ("metres)", "m"),
        (", seconds", "s"),
        ("Seconds", "s"),
        ("seconds", "s"),
        (", degrees", "°"),
        ("radians", "rad"),
        (", pixels", "px"),
        ("turns;", "turns"),
    ] {
        if help.contains(phrase) {
            return unit;
        }
    }
    ""
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_has_a_description() {
        let settings = list_settings();
        assert!(settings.len() > 60, "{}", settings.len());
        for setting in &settings {
            assert!(!setting.help.is_empty(), "{}", setting.name());
        }
        let range = settings
            .iter()
            .find(|setting| setting.name() == "vision.scan.range_max")
            .expect("a setting");
        assert_eq!(
            (range.unit, &range.default),
            ("m", &toml::Value::Float(9.0))
        );
        let tracker = settings
            .iter()
            .find(|setting| setting.name() == "localize.tracker")
            .expect("a setting");
        assert_eq!(tracker.choices, ["matching", "scan_map", "none"]);
    }

    #[test]
    fn overlay_holds_only_changed_settings_and_round_trips() {
        let mut config = PipelineConfig::default();
        config.vision.scan.range_max = 7.1;
        config.localize.mode.suspect_frames_max = 3;
        let overlay = diff_overlay(&PipelineConfig::default(), &config);
        let text = overlay.to_string();
        assert!(text.contains("range_max = 7.1\n"), "{text}");
        assert_eq!(text.matches('=').count(), 2, "{text}");
        let back: PipelineConfig = PipelineConfig::parse(&text).expect("a configuration");
        assert_eq!(back.vision, config.vision);
        assert_eq!(back.localize, config.localize);
    }
}
