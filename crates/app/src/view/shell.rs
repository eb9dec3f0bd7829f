//! The window's content: menu bar, tiles and shortcuts. Updates the session and submits jobs to the layer worker.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use eframe::egui::{self, Ui};
use egui_tiles::Tree;
use pipeline::PipelineConfig;

use super::current_panel::CurrentPanel;
use super::file_dialog::FileDialog;
use super::frame_pacing::{FRAME_INTERVAL, FramePacer};
use super::frame_rate::FrameRateCounter;
use super::keyboard_pointer::KeyboardPointer;
use super::layer_worker::{LayerSelection, LayerWorker};
use super::layout::{self, PanelLayout};
use super::layout_file::SavedLayout;
use super::panels::{Pane, PanelId, Panels};
use super::report;
use super::search::SearchBox;
use super::session::Session;
use super::shortcuts;
use super::source::Source;
use super::tiles::PaneBehavior;
use super::undo::{Edited, UndoHistory};

/// Repaint interval while nothing plays.
const IDLE_REPAINT_INTERVAL: Duration = Duration::from_millis(100);
/// Files kept in the list of recent ones.
const RECENT_FILES_MAX: usize = 12;

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
    pub(crate) tree: Tree<PanelId>,
    pub(crate) layout: PanelLayout,
    pub(crate) help_open: bool,
    /// The panel that takes the keys.
    pub(crate) current: CurrentPanel,
    /// The pointer, while keys move it.
    pub(crate) pointer: KeyboardPointer,
    pub(crate) search: SearchBox,
    pub(crate) dialog: Option<FileDialog>,
    /// Logs opened last, the newest first.
    pub(crate) recent_files: Vec<PathBuf>,
    pub(crate) history: UndoHistory,
    /// The settings in use with their text, and the session's revision of which they are.
    config_text: Option<(u64, Arc<(PipelineConfig, String)>)>,
    layer_worker: Option<LayerWorker>,
    /// Start of the last frame; also read by the repaint callback.
    last_frame_start: Arc<Mutex<Option<Instant>>>,
    frame_pacer: FramePacer,
    pub(crate) frame_rate: FrameRateCounter,
    /// Requested screenshots that egui has not delivered yet.
    pub(crate) pending_screenshots: Vec<ScreenshotTarget>,
    screenshot_image: Arc<Mutex<Option<Arc<egui::ColorImage>>>>,
    /// Result of the last action, for the menu bar.
    pub(crate) status_message: Option<String>,
    /// Why the last action of the user failed.
    pub(crate) problem: Option<String>,
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
            current: CurrentPanel::default(),
            pointer: KeyboardPointer::default(),
            search: SearchBox::default(),
            dialog: None,
            recent_files: Vec::new(),
            history: UndoHistory::default(),
            config_text: None,
            layer_worker: None,
            last_frame_start: Arc::default(),
            frame_pacer: FramePacer::default(),
            frame_rate: FrameRateCounter::default(),
            pending_screenshots: Vec::new(),
            screenshot_image: Arc::default(),
            status_message: None,
            problem: None,
        }
    }

    /// Rearranges the panels.
    pub(crate) fn set_layout(&mut self, layout: PanelLayout) {
        self.layout = layout;
        self.tree = layout::build_tree(layout);
    }

    /// Opens another source.
    pub(crate) fn open(&mut self, path: &Path, ctx: &egui::Context) {
        let Some(session) = self.take_result(Session::open(path)) else {
            return;
        };
        // What the user has labelled outlives the source.
        let calibration = std::mem::take(&mut self.session.calibration);
        self.session = session;
        self.session.calibration = calibration;
        self.history = UndoHistory::default();
        if path.exists() {
            self.remember_file(path);
        }
        self.repaint_on_cycle(ctx);
    }

    /// Opens another source beside the run.
    pub(crate) fn open_beside(&mut self, path: &Path) {
        let opened = self.session.open_beside(path);
        self.take_result(opened);
    }

    /// The value, if an action of the user succeeded; otherwise the problem is shown until another one succeeds.
    pub(crate) fn take_result<T>(&mut self, result: Result<T>) -> Option<T> {
        match result {
            Ok(value) => {
                self.problem = None;
                Some(value)
            }
            Err(error) => {
                self.problem = Some(format!("{error:#}"));
                None
            }
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
                current: &mut self.current,
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
        let ctx = ui.ctx().clone();
        self.show_search(&ctx);
        self.pointer.draw(&ctx);
        self.show_dialog(&ctx);
        self.take_dropped_files(&ctx);
        self.record_edits(&ctx);
        self.write_screenshots();
        let live = matches!(self.session.source, Source::Live(_));
        let plays = self.session.playback.playing && !live;
        ui.ctx().request_repaint_after(if plays {
            self.frame_pacer.delay(now, Instant::now())
        } else {
            IDLE_REPAINT_INTERVAL
        });
    }

    /// Submits the visible layers to the layer worker, and takes its results.
    pub(super) fn update_layers(&mut self, ctx: &egui::Context) {
        let (camera, field) = self.panels.layer_selections();
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

    /// Shows a saved layout.
    pub(crate) fn restore_layout(&mut self, saved: SavedLayout) {
        (self.layout, self.tree) = saved.restore(&mut self.panels);
    }

    /// Puts a file at the head of the recent ones.
    pub(crate) fn remember_file(&mut self, path: &Path) {
        let path = std::path::absolute(path).unwrap_or(path.to_owned());
        self.recent_files.retain(|known| *known != path);
        self.recent_files.insert(0, path);
        self.recent_files.truncate(RECENT_FILES_MAX);
    }

    /// Records an edit once the pointer is released and no text is being typed.
    fn record_edits(&mut self, ctx: &egui::Context) {
        if ctx.input(|input| input.pointer.any_down()) || ctx.egui_wants_keyboard_input() {
            return;
        }
        let revision = self.session.revision;
        let known = self.config_text.take().filter(|(of, _)| *of == revision);
        let (_, config) = self.config_text.insert(known.unwrap_or_else(|| {
            let config = self.session.settings.config().clone();
            let text = toml::to_string(&config).unwrap_or_default();
            (revision, Arc::new((config, text)))
        }));
        self.history.record(Edited {
            config: config.clone(),
            marks: self.session.marks.clone(),
            plots: self.panels.plots.plots().to_vec(),
            layout: self.layout,
            tree: self.tree.clone(),
        });
    }

    /// Restores a state of the history.
    pub(crate) fn restore_edit(&mut self, edited: Option<Edited>) {
        let Some(edited) = edited else {
            self.status_message = Some("nothing to undo or redo".to_owned());
            return;
        };
        if self
            .config_text
            .as_ref()
            .is_none_or(|(_, now)| now.1 != edited.config.1)
        {
            self.session.apply_config(edited.config.0.clone());
        }
        self.session.marks = edited.marks;
        self.panels.plots.set_plots(edited.plots);
        (self.layout, self.tree) = (edited.layout, edited.tree);
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
            let message = format!("wrote {}", path.display());
            if self.take_result(result).is_some() {
                self.status_message = Some(message);
            }
        }
    }
}
