//! The window: a bar of menus, the tiles, and the keys. It asks the session on and gives the painter its jobs.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use eframe::egui::{self, Key, KeyboardShortcut, Modifiers, Ui};
use egui_tiles::Tree;

use super::accessibility::AccessibleLabel;
use super::frame_rate::FrameRateCounter;
use super::layer_worker::{LayerSelection, LayerWorker};
use super::layout::{self, LAYOUTS, PanelLayout};
use super::panels::{PANES, Pane, PaneBehavior, Panels};
use super::session::Session;
use super::source::Source;
use super::{palette, report, shortcuts};

/// Between two looks for news while nothing plays.
const IDLE_REPAINT_INTERVAL: Duration = Duration::from_millis(100);
/// From one frame to the next at least, while something plays: 60 frames a second.
pub(crate) const FRAME_INTERVAL: Duration = Duration::from_millis(16);
/// Scales to choose from.
const SCALES: [f32; 5] = [0.75, 1.0, 1.25, 1.5, 2.0];

/// What a picture of the window is for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ScreenshotTarget {
    /// A file of its own.
    File(PathBuf),
    /// Part of a report in a folder.
    Report(PathBuf),
}

/// Everything in the window.
pub(crate) struct View {
    pub(crate) session: Session,
    pub(crate) panels: Panels,
    pub(crate) tree: Tree<Pane>,
    pub(crate) layout: PanelLayout,
    pub(crate) help_open: bool,
    /// The file or scenario to open next.
    path_input: String,
    layer_worker: Option<LayerWorker>,
    /// When the last frame began; those who wake the window look at it too.
    last_frame_start: Arc<Mutex<Option<Instant>>>,
    /// How quickly it draws.
    pub(crate) frame_rate: FrameRateCounter,
    /// Pictures that were asked for and have not come yet.
    pub(crate) pending_screenshots: Vec<ScreenshotTarget>,
    screenshot_image: Arc<Mutex<Option<Arc<egui::ColorImage>>>>,
    /// What was done last, for the bar.
    pub(crate) status_message: Option<String>,
}

impl View {
    /// A window on a session.
    pub(crate) fn new(session: Session, preset: PanelLayout) -> Self {
        let mut view = View {
            session,
            panels: Panels::default(),
            tree: layout::build_tree(preset),
            layout: preset,
            help_open: false,
            path_input: String::new(),
            layer_worker: None,
            last_frame_start: Arc::default(),
            frame_rate: FrameRateCounter::default(),
            pending_screenshots: Vec::new(),
            screenshot_image: Arc::default(),
            status_message: None,
        };
        view.panels.parameters.sync_with_session(&view.session);
        view
    }

    /// Arranges the panels.
    pub(crate) fn set_layout(&mut self, preset: PanelLayout) {
        self.layout = preset;
        self.tree = layout::build_tree(preset);
    }

    /// Looks at something else.
    pub(crate) fn open(&mut self, path: &std::path::Path, ctx: &egui::Context) {
        match Session::open(path) {
            Ok(session) => {
                self.session = session;
                self.panels.parameters.sync_with_session(&self.session);
                self.repaint_on_cycle(ctx);
            }
            Err(error) => self.session.last_error = Some(format!("{error:#}")),
        }
    }

    /// Frames are drawn when cycles come.
    pub(crate) fn repaint_on_cycle(&self, ctx: &egui::Context) {
        if let Source::Live(live) = &self.session.source {
            let (ctx, begun) = (ctx.clone(), self.last_frame_start.clone());
            live.inbox().set_on_cycle(move || {
                let begun = *begun.lock().unwrap_or_else(PoisonError::into_inner);
                let passed = begun.map_or(FRAME_INTERVAL, |begun| begun.elapsed());
                ctx.request_repaint_after(FRAME_INTERVAL.saturating_sub(passed));
            });
        }
    }

    /// Draws the whole window.
    pub(crate) fn ui(&mut self, ui: &mut Ui) {
        let now = Instant::now();
        let last = self
            .last_frame_start
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .replace(now);
        let passed = last.map_or(0.0, |last| (now - last).as_secs_f64().min(0.5));
        self.frame_rate.record_frame(now);
        self.session.update(passed);
        self.update_layers(ui.ctx());
        shortcuts::handle_shortcuts(ui, self);
        egui::Panel::top("bar").show(ui, |ui| self.menu_bar(ui));
        // The window is cleared in the panels' colour; to fill it once more costs a software renderer a fifth of a frame.
        let bare = egui::Frame::central_panel(ui.style()).fill(egui::Color32::TRANSPARENT);
        egui::CentralPanel::default().frame(bare).show(ui, |ui| {
            let mut desk = PaneBehavior {
                session: &mut self.session,
                panels: &mut self.panels,
            };
            self.tree.ui(&mut desk, ui);
            if self.tree.is_empty() {
                ui.weak("All panels are closed: View opens them again.");
            }
        });
        if let Some(path) = self.panels.simulator.open_request.take() {
            self.open(&path, &ui.ctx().clone());
        }
        shortcuts::show_shortcut_list(ui.ctx(), &mut self.help_open);
        self.write_screenshots();
        let live = matches!(self.session.source, Source::Live(_));
        let plays = self.session.playback.playing && !live;
        ui.ctx().request_repaint_after(if plays {
            FRAME_INTERVAL
        } else {
            IDLE_REPAINT_INTERVAL
        });
    }

