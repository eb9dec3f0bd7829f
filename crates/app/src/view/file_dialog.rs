//! Asks for a file: a window with the folder's content and a path to type. The keyboard is sufficient.

use std::path::{Path, PathBuf};

use eframe::egui::{self, Key};

use super::accessibility::AccessibleLabel;

/// Entries of a folder that are listed.
const LISTED_MAX: usize = 500;

/// What the chosen path is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Open a log, a recording folder or a scenario.
    Open,
    /// Open a log or a stream on the timeline of the shown run.
    OpenBeside,
    /// Write a screenshot.
    SaveScreenshot,
    /// Write a report's folder.
    SaveReport,
    /// Read a layout.
    LoadLayout,
    /// Write the layout.
    SaveLayout,
}

impl Purpose {
    fn title(self) -> &'static str {
        match self {
            Purpose::Open => "Open a log, a recording folder, a scenario, or host:port",
            Purpose::OpenBeside => "Open another log or host:port beside this run",
            Purpose::SaveScreenshot => "Save a screenshot as",
            Purpose::SaveReport => "Save a report in the folder",
            Purpose::LoadLayout => "Open a layout",
            Purpose::SaveLayout => "Save the layout as",
        }
    }

    fn button(self) -> &'static str {
        match self {
            Purpose::Open | Purpose::OpenBeside | Purpose::LoadLayout => "Open",
            Purpose::SaveScreenshot | Purpose::SaveReport | Purpose::SaveLayout => "Save",
        }
    }

    /// Endings of the files that are listed.
    fn endings(self) -> &'static [&'static str] {
        match self {
            Purpose::Open => &["mcap", "toml"],
            Purpose::OpenBeside => &["mcap"],
            Purpose::SaveScreenshot => &["png"],
            Purpose::SaveReport => &[],
            Purpose::LoadLayout | Purpose::SaveLayout => &["json"],
        }
    }
}

/// An open dialog.
#[derive(Debug)]
pub(crate) struct FileDialog {
    purpose: Purpose,
    /// What is typed.
    text: String,
    /// The folder whose content is listed, and its subfolders and files.
    folder: PathBuf,
    entries: Vec<PathBuf>,
    /// The field takes the keys from the first frame on.
    focused: bool,
}

/// What has become of a dialog.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Answer {
    Open,
    Cancelled,
    Chosen(Purpose, PathBuf),
}

impl FileDialog {
    /// Opens a dialog with a proposed path.
    pub(crate) fn new(purpose: Purpose, proposed: &str) -> Self {
        let folder = Path::new(proposed).parent().unwrap_or(Path::new(""));
        let mut dialog = FileDialog {
            purpose,
            text: proposed.to_owned(),
            folder: PathBuf::new(),
            entries: Vec::new(),
            focused: false,
        };
        dialog.enter(folder.to_owned());
        dialog
    }

    /// Lists a folder; the empty path is the working folder.
    fn enter(&mut self, folder: PathBuf) {
        let listed = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            &folder
        };
        let endings = self.purpose.endings();
        let fits = |path: &PathBuf| {
            let ending = path.extension().and_then(|ending| ending.to_str());
            path.is_dir() || ending.is_some_and(|ending| endings.contains(&ending))
        };
        let is_hidden = |path: &PathBuf| {
            let name = path.file_name().map(|name| name.to_string_lossy());
            name.is_some_and(|name| name.starts_with('.'))
        };
        let entries = std::fs::read_dir(listed).into_iter().flatten().flatten();
        let entries = entries.map(|entry| folder.join(entry.file_name()));
        self.entries = entries
            .filter(|path| fits(path) && !is_hidden(path))
            .take(LISTED_MAX)
            .collect();
        self.entries
            .sort_by_key(|path| (!path.is_dir(), path.clone()));
        self.folder = folder;
    }

    /// Draws the dialog.
    pub(crate) fn show(&mut self, ctx: &egui::Context) -> Answer {
        let mut answer = Answer::Open;
        let mut open = true;
        egui::Window::new(self.purpose.title())
            .open(&mut open)
            .collapsible(false)
            .default_width(460.0)
            .show(ctx, |ui| {
                let field = ui
                    .add(egui::TextEdit::singleline(&mut self.text).desired_width(f32::INFINITY))
                    .with_accessible_label("path");
                if !std::mem::replace(&mut self.focused, true) {
                    field.request_focus();
                }
                let entered = field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
                self.list(ui);
                ui.horizontal(|ui| {
                    if ui.button(self.purpose.button()).clicked() || entered {
                        let path = PathBuf::from(self.text.trim());
                        answer = Answer::Chosen(self.purpose, path);
                    }
                    if ui.button("Cancel").clicked() {
                        answer = Answer::Cancelled;
                    }
                });
            });
        if !open || ctx.input(|input| input.key_pressed(Key::Escape)) {
            answer = Answer::Cancelled;
        }
        answer
    }

    fn list(&mut self, ui: &mut egui::Ui) {
        let mut enter = None;
        egui::ScrollArea::vertical()
            .max_height(300.0)
            .auto_shrink([false, true])
            .show(ui, |ui| {
                if ui.selectable_label(false, "..").clicked() {
                    let folder = std::path::absolute(self.folder.join(".")).ok();
                    enter = folder.and_then(|folder| folder.parent().map(Path::to_owned));
                }
                for path in &self.entries {
                    let name = path.file_name().unwrap_or_default().to_string_lossy();
                    let text = if path.is_dir() {
                        format!("{name}/")
                    } else {
                        name.into_owned()
                    };
                    if ui.selectable_label(false, text).clicked() {
                        self.text = path.display().to_string();
                        enter = path.is_dir().then(|| path.clone());
                    }
                }
            });
        if let Some(folder) = enter {
            self.text = folder.display().to_string();
            self.enter(folder);
        }
    }
}
