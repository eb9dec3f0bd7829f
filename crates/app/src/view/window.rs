//! A window on this machine's display: opened, remembered, closed. Its thread steps back behind whatever drives.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use eframe::egui;
use egui_tiles::Tree;
use serde::{Deserialize, Serialize};

use super::Outcome;
use super::layout::PanelLayout;
use super::panels::{Pane, camera, field, plots};
use super::session::Session;
use super::shell::{ScreenshotTarget, View};
use super::source::live::{CycleInbox, LiveSource};
use super::source::remote;
use pipeline::PipelineConfig;
use pipeline::feed::Feed;
use pipeline::setup::Setup;

/// The name by which desktops and the folder of what is remembered know it.
const NAME: &str = "mirrorball";
/// What is remembered goes by this key.
const STORAGE_KEY: &str = "view";
/// The window at first, points: fits a laptop.
const SIZE: [f32; 2] = [1280.0, 800.0];
/// How far the view's threads step back: half as much processor time as `nice` gives at most.
const NICE: i32 = 10;
/// A picture is taken after so many frames with a cycle: layers are painted by then.
const SCREENSHOT_DELAY_FRAMES: u32 = 12;

/// What the command line asks of the window.
#[derive(Debug, Clone, Default)]
pub(crate) struct WindowOptions {
    /// In place of the remembered arrangement.
    pub(crate) layout: Option<PanelLayout>,
    /// A picture, and then out.
    pub(crate) screenshot: Option<PathBuf>,
    /// Out after so many seconds.
    pub(crate) close_after: Option<f64>,
    /// Out as soon as this is true.
    pub(crate) close_requested: Arc<AtomicBool>,
}

/// What is remembered from one time to the next.
#[derive(Serialize, Deserialize)]
struct SavedState {
    layout: PanelLayout,
    tree: Tree<Pane>,
    camera: camera::CameraLayers,
    field: field::FieldLayers,
    plots: plots::PlotsPanel,
}

/// Fails in a line where no window can be.
pub(crate) fn require_display() -> Result<()> {
    if std::env::var_os("DISPLAY").is_none_or(|display| display.is_empty()) {
        bail!(
            "no display to open a window on (DISPLAY is not set): go to a desktop, use `ssh -X`, or `xvfb-run`"
        );
    }
    Ok(())
}

/// Shows a session until its window is closed.
pub(crate) fn run_window(session: Session, wishes: WindowOptions) -> Result<Outcome> {
    // The pool belongs to whoever computes: its threads begin before this one steps back.
    rayon::broadcast(|_| ());
    // Where it cannot step back (a stricter system), the view merely runs beside the others.
    let _ = rustix::process::setpriority_process(None, NICE);
    crate::memory::retain_freed_memory(crate::memory::WINDOW_RETAINED_BYTES);
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title(format!("Mirrorball: {}", session.title))
            .with_app_id(NAME)
            .with_inner_size(SIZE),
        renderer: eframe::Renderer::Glow,
        // Cycles set the pace; a software renderer has no display to wait for.
        glow_options: eframe::egui_glow::GlowConfiguration {
            vsync: false,
            ..Default::default()
        },
        // Nothing here fades; a software renderer computes it for every pixel.
        dithering: false,
        persist_window: wishes.screenshot.is_none(),
        ..Default::default()
    };
    let outcome = Arc::new(Mutex::new(None));
    let told = outcome.clone();
    let start = move |context: &eframe::CreationContext<'_>| {
        let preset = wishes.layout.unwrap_or(PanelLayout::Watch);
        let mut view = View::new(session, preset);
        restore_state(&mut view, context.storage, &wishes);
        view.repaint_on_cycle(&context.egui_ctx);
        Ok(Box::new(ViewerApp {
            view,
            options: wishes,
            frames: 0,
            opened: Instant::now(),
            outcome: told,
        }) as Box<dyn eframe::App>)
    };
    eframe::run_native(NAME, options, Box::new(start)).map_err(|error| {
        // Of the system's word the reason alone: where in its source it arose helps nobody.
        let words = error.to_string();
        let reason = words.rsplit(": ").next().unwrap_or(&words);
        let display = std::env::var("DISPLAY").unwrap_or_default();
        anyhow!("cannot open a window on display {display}: {reason}")
    })?;
    let outcome = outcome
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .take();
    outcome.context("the window closed before it was drawn")
}

