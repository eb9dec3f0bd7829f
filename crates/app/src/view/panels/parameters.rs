//! Parameters panel: all settings of vision and localization with unit and meaning. Changed values are marked.

use std::path::Path;

use anyhow::Context;
use eframe::egui::{self, Color32, RichText, Ui};

use crate::view::accessibility::AccessibleLabel;
use crate::view::palette;
use crate::view::session::Session;
use crate::view::settings::{self, Setting};
use crate::view::source::sim_worker::SourceRequest;
use pipeline::PipelineConfig;

/// Width of the name column, points.
const NAME_WIDTH: f32 = 170.0;

/// State of the panel.
pub(crate) struct ParametersPanel {
    all: Vec<Setting>,
    /// Settings in use: for the simulation, the rendered layers, and a recomputed log.
    config: PipelineConfig,
    /// Edited settings, perhaps invalid.
    edited_table: toml::Table,
    /// Title of the source that the settings belong to.
    source_name: Option<String>,
    /// Show only settings whose name or description contains this text.
    filter: String,
    /// Show only settings that differ from the default.
    only_changed: bool,
    /// Path of the overlay file.
    file: String,
    /// Phrase under which a robot accepts changes.
    key: String,
    /// Result of the last edit, save or load; true if it succeeded.
    message: Option<(bool, String)>,
}

impl Default for ParametersPanel {
    fn default() -> Self {
        let config = PipelineConfig::default();
        ParametersPanel {
            all: settings::list_settings(),
            edited_table: toml::Table::try_from(&config).unwrap_or_default(),
            config,
            source_name: None,
            filter: String::new(),
            only_changed: false,
            file: "overlay.toml".to_owned(),
            key: String::new(),
            message: None,
        }
    }
}

impl ParametersPanel {
    /// The settings in use.
    pub(crate) fn config(&self) -> &PipelineConfig {
        &self.config
    }

    /// Takes over the settings of a newly opened source.
    pub(crate) fn sync_with_session(&mut self, session: &Session) {
        if self.source_name.as_ref() != Some(&session.title) {
            self.source_name = Some(session.title.clone());
            self.set_config(session.source_config.clone());
        }
    }

    fn set_config(&mut self, config: PipelineConfig) {
        self.edited_table = toml::Table::try_from(&config).unwrap_or_default();
        self.config = config;
    }

