//! What is done with the path that a dialog asked for?

use eframe::egui;

use super::file_dialog::{Answer, FileDialog, Purpose};
use super::layout_file::SavedLayout;
use super::shell::{ScreenshotTarget, View};

impl View {
    /// Asks for a path for a purpose.
    pub(crate) fn ask(&mut self, purpose: Purpose) {
        let time = self.session.playback.time;
        let proposed = match purpose {
            Purpose::Open | Purpose::OpenBeside => {
                let last = self.recent_files.first().and_then(|path| path.parent());
                last.map_or(String::new(), |folder| {
                    folder.join("").display().to_string()
                })
            }
            Purpose::SaveScreenshot => format!("mirrorball_{time:.3}s.png"),
            Purpose::SaveReport => format!("mirrorball_report_{time:.3}s"),
            Purpose::LoadLayout | Purpose::SaveLayout => "layout.json".to_owned(),
        };
        self.dialog = Some(FileDialog::new(purpose, &proposed));
    }

    /// Shows the open dialog, and does what was asked for.
    pub(crate) fn show_dialog(&mut self, ctx: &egui::Context) {
        let answer = match &mut self.dialog {
            Some(dialog) => dialog.show(ctx),
            None => return,
        };
        let (purpose, path) = match answer {
            Answer::Open => return,
            Answer::Cancelled => {
                self.dialog = None;
                return;
            }
            Answer::Chosen(purpose, path) => (purpose, path),
        };
        self.dialog = None;
        match purpose {
            Purpose::Open => self.open(&path, ctx),
            Purpose::OpenBeside => self.open_beside(&path),
            Purpose::SaveScreenshot => {
                self.request_screenshot(ctx, ScreenshotTarget::File(path));
            }
            Purpose::SaveReport => self.request_screenshot(ctx, ScreenshotTarget::Report(path)),
            Purpose::LoadLayout => {
                let loaded = SavedLayout::load(&path);
                if let Some(saved) = self.take_result(loaded) {
                    self.restore_layout(saved);
                }
            }
            Purpose::SaveLayout => {
                let saved = SavedLayout::of(self.layout, &self.tree, &self.panels);
                if self.take_result(saved.save(&path)).is_some() {
                    self.status_message = Some(format!("wrote {}", path.display()));
                }
            }
        }
    }
}
