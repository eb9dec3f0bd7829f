//! The window: a bar of menus, the tiles, and the keys. It asks the session on and gives the painter its jobs.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use eframe::egui::{self, Key, KeyboardShortcut, Modifiers, Ui};
use egui_tiles::Tree;

use super::layers::{Layers, Wanted};
use super::layout::{self, PRESETS, Preset};
use super::meter::Meter;
use super::named::Named;
use super::panels::{Desk, PANES, Pane, Panels};
use super::session::Session;
use super::source::Source;
use super::{ink, keys, report};

/// Between two looks for news while nothing plays.
const IDLE: Duration = Duration::from_millis(100);
/// From one frame to the next at least, while something plays: 60 frames a second.
pub(crate) const FRAME: Duration = Duration::from_millis(16);
/// Scales to choose from.
const SCALES: [f32; 5] = [0.75, 1.0, 1.25, 1.5, 2.0];

/// What a picture of the window is for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Picture {
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
    pub(crate) preset: Preset,
    pub(crate) help: bool,
    /// The file or scenario to open next.
    path: String,
    layers: Option<Layers>,
    /// When the last frame began; those who wake the window look at it too.
    begun: Arc<Mutex<Option<Instant>>>,
    /// How quickly it draws.
    pub(crate) meter: Meter,
    /// Pictures that were asked for and have not come yet.
    pub(crate) pictures: Vec<Picture>,
    came: Arc<Mutex<Option<Arc<egui::ColorImage>>>>,
    /// What was done last, for the bar.
    pub(crate) word: Option<String>,
}

impl View {
    /// A window on a session.
    pub(crate) fn new(session: Session, preset: Preset) -> Self {
        let mut view = View {
            session,
            panels: Panels::default(),
            tree: layout::tree(preset),
            preset,
            help: false,
            path: String::new(),
            layers: None,
            begun: Arc::default(),
            meter: Meter::default(),
            pictures: Vec::new(),
            came: Arc::default(),
            word: None,
        };
        view.panels.parameters.follow(&view.session);
        view
    }

    /// Arranges the panels.
    pub(crate) fn arrange(&mut self, preset: Preset) {
        self.preset = preset;
        self.tree = layout::tree(preset);
    }

    /// Looks at something else.
    pub(crate) fn open(&mut self, path: &std::path::Path, ctx: &egui::Context) {
        match Session::open(path) {
            Ok(session) => {
                self.session = session;
                self.panels.parameters.follow(&self.session);
                self.wake_by_source(ctx);
            }
            Err(error) => self.session.fault = Some(format!("{error:#}")),
        }
    }

    /// Frames are drawn when cycles come.
    pub(crate) fn wake_by_source(&self, ctx: &egui::Context) {
        if let Source::Live(live) = &self.session.source {
            let (ctx, begun) = (ctx.clone(), self.begun.clone());
            live.inbox().on_cycle(move || {
                let begun = *begun.lock().unwrap_or_else(PoisonError::into_inner);
                let passed = begun.map_or(FRAME, |begun| begun.elapsed());
                ctx.request_repaint_after(FRAME.saturating_sub(passed));
            });
        }
    }

    /// Draws the whole window.
    pub(crate) fn ui(&mut self, ui: &mut Ui) {
        let now = Instant::now();
        let last = self
            .begun
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .replace(now);
        let passed = last.map_or(0.0, |last| (now - last).as_secs_f64().min(0.5));
        self.meter.frame(now);
        self.session.update(passed);
        self.paint(ui.ctx());
        keys::follow(ui, self);
        egui::Panel::top("bar").show(ui, |ui| self.bar(ui));
        // The window is cleared in the panels' colour; to fill it once more costs a software renderer a fifth of a frame.
        let bare = egui::Frame::central_panel(ui.style()).fill(egui::Color32::TRANSPARENT);
        egui::CentralPanel::default().frame(bare).show(ui, |ui| {
            let mut desk = Desk {
                session: &mut self.session,
                panels: &mut self.panels,
            };
            self.tree.ui(&mut desk, ui);
            if self.tree.is_empty() {
                ui.weak("All panels are closed: View opens them again.");
            }
        });
        if let Some(path) = self.panels.simulator.open.take() {
            self.open(&path, &ui.ctx().clone());
        }
        keys::help(ui.ctx(), &mut self.help);
        self.take_pictures();
        let live = matches!(self.session.source, Source::Live(_));
        let plays = self.session.clock.playing && !live;
        ui.ctx()
            .request_repaint_after(if plays { FRAME } else { IDLE });
    }