    /// Applies settings to the simulation, which takes them between two cycles, and to the rendered layers.
    pub(crate) fn apply_config(&mut self, session: &mut Session, config: PipelineConfig) {
        self.set_config(config);
        session.revision += 1;
        if let Some(worker) = session.source.simulation() {
            worker.request(SourceRequest::Configure(Box::new(self.config.clone())));
        }
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.sync_with_session(session);
        self.actions(ui, session);
        self.robot_actions(ui, session);
        if let Some((ok, text)) = &self.message {
            ui.colored_label(
                if *ok {
                    palette::GREEN
                } else {
                    palette::VERMILION
                },
                text,
            );
        }
        if let Some(worker) = session.source.simulation()
            && let Some(error) = worker.status().error
        {
            ui.colored_label(palette::VERMILION, error);
        }
        ui.horizontal(|ui| {
            ui.label("Search");
            ui.add(egui::TextEdit::singleline(&mut self.filter).desired_width(160.0))
                .with_accessible_label("Search");
            ui.checkbox(&mut self.only_changed, "Only what differs");
        });
        let mut changed = None;
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| changed = self.table(ui));
        if let Some((path, value)) = changed {
            self.set_value(session, &path, value);
        }
    }

    fn actions(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Preset", |ui| {
                for name in localize::presets::PRESETS {
                    if ui.button(name).clicked() {
                        match PipelineConfig::preset(name) {
                            Ok(config) => self.apply_config(session, config),
                            Err(error) => self.message = Some((false, format!("{error:#}"))),
                        }
                    }
                }
            });
            if session.log_path().is_some() {
                let hint =
                    "Recomputes the whole log with these settings, for comparison with the recorded run";
                if ui.button("Recompute log").on_hover_text(hint).clicked() {
                    session.start_recompute(&self.config);
                }
                if ui.button("As recorded").clicked() {
                    self.apply_config(session, session.source_config.clone());
                }
            }
            ui.add(egui::TextEdit::singleline(&mut self.file).desired_width(140.0))
                .with_accessible_label("Configuration file");
            let hint =
                "Writes the settings that differ from the defaults, for --config of run, sim and locate";
            if ui.button("Save overlay").on_hover_text(hint).clicked() {
                self.message = Some(self.save_overlay());
            }
            if ui.button("Load overlay").clicked() {
                match PipelineConfig::load("default", Some(Path::new(&self.file))) {
                    Ok(config) => {
                        self.apply_config(session, config);
                        self.message = Some((true, format!("loaded {}", self.file)));
                    }
                    Err(error) => self.message = Some((false, format!("{error:#}"))),
                }
            }
        });
    }

    /// Sends the edited settings to a robot that plays, or returns it to those of its start.
    fn robot_actions(&mut self, ui: &mut Ui, session: &mut Session) {
        let Some(remote) = session.source.remote_settings() else {
            return;
        };
        let status = remote.status();
        if !status.available {
            ui.weak(
                "This robot accepts no changes: set tuning = true in [stream] of its network.toml",
            );
            return;
        }
        let mut revoked = false;
        ui.horizontal_wrapped(|ui| {
            if status.needs_key {
                let edit = egui::TextEdit::singleline(&mut self.key).password(true);
                ui.add(edit.desired_width(140.0))
                    .with_accessible_label("Key");
            }
            // Relative to the start, so that the result does not depend on what others have changed meanwhile.
            let start = "revoke = true\n";
            let hint =
                "The robot takes the settings of this panel between two images, and logs them";
            if ui.button("Send to robot").on_hover_text(hint).clicked() {
                let overlay = settings::diff_overlay(&session.source_config, &self.config);
                remote.change(format!("{start}{overlay}"), &self.key);
            }
            let hint = "The robot returns to the settings of its start";
            if ui.button("Revoke").on_hover_text(hint).clicked() {
                remote.change(start.to_owned(), &self.key);
                revoked = true;
            }
        });
        ui.label(status.message);
        if revoked {
            self.apply_config(session, session.source_config.clone());
        }
    }

    fn save_overlay(&self) -> (bool, String) {
        let overlay = settings::diff_overlay(&PipelineConfig::default(), &self.config);
        let count = self
            .all
            .iter()
            .filter(|setting| settings::get(&overlay, &setting.path).is_some())
            .count();
        match std::fs::write(&self.file, overlay.to_string()) {
            Ok(()) => (true, format!("wrote {count} settings to {}", self.file)),
            Err(error) => (false, format!("cannot write {}: {error}", self.file)),
        }
    }

    /// Changes settings on behalf of another panel; errors are shown in this panel.
    pub(crate) fn edit_config(
        &mut self,
        session: &mut Session,
        change: impl FnOnce(&mut PipelineConfig),
    ) {
        let mut config = self.config.clone();
        change(&mut config);
        match config.check() {
            Ok(()) => self.apply_config(session, config),
            Err(error) => self.message = Some((false, error.to_string())),
        }
    }

    /// Applies a value if it is valid; otherwise shows the error.
    fn set_value(&mut self, session: &mut Session, path: &[String], value: toml::Value) {
        match value.as_str() {
            Some(settings::NOT_SET) => settings::remove(&mut self.edited_table, path),
            _ => settings::set(&mut self.edited_table, path, value),
        }
        let result = self
            .edited_table
            .clone()
            .try_into::<PipelineConfig>()
            .map_err(anyhow::Error::from)
            .and_then(|config| {
                config.check()?;
                Ok(config)
            })
            .with_context(|| format!("invalid value for {}", path.join(".")));
        match result {
            Ok(config) => {
                self.apply_config(session, config);
                self.message = None;
            }
            Err(error) => self.message = Some((false, format!("{error:#}"))),
        }
    }

    /// Draws the rows; returns the changed setting.
    fn table(&self, ui: &mut Ui) -> Option<(Vec<String>, toml::Value)> {
        let filter = self.filter.to_lowercase();
        let mut changed = None;
        let mut section = String::new();
        for setting in &self.all {
            let name = setting.name();
            let matches = filter.is_empty()
                || name.to_lowercase().contains(&filter)
                || setting.help.to_lowercase().contains(&filter);
            let unset = toml::Value::from(settings::NOT_SET);
            let value = settings::get(&self.edited_table, &setting.path).unwrap_or(&unset);
            let differs = settings::round_to_f32(value) != setting.default;
            if !matches || (self.only_changed && !differs) {
                continue;
            }
            let (last, parents) = (setting.path.last(), setting.path.split_last());
            let parent = parents.map_or(String::new(), |(_, parents)| parents.join("."));
            if parent != section {
                ui.add_space(4.0);
                ui.strong(&parent);
                section = parent;
            }
            ui.horizontal(|ui| {
                let mark = if differs { "*" } else { " " };
                ui.monospace(RichText::new(mark).color(palette::ORANGE).strong());
                let text = last.map_or("", String::as_str);
                let text = if differs {
                    RichText::new(text).color(accent(ui)).strong()
                } else {
                    RichText::new(text)
                };
                let help = format!("{}\n\nDefault: {}", setting.help, setting.default);
                let size = egui::Vec2::new(NAME_WIDTH, ui.spacing().interact_size.y);
                let left = egui::Layout::left_to_right(egui::Align::Center);
                ui.allocate_ui_with_layout(size, left, |ui| {
                    ui.set_min_width(NAME_WIDTH);
                    ui.add(egui::Label::new(text).truncate())
                        .on_hover_text(&help);
                });
                if let Some(value) = editor(ui, setting, value) {
                    changed = Some((setting.path.clone(), value));
                }
                ui.label(setting.unit);
                if differs && ui.small_button("Default").clicked() {
                    changed = Some((setting.path.clone(), setting.default.clone()));
                }
                ui.add(egui::Label::new(RichText::new(&setting.help).weak()).truncate())
                    .on_hover_text(help);
            });
        }
        changed
    }
}