    /// Gives the painter what is seen, and takes what it painted.
    fn update_layers(&mut self, ctx: &egui::Context) {
        let (camera, field) = (
            self.panels.camera.layer_selection(),
            self.panels.field.layer_selection(),
        );
        let camera_seen = layout::contains_pane(&self.tree, Pane::Camera);
        let wanted = LayerSelection {
            classes: camera.classes && camera_seen,
            scan_pixels: camera.scan_pixels && camera_seen,
            birds_eye: camera.birds_eye && camera_seen,
            virtual_sensors: camera.virtual_sensors && camera_seen,
            ..field
        };
        if self.layer_worker.is_none() {
            let ctx = ctx.clone();
            match LayerWorker::start(move || ctx.request_repaint()) {
                Ok(layers) => self.layer_worker = Some(layers),
                Err(error) => self.session.last_error = Some(format!("no painter: {error}")),
            }
        }
        let Some(layers) = &mut self.layer_worker else {
            return;
        };
        if let Some(job) = self
            .session
            .layer_job(self.panels.parameters.config(), wanted)
        {
            layers.submit(job);
        }
        if let Some(painted) = layers.take_result() {
            self.session.rendered_layers = painted;
        }
    }

    fn menu_bar(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("File", |ui| self.file_menu(ui));
            ui.menu_button("View", |ui| self.view_menu(ui));
            for (preset, name) in LAYOUTS {
                if ui.selectable_label(self.layout == preset, name).clicked() {
                    self.set_layout(preset);
                }
            }
            if ui.button("?").on_hover_text("Keys").clicked() {
                self.help_open = !self.help_open;
            }
            ui.separator();
            ui.label(&self.session.title);
            if let Some(now) = &self.session.shown {
                let mode = now.cycle.estimate.mode;
                let words = pipeline::log::mode_and_reason(&now.cycle.estimate);
                ui.colored_label(palette::mode_colour(mode), words);
            }
            ui.weak(format!(
                "{:.0} frames/s",
                self.frame_rate.frames_per_second()
            ));
            if let Some(word) = &self.status_message {
                ui.weak(word);
            }
            if let Some(fault) = &self.session.last_error {
                ui.colored_label(palette::VERMILION, fault);
            }
        });
    }

    fn file_menu(&mut self, ui: &mut Ui) {
        ui.label("A log (.mcap) or a scenario (.toml):");
        ui.horizontal(|ui| {
            let line = egui::TextEdit::singleline(&mut self.path_input).desired_width(260.0);
            let entered = ui
                .add(line)
                .with_accessible_label("Log or scenario")
                .lost_focus()
                && ui.input(|i| i.key_pressed(Key::Enter));
            if ui.button("Open").clicked() || entered {
                let path = PathBuf::from(self.path_input.trim());
                self.open(&path, &ui.ctx().clone());
                ui.close();
            }
        });
        ui.separator();
        if ui.button("Screenshot (Ctrl+S)").clicked() {
            self.save_screenshot(ui.ctx());
            ui.close();
        }
        if ui.button("Report (Ctrl+R)").clicked() {
            self.save_report(ui.ctx());
            ui.close();
        }
        if ui.button("Quit").clicked() {
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
        }
    }

    fn view_menu(&mut self, ui: &mut Ui) {
        ui.strong("Panels");
        for pane in PANES {
            let mut shown = layout::contains_pane(&self.tree, pane);
            if ui.checkbox(&mut shown, pane.title()).changed() {
                layout::toggle_pane(&mut self.tree, pane);
            }
        }
        ui.separator();
        ui.strong("Light");
        let mut theme = ui.ctx().options(|options| options.theme_preference);
        for (choice, name) in [
            (egui::ThemePreference::Dark, "Dark"),
            (egui::ThemePreference::Light, "Light"),
            (egui::ThemePreference::System, "As the desktop"),
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

    /// Takes a picture of the window into the working folder.
    pub(crate) fn save_screenshot(&mut self, ctx: &egui::Context) {
        let name = format!("mirrorball_{:.3}s.png", self.session.playback.time);
        self.request_screenshot(ctx, ScreenshotTarget::File(name.into()));
    }

    /// Writes a report into the working folder.
    pub(crate) fn save_report(&mut self, ctx: &egui::Context) {
        let name = format!("mirrorball_report_{:.3}s", self.session.playback.time);
        self.request_screenshot(ctx, ScreenshotTarget::Report(name.into()));
    }

    /// Asks for a picture of the window; it comes with the next frame.
    pub(crate) fn request_screenshot(&mut self, ctx: &egui::Context, picture: ScreenshotTarget) {
        self.pending_screenshots.push(picture);
        let (came, wake) = (self.screenshot_image.clone(), ctx.clone());
        let callback = egui::ScreenshotCallback::new(move |image| {
            *came.lock().unwrap_or_else(PoisonError::into_inner) = Some(image);
            wake.request_repaint();
        });
        ctx.send_viewport_cmd(egui::ViewportCommand::Screenshot(callback));
    }

    fn write_screenshots(&mut self) {
        let came = self
            .screenshot_image
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(image) = came else {
            return;
        };
        for picture in std::mem::take(&mut self.pending_screenshots) {
            let written = match &picture {
                ScreenshotTarget::File(path) => report::write_screenshot(&image, path),
                ScreenshotTarget::Report(folder) => report::write_report(
                    folder,
                    &self.session,
                    self.panels.parameters.config(),
                    Some(&image),
                ),
            };
            let (ScreenshotTarget::File(path) | ScreenshotTarget::Report(path)) = &picture;
            match written {
                Ok(()) => self.status_message = Some(format!("written: {}", path.display())),
                Err(error) => self.session.last_error = Some(format!("{error:#}")),
            }
        }
    }
}

/// A key with Ctrl (Command on a Mac).
pub(crate) const fn command_shortcut(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::COMMAND, key)
}
