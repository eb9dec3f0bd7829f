//! The menu bar: files, panels, layouts, theme and scale.

use eframe::egui::{self, Ui};

use super::accessibility::AccessibleLabel;
use super::file_dialog::Purpose;
use super::layout::{self, LAYOUTS};
use super::palette;
use super::panels::PANES;
use super::shell::View;

/// Selectable interface scales.
const SCALES: [f32; 5] = [0.75, 1.0, 1.25, 1.5, 2.0];

impl View {
    pub(crate) fn menu_bar(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("File", |ui| self.file_menu(ui));
            ui.menu_button("View", |ui| self.view_menu(ui));
            for (layout, name) in LAYOUTS {
                if ui.selectable_label(self.layout == layout, name).clicked() {
                    self.set_layout(layout);
                }
            }
            if ui.button("?").on_hover_text("Shortcuts").clicked() {
                self.help_open = !self.help_open;
            }
            ui.separator();
            ui.label(&self.session.title);
            let source_problem = self.session.source_problem();
            if let Some(now) = &self.session.shown {
                let mode = now.cycle.estimate.mode;
                let text = self.session.mode_and_reason(&now.cycle.estimate);
                match &source_problem {
                    // What an old cycle says is not how the robot is.
                    Some(_) => ui.weak(text),
                    None if !self.session.holds_poses => ui.weak(text),
                    None => ui.colored_label(palette::mode_colour(mode), text),
                };
            }
            ui.weak(format!(
                "{:.0} frames/s",
                self.frame_rate.frames_per_second()
            ));
            if let Some(message) = &self.status_message {
                ui.weak(message);
            }
            let problems = self.problem.iter().chain(&self.session.last_error);
            for error in problems.chain(&source_problem) {
                ui.colored_label(palette::VERMILION, error);
            }
        });
    }

    fn file_menu(&mut self, ui: &mut Ui) {
        for (name, purpose) in [
            ("Open… (Ctrl+O)", Purpose::Open),
            ("Open beside… (Ctrl+Shift+O)", Purpose::OpenBeside),
            ("Screenshot… (Ctrl+S)", Purpose::SaveScreenshot),
            ("Report… (Ctrl+R)", Purpose::SaveReport),
        ] {
            if ui.button(name).clicked() {
                self.ask(purpose);
                ui.close();
            }
        }
        ui.separator();
        let mut chosen = None;
        for path in &self.recent_files {
            let name = path.file_name().unwrap_or(path.as_os_str());
            let button = ui.button(name.to_string_lossy());
            if button.on_hover_text(path.display().to_string()).clicked() {
                chosen = Some(path.clone());
            }
        }
        if let Some(path) = chosen {
            self.open(&path, &ui.ctx().clone());
            ui.close();
        }
        ui.separator();
        if ui.button("Quit (Ctrl+Q)").clicked() {
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
        }
    }

    fn view_menu(&mut self, ui: &mut Ui) {
        ui.strong("Panels");
        for pane in PANES {
            let mut shown = layout::contains_pane(&self.tree, pane);
            ui.horizontal(|ui| {
                if ui.checkbox(&mut shown, pane.title()).changed() {
                    layout::toggle_pane(&mut self.tree, pane);
                }
                let another = ui.small_button("+").on_hover_text("Another one");
                let name = format!("another panel {}", pane.title());
                if another.with_accessible_label(&name).clicked() {
                    layout::open_pane(&mut self.tree, pane);
                }
            });
        }
        for (name, purpose) in [
            ("Open a layout…", Purpose::LoadLayout),
            ("Save the layout…", Purpose::SaveLayout),
        ] {
            if ui.button(name).clicked() {
                self.ask(purpose);
                ui.close();
            }
        }
        ui.separator();
        ui.strong("Theme");
        let mut theme = ui.ctx().options(|options| options.theme_preference);
        for (choice, name) in [
            (egui::ThemePreference::Dark, "Dark"),
            (egui::ThemePreference::Light, "Light"),
            (egui::ThemePreference::System, "System"),
        ] {
            if ui.selectable_value(&mut theme, choice, name).clicked() {
                ui.ctx().set_theme(choice);
            }
        }
        ui.separator();
        ui.strong("Scale");
        let scale = ui.ctx().zoom_factor();
        for choice in SCALES {
            let name = format!("{:.0} %", 100.0 * choice);
            if ui.selectable_label(scale == choice, name).clicked() {
                ui.ctx().set_zoom_factor(choice);
            }
        }
    }
}