fn accent(ui: &Ui) -> Color32 {
    if ui.visuals().dark_mode {
        palette::ORANGE
    } else {
        palette::BLUE
    }
}

/// Edits a value; returns the new one if it changed.
fn editor(ui: &mut Ui, setting: &Setting, value: &toml::Value) -> Option<toml::Value> {
    match value {
        toml::Value::Boolean(on) => {
            let mut on = *on;
            ui.checkbox(&mut on, "")
                .with_accessible_label(&setting.name())
                .changed()
                .then(|| on.into())
        }
        toml::Value::Integer(number) => {
            let mut number = *number;
            let drag = egui::DragValue::new(&mut number).update_while_editing(false);
            ui.add(drag)
                .with_accessible_label(&setting.name())
                .changed()
                .then(|| number.into())
        }
        toml::Value::Float(number) => drag(ui, &setting.name(), *number).map(toml::Value::Float),
        toml::Value::String(text) if !setting.choices.is_empty() => {
            let mut chosen = text.clone();
            egui::ComboBox::from_id_salt(setting.name())
                .selected_text(text)
                .show_ui(ui, |ui| {
                    for choice in &setting.choices {
                        ui.selectable_value(&mut chosen, choice.clone(), choice);
                    }
                })
                .response
                .with_accessible_label(&setting.name());
            (chosen != *text).then(|| chosen.into())
        }
        toml::Value::Array(values) if values.iter().any(toml::Value::is_float) => {
            let mut values = values.clone();
            let mut changed = false;
            for value in &mut values {
                if let Some(number) = value
                    .as_float()
                    .and_then(|number| drag(ui, &setting.name(), number))
                {
                    *value = toml::Value::Float(number);
                    changed = true;
                }
            }
            changed.then_some(toml::Value::Array(values))
        }
        // Image windows are edited in the Calibration panel.
        toml::Value::Array(values) => {
            ui.monospace(format!("{} set", values.len()));
            None
        }
        toml::Value::Table(_) => {
            ui.monospace("set");
            None
        }
        other => {
            ui.monospace(other.to_string().trim_matches('"'));
            None
        }
    }
}

fn drag(ui: &mut Ui, name: &str, number: f64) -> Option<f64> {
    // Show the shortest decimal of the f32 value.
    let mut short: f64 = format!("{:?}", number as f32).parse().unwrap_or(number);
    let speed = (short.abs() * 0.01).max(0.001);
    let drag = egui::DragValue::new(&mut short)
        .speed(speed)
        .max_decimals(6)
        .update_while_editing(false);
    ui.add(drag)
        .with_accessible_label(name)
        .changed()
        .then_some(short)
}