fn restore_state(view: &mut View, storage: Option<&dyn eframe::Storage>, wishes: &WindowOptions) {
    // A picture shows what its command says, whoever takes it.
    if wishes.screenshot.is_some() {
        return;
    }
    let memory = storage.and_then(|storage| eframe::get_value::<SavedState>(storage, STORAGE_KEY));
    let Some(memory) = memory else {
        return;
    };
    if wishes.layout.is_none() {
        (view.layout, view.tree) = (memory.layout, memory.tree);
    }
    view.panels.camera.layers = memory.camera;
    view.panels.field.layers = memory.field;
    view.panels.plots = memory.plots;
}

struct ViewerApp {
    view: View,
    options: WindowOptions,
    /// Frames since there is a cycle.
    frames: u32,
    opened: Instant,
    outcome: Arc<Mutex<Option<Outcome>>>,
}

impl eframe::App for ViewerApp {
    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        self.view.ui(ui);
        let ctx = ui.ctx();
        let late = |seconds| self.opened.elapsed().as_secs_f64() > seconds;
        if self.options.close_after.is_some_and(late)
            || self.options.close_requested.load(Ordering::Relaxed)
            || crate::interrupt::stop_requested()
        {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        if let Some(path) = &self.options.screenshot {
            let looks_at_nothing = self.view.session.title.is_empty();
            self.frames += u32::from(self.view.session.shown.is_some() || looks_at_nothing);
            if self.frames == SCREENSHOT_DELAY_FRAMES {
                let picture = ScreenshotTarget::File(path.clone());
                self.view.request_screenshot(ctx, picture);
            } else if self.frames > SCREENSHOT_DELAY_FRAMES
                && self.view.pending_screenshots.is_empty()
            {
                ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            }
            ctx.request_repaint_after(Duration::from_millis(30));
        }
    }

    fn clear_color(&self, visuals: &egui::Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        if self.options.screenshot.is_some() {
            return;
        }
        let memory = SavedState {
            layout: self.view.layout,
            tree: self.view.tree.clone(),
            camera: self.view.panels.camera.layers,
            field: self.view.panels.field.layers,
            plots: self.view.panels.plots.clone(),
        };
        eframe::set_value(storage, STORAGE_KEY, &memory);
    }

    fn on_exit(&mut self, _gl: Option<&eframe::glow::Context>) {
        let (frames, seconds) = self.view.frame_rate.totals();
        let devices = &self.view.session.devices;
        let outcome = Outcome {
            frames,
            seconds,
            frames_per_s: frames as f64 / seconds.max(1e-3),
            cycles: devices.cycles,
            dropped_cycles: devices.dropped,
            error: self.view.session.last_error.clone(),
        };
        *self.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
    }
}

/// Cycles that may wait for the view to take them.
const FEED_CAPACITY: usize = 16;

/// What the window does when the run that it shows has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AfterRun {
    /// Stays until it is closed, or until Ctrl-C.
    KeepOpen,
    /// Goes with it.
    Close,
}

/// Runs `drive`, which publishes to the feed it is given, in a thread of its own, and shows its cycles in a window until
/// that is closed; `drive` then goes on to its end, as it would with no window at all. A run that fails takes the window
/// with it.
pub(crate) fn run_with_window(
    name: &str,
    (setup, config): (Setup, PipelineConfig),
    after: AfterRun,
    drive: impl FnOnce(Feed) -> Result<()> + Send,
) -> Result<()> {
    require_display()?;
    let feed = Feed::new();
    let wishes = WindowOptions::default();
    let leave = wishes.close_requested.clone();
    let inbox = CycleInbox::default();
    let lease = remote::forward_feed(feed.subscribe(FEED_CAPACITY), inbox.clone())?;
    std::thread::scope(|scope| {
        let driving = std::thread::Builder::new()
            .name("drive".to_owned())
            .spawn_scoped(scope, move || {
                let driven = drive(feed);
                leave.store(
                    driven.is_err() || after == AfterRun::Close,
                    Ordering::Relaxed,
                );
                driven
            })?;
        let live = LiveSource::new(inbox, None).with_guard(lease, None);
        let session = Session::from_live(name.to_owned(), live, setup, config);
        if let Err(error) = run_window(session, wishes) {
            eprintln!("mirrorball: {error:#}; the run goes on without a window");
        }
        driving
            .join()
            .unwrap_or_else(|_| Err(anyhow!("the run broke off")))
    })
}
