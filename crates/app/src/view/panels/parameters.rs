//! Parameters panel: all settings of vision and localization with unit and meaning. Changed values are marked.

use std::path::Path;

use eframe::egui::{self, Color32, RichText, Ui};

use crate::run::tuning::AUTHOR_KEY;
use crate::view::accessibility::AccessibleLabel;
use crate::view::palette;
use crate::view::session::Session;
use crate::view::setting_changes::effect_text;
use crate::view::settings::{self, Setting};
use crate::view::settings_state::SettingsState;

/// Width of the name column, points.
const NAME_WIDTH: f32 = 215.0;

/// State of the panel.
pub(crate) struct ParametersPanel {
    /// Show only settings whose name or description contains this text.
    filter: String,
    /// Show only settings that differ from the default.
    only_changed: bool,
    /// Path of the overlay file.
    file: String,
    /// Phrase under which a robot accepts changes.
    key: String,
}

impl Default for ParametersPanel {
    fn default() -> Self {
        ParametersPanel {
            filter: String::new(),
            only_changed: false,
            file: "overlay.toml".to_owned(),
            key: String::new(),
        }
    }
}

impl ParametersPanel {
    /// Shows a setting alone.
    pub(crate) fn find(&mut self, name: &str) {
        name.clone_into(&mut self.filter);
        self.only_changed = false;
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.actions(ui, session);
        self.robot_actions(ui, session);
        if let Some(message) = &session.settings.message {
            ui.colored_label(palette::message_colour(message), &message.text);
        }
        if let Some(worker) = session.source.simulation()
            && let Some(error) = worker.status().error
        {
            ui.colored_label(palette::VERMILION, error);
        }
        self.changes(ui, session);
        ui.horizontal(|ui| {
            ui.label("Search");
            ui.add(egui::TextEdit::singleline(&mut self.filter).desired_width(160.0))
                .with_accessible_label("Search");
            ui.checkbox(&mut self.only_changed, "Only what differs");
        });
        let mut changed = None;
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| changed = self.table(ui, &session.settings));
        if let Some((path, value)) = changed {
            session.edit_setting(&path, value);
        }
    }

    fn actions(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Preset", |ui| {
                for name in localize::presets::PRESETS {
                    if ui.button(name).clicked() {
                        session.load_config(name, None);
                    }
                }
            });
            if session.log_path().is_some() {
                let hint =
                    "Recomputes the whole log with these settings, for comparison with the recorded run";
                if ui.button("Recompute log").on_hover_text(hint).clicked() {
                    session.start_recompute();
                }
                if ui.button("As recorded").clicked() {
                    session.apply_config(session.source_config.clone());
                }
            }
            ui.add(egui::TextEdit::singleline(&mut self.file).desired_width(140.0))
                .with_accessible_label("Configuration file");
            let hint =
                "Writes the settings that differ from the defaults, for --config of run, sim and locate";
            if ui.button("Save overlay").on_hover_text(hint).clicked() {
                session.save_overlay(Path::new(&self.file));
            }
            if ui.button("Load overlay").clicked() {
                session.load_config("default", Some(Path::new(&self.file)));
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
                let config = session.settings.config();
                let overlay = settings::diff_overlay(&session.source_config, config);
                remote.change(format!("{start}{}{overlay}", author_line()), &self.key);
            }
            let hint = "The robot returns to the settings of its start";
            if ui.button("Revoke").on_hover_text(hint).clicked() {
                remote.change(format!("{start}{}", author_line()), &self.key);
                revoked = true;
            }
        });
        ui.label(status.message);
        if revoked {
            session.apply_config(session.source_config.clone());
        }
    }

    /// Lists the changes during the run with their effect, and the robot's own list with the authors.
    fn changes(&self, ui: &mut Ui, session: &mut Session) {
        let history = session.source.remote_settings();
        let history = history.map_or(String::new(), |remote| remote.status().history);
        let count = session.setting_changes.all().len();
        if count == 0 && history.is_empty() {
            return;
        }
        let (mut seek_to, mut restore) = (None, None);
        egui::CollapsingHeader::new(format!("Changes during the run ({count})"))
            .default_open(true)
            .show(ui, |ui| {
                for line in history.lines() {
                    ui.label(RichText::new(line).small());
                }
                for (number, change) in session.setting_changes.all().iter().enumerate() {
                    ui.horizontal_wrapped(|ui| {
                        if ui.link(format!("{:.1} s", change.time)).clicked() {
                            seek_to = Some(change.time);
                        }
                        ui.label(&change.text);
                        if ui.small_button("Revert").clicked() {
                            restore = Some(number);
                        }
                    });
                    let next = session.setting_changes.all().get(number + 1);
                    let until = next.map_or(f64::INFINITY, |next| next.time);
                    ui.weak(effect_text(&session.series, change.time, until));
                }
            });
        if let Some(time) = seek_to {
            session.seek_stamp(time);
        }
        let before = restore.map(|number| session.setting_changes.before(number).cloned());
        if let Some(config) = before {
            let config = config.unwrap_or_else(|| session.source_config.clone());
            if let Some(remote) = session.source.remote_settings() {
                let overlay = settings::diff_overlay(&session.source_config, &config);
                let text = format!("revoke = true\n{}{overlay}", author_line());
                remote.change(text, &self.key);
            }
            session.apply_config(config);
        }
    }

    /// Draws the rows; returns the changed setting.
    fn table(&self, ui: &mut Ui, state: &SettingsState) -> Option<(Vec<String>, toml::Value)> {
        let filter = self.filter.to_lowercase();
        let mut changed = None;
        let mut section = String::new();
        for setting in state.all() {
            let name = setting.name();
            let matches = filter.is_empty()
                || name.to_lowercase().contains(&filter)
                || setting.help.to_lowercase().contains(&filter);
            let unset = toml::Value::from(settings::NOT_SET);
            let value = settings::get(state.edited_table(), &setting.path).unwrap_or(&unset);
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
                ui.add(egui::Label::new(RichText::new(&setting.help).weak().small()).wrap())
                    .on_hover_text(help);
            });
        }
        changed
    }
}

/// Names the user of this window as the author of a change.
fn author_line() -> String {
    let user = std::env::var("USER").unwrap_or_else(|_| "unknown".to_owned());
    let host = std::fs::read_to_string("/etc/hostname").unwrap_or_default();
    let author = format!("{user}@{}", host.trim());
    format!("{AUTHOR_KEY} = {}\n", toml::Value::from(author))
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
