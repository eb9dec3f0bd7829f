//! The window's content: menu bar, tiles and shortcuts. Updates the session and submits jobs to the layer worker.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use eframe::egui::{self, Key, Ui};
use egui_tiles::Tree;

use super::accessibility::AccessibleLabel;
use super::frame_rate::FrameRateCounter;
use super::layer_worker::{LayerSelection, LayerWorker};
use super::layout::{self, LAYOUTS, PanelLayout};
use super::panels::{PANES, Pane, PaneBehavior, Panels};
use super::session::Session;
use super::shortcuts::{self, Action};
use super::source::Source;
use super::{palette, report};

/// Repaint interval while nothing plays.
const IDLE_REPAINT_INTERVAL: Duration = Duration::from_millis(100);
/// Least interval between frames while something plays: 60 frames per second.
pub(crate) const FRAME_INTERVAL: Duration = Duration::from_millis(16);
/// Selectable interface scales.
const SCALES: [f32; 5] = [0.75, 1.0, 1.25, 1.5, 2.0];

/// Where a screenshot goes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ScreenshotTarget {
    /// A PNG file.
    File(PathBuf),
    /// A report in this folder.
    Report(PathBuf),
}

/// State of the whole window.
pub(crate) struct View {
    pub(crate) session: Session,
    pub(crate) panels: Panels,
    pub(crate) tree: Tree<Pane>,
    pub(crate) layout: PanelLayout,
    pub(crate) help_open: bool,
    /// Text of the path field in the File menu.
    path_input: String,
    layer_worker: Option<LayerWorker>,
    /// Start of the last frame; also read by the repaint callback.
    last_frame_start: Arc<Mutex<Option<Instant>>>,
    pub(crate) frame_rate: FrameRateCounter,
    /// Requested screenshots that egui has not delivered yet.
    pub(crate) pending_screenshots: Vec<ScreenshotTarget>,
    screenshot_image: Arc<Mutex<Option<Arc<egui::ColorImage>>>>,
    /// Result of the last action, for the menu bar.
    pub(crate) status_message: Option<String>,
}

impl View {
    /// Creates the window's content for a session.
    pub(crate) fn new(session: Session, layout: PanelLayout) -> Self {
        View {
            session,
            panels: Panels::default(),
            tree: layout::build_tree(layout),
            layout,
            help_open: false,
            path_input: String::new(),
            layer_worker: None,
            last_frame_start: Arc::default(),
            frame_rate: FrameRateCounter::default(),
            pending_screenshots: Vec::new(),
            screenshot_image: Arc::default(),
            status_message: None,
        }
    }

    /// Rearranges the panels.
    fn set_layout(&mut self, layout: PanelLayout) {
        self.layout = layout;
        self.tree = layout::build_tree(layout);
    }

    /// Opens another source.
    pub(crate) fn open(&mut self, path: &std::path::Path, ctx: &egui::Context) {
        match Session::open(path) {
            Ok(session) => {
                // What the user has labelled outlives the source.
                let calibration = std::mem::take(&mut self.session.calibration);
                self.session = session;
                self.session.calibration = calibration;
                self.repaint_on_cycle(ctx);
            }
            Err(error) => self.session.last_error = Some(format!("{error:#}")),
        }
    }

