//! What is done with files that are dropped on the window? Runs are opened, layouts are shown.

use std::path::Path;

use eframe::egui;

use super::layout_file::SavedLayout;
use super::shell::View;

/// What is expected of a dropped file.
const EXPECTED: &str = "a log (.mcap), a recording folder, a scenario (.toml) or a layout (.json)";

/// Kinds of files that can be dropped.
enum Dropped {
    Run,
    Layout,
    Unknown,
}

impl Dropped {
    fn of(path: &Path) -> Self {
        let ending = path.extension().and_then(|ending| ending.to_str());
        match ending.map(str::to_lowercase).as_deref() {
            _ if path.is_dir() => Dropped::Run,
            Some("mcap" | "toml") => Dropped::Run,
            Some("json") => Dropped::Layout,
            _ => Dropped::Unknown,
        }
    }
}

impl View {
    /// Opens dropped runs, the first one instead of the shown run and further ones beside it (with Shift all), and shows
    /// dropped layouts.
    pub(crate) fn take_dropped_files(&mut self, ctx: &egui::Context) {
        let (dropped, shifted) =
            ctx.input(|input| (input.raw.dropped_files.clone(), input.modifiers.shift));
        let mut beside = shifted;
        let mut problems = Vec::new();
        for file in dropped {
            let path = file.path();
            match Dropped::of(path) {
                Dropped::Run => {
                    if beside {
                        self.open_beside(path);
                    } else {
                        self.open(path, ctx);
                    }
                    beside = true;
                }
                Dropped::Layout => {
                    let layout = SavedLayout::load(path);
                    if let Some(layout) = self.take_result(layout) {
                        self.restore_layout(layout);
                    }
                }
                Dropped::Unknown => {
                    let problem = format!("cannot open {} (expected {EXPECTED})", path.display());
                    self.problem = Some(problem);
                }
            }
            problems.extend(self.problem.take());
        }
        if !problems.is_empty() {
            self.problem = Some(problems.join("; "));
        }
    }
}