    /// Gives the painter what is seen, and takes what it painted.
    fn paint(&mut self, ctx: &egui::Context) {
        let (camera, field) = (self.panels.camera.wanted(), self.panels.field.wanted());
        let camera_seen = layout::shows(&self.tree, Pane::Camera);
        let wanted = Wanted {
            classes: camera.classes && camera_seen,
            scan: camera.scan && camera_seen,
            bird: camera.bird && camera_seen,
            windows: camera.windows && camera_seen,
            ..field
        };
        if self.layers.is_none() {
            let ctx = ctx.clone();
            match Layers::start(move || ctx.request_repaint()) {
                Ok(layers) => self.layers = Some(layers),
                Err(error) => self.session.fault = Some(format!("no painter: {error}")),
            }
        }
        let Some(layers) = &mut self.layers else {
            return;
        };
        if let Some(job) = self.session.job(self.panels.parameters.config(), wanted) {
            layers.ask(job);
        }
        if let Some(painted) = layers.take() {
            self.session.painted = painted;
        }
    }

    fn bar(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("File", |ui| self.file_menu(ui));
            ui.menu_button("View", |ui| self.view_menu(ui));
            for (preset, name) in PRESETS {
                if ui.selectable_label(self.preset == preset, name).clicked() {
                    self.arrange(preset);
                }
            }
            if ui.button("?").on_hover_text("Keys").clicked() {
                self.help = !self.help;
            }
            ui.separator();
            ui.label(&self.session.name);
            if let Some(now) = &self.session.now {
                let mode = now.cycle.estimate.mode;
                let words = pipeline::log::mode_and_reason(&now.cycle.estimate);
                ui.colored_label(ink::mode(mode), words);
            }
            ui.weak(format!("{:.0} frames/s", self.meter.rate()));
            if let Some(word) = &self.word {
                ui.weak(word);
            }
            if let Some(fault) = &self.session.fault {
                ui.colored_label(ink::VERMILION, fault);
            }
        });
    }

    fn file_menu(&mut self, ui: &mut Ui) {
        ui.label("A log (.mcap) or a scenario (.toml):");
        ui.horizontal(|ui| {
            let line = egui::TextEdit::singleline(&mut self.path).desired_width(260.0);
            let entered = ui.add(line).named("Log or scenario").lost_focus()
                && ui.input(|i| i.key_pressed(Key::Enter));
            if ui.button("Open").clicked() || entered {
                let path = PathBuf::from(self.path.trim());
                self.open(&path, &ui.ctx().clone());
                ui.close();
            }
        });
        ui.separator();
        if ui.button("Screenshot (Ctrl+S)").clicked() {
            self.screenshot(ui.ctx());
            ui.close();
        }
        if ui.button("Report (Ctrl+R)").clicked() {
            self.report(ui.ctx());
            ui.close();
        }
        if ui.button("Quit").clicked() {
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
        }
    }

    fn view_menu(&mut self, ui: &mut Ui) {
        ui.strong("Panels");
        for pane in PANES {
            let mut shown = layout::shows(&self.tree, pane);
            if ui.checkbox(&mut shown, pane.title()).changed() {
                layout::toggle(&mut self.tree, pane);
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
    pub(crate) fn screenshot(&mut self, ctx: &egui::Context) {
        let name = format!("mirrorball_{:.3}s.png", self.session.clock.at);
        self.picture(ctx, Picture::File(name.into()));
    }

    /// Writes a report into the working folder.
    pub(crate) fn report(&mut self, ctx: &egui::Context) {
        let name = format!("mirrorball_report_{:.3}s", self.session.clock.at);
        self.picture(ctx, Picture::Report(name.into()));
    }

    /// Asks for a picture of the window; it comes with the next frame.
    pub(crate) fn picture(&mut self, ctx: &egui::Context, picture: Picture) {
        self.pictures.push(picture);
        let (came, wake) = (self.came.clone(), ctx.clone());
        let callback = egui::ScreenshotCallback::new(move |image| {
            *came.lock().unwrap_or_else(PoisonError::into_inner) = Some(image);
            wake.request_repaint();
        });
        ctx.send_viewport_cmd(egui::ViewportCommand::Screenshot(callback));
    }

    fn take_pictures(&mut self) {
        let came = self
            .came
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(image) = came else {
            return;
        };
        for picture in std::mem::take(&mut self.pictures) {
            let written = match &picture {
                Picture::File(path) => report::save(&image, path),
                Picture::Report(folder) => report::write(
                    folder,
                    &self.session,
                    self.panels.parameters.config(),
                    Some(&image),
                ),
            };
            let (Picture::File(path) | Picture::Report(path)) = &picture;
            match written {
                Ok(()) => self.word = Some(format!("written: {}", path.display())),
                Err(error) => self.session.fault = Some(format!("{error:#}")),
            }
        }
    }
}

/// A key with Ctrl (Command on a Mac).
pub(crate) const fn with_command(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::COMMAND, key)
}