    /// Requests a repaint whenever a live source delivers a cycle.
    pub(crate) fn repaint_on_cycle(&self, ctx: &egui::Context) {
        if let Source::Live(live) = &self.session.source {
            let (ctx, frame_start) = (ctx.clone(), self.last_frame_start.clone());
            live.inbox().set_on_cycle(move || {
                let frame_start = *frame_start.lock().unwrap_or_else(PoisonError::into_inner);
                let passed = frame_start.map_or(FRAME_INTERVAL, |start| start.elapsed());
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
        self.session.calibration.brush.painting = ui.input(|input| input.pointer.any_down());
        self.session.update(passed);
        self.update_layers(ui.ctx());
        for action in shortcuts::pressed_actions(ui.ctx()) {
            self.apply_action(ui.ctx(), action);
        }
        egui::Panel::top("bar").show(ui, |ui| self.menu_bar(ui));
        // The window is cleared in the panel colour. A second fill would cost a software renderer 20 % of a frame.
        let frame = egui::Frame::central_panel(ui.style()).fill(egui::Color32::TRANSPARENT);
        egui::CentralPanel::default().frame(frame).show(ui, |ui| {
            let mut behavior = PaneBehavior {
                session: &mut self.session,
                panels: &mut self.panels,
            };
            self.tree.ui(&mut behavior, ui);
            if self.tree.is_empty() {
                ui.weak("All panels are closed. Open them from the View menu.");
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

    /// Applies the action of a shortcut.
    fn apply_action(&mut self, ctx: &egui::Context, action: Action) {
        let session = &mut self.session;
        let camera = &mut self.panels.camera;
        match action {
            Action::SaveScreenshot => self.save_screenshot(ctx),
            Action::SaveReport => self.save_report(ctx),
            Action::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Action::ToggleHelp => self.help_open = !self.help_open,
            Action::TogglePlayback => session.toggle_playback(),
            Action::SeekBy(seconds) => session.seek(session.playback.time + seconds),
            Action::Step(cycles) => session.step(cycles),
            Action::SeekToStart => {
                if let Some((start, _)) = session.source.span() {
                    session.seek(start);
                }
            }
            Action::SeekToEnd => {
                if let Some((_, end)) = session.source.span() {
                    session.seek(end);
                    session.playback.playing = matches!(session.source, Source::Live(_));
                }
            }
            Action::SeekFinding(ahead) => session.next_finding(ahead),
            Action::AddMark => session.add_mark(""),
            Action::ScaleSpeed(factor) => session.set_speed(session.playback.speed * factor),
            Action::ToggleClasses => camera.layers.classes = !camera.layers.classes,
            Action::ToggleFieldLines => camera.layers.field_lines = !camera.layers.field_lines,
            Action::ToggleGrid => camera.layers.grid = !camera.layers.grid,
            Action::ToggleBirdsEye => camera.birds_eye = !camera.birds_eye,
            Action::ToggleTheme => ctx.set_theme(match ctx.theme() {
                egui::Theme::Dark => egui::Theme::Light,
                egui::Theme::Light => egui::Theme::Dark,
            }),
            Action::SetLayout(layout) => self.set_layout(layout),
        }
    }

    /// Submits the visible layers to the layer worker, and takes its results.
    fn update_layers(&mut self, ctx: &egui::Context) {
        let (camera, field) = (
            self.panels.camera.layer_selection(),
            self.panels.field.layer_selection(),
        );
        let camera_visible = layout::contains_pane(&self.tree, Pane::Camera);
        let selection = LayerSelection {
            classes: camera.classes && camera_visible,
            scan_pixels: camera.scan_pixels && camera_visible,
            birds_eye: camera.birds_eye && camera_visible,
            virtual_sensors: camera.virtual_sensors && camera_visible,
            ..field
        };
        if self.layer_worker.is_none() {
            let ctx = ctx.clone();
            match LayerWorker::start(move || ctx.request_repaint()) {
                Ok(worker) => self.layer_worker = Some(worker),
                Err(error) => {
                    self.session.last_error =
                        Some(format!("cannot start the layer worker: {error}"))
                }
            }
        }
        let Some(worker) = &mut self.layer_worker else {
            return;
        };
        if let Some(job) = self.session.layer_job(selection) {
            worker.submit(job);
        }
        if let Some(rendered) = worker.take_result() {
            self.session.rendered_layers = rendered;
        }
    }

    fn menu_bar(&mut self, ui: &mut Ui) {
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
            if let Some(now) = &self.session.shown {
                let mode = now.cycle.estimate.mode;
                let text = pipeline::log::mode_and_reason(&now.cycle.estimate);
                ui.colored_label(palette::mode_colour(mode), text);
            }
            ui.weak(format!(
                "{:.0} frames/s",
                self.frame_rate.frames_per_second()
            ));
            if let Some(message) = &self.status_message {
                ui.weak(message);
            }
            if let Some(error) = &self.session.last_error {
                ui.colored_label(palette::VERMILION, error);
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

    /// Saves a screenshot in the working directory.
    fn save_screenshot(&mut self, ctx: &egui::Context) {
        let name = format!("mirrorball_{:.3}s.png", self.session.playback.time);
        self.request_screenshot(ctx, ScreenshotTarget::File(name.into()));
    }

    /// Saves a report in the working directory.
    fn save_report(&mut self, ctx: &egui::Context) {
        let name = format!("mirrorball_report_{:.3}s", self.session.playback.time);
        self.request_screenshot(ctx, ScreenshotTarget::Report(name.into()));
    }

    /// Requests a screenshot; egui delivers it with the next frame.
    pub(crate) fn request_screenshot(&mut self, ctx: &egui::Context, target: ScreenshotTarget) {
        self.pending_screenshots.push(target);
        let (slot, wake) = (self.screenshot_image.clone(), ctx.clone());
        let callback = egui::ScreenshotCallback::new(move |image| {
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(image);
            wake.request_repaint();
        });
        ctx.send_viewport_cmd(egui::ViewportCommand::Screenshot(callback));
    }

    fn write_screenshots(&mut self) {
        let image = self
            .screenshot_image
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(image) = image else {
            return;
        };
        for target in std::mem::take(&mut self.pending_screenshots) {
            let result = match &target {
                ScreenshotTarget::File(path) => report::write_screenshot(&image, path),
                ScreenshotTarget::Report(folder) => {
                    report::write_report(folder, &self.session, Some(&image))
                }
            };
            let (ScreenshotTarget::File(path) | ScreenshotTarget::Report(path)) = &target;
            match result {
                Ok(()) => self.status_message = Some(format!("wrote {}", path.display())),
                Err(error) => self.session.last_error = Some(format!("{error:#}")),
            }
        }
    }
}
