//! Opens the window, restores and saves its state, closes it. Its threads run at a lower priority than the pipeline.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use eframe::egui;
use rustix::time::ClockId;
use serde::{Deserialize, Serialize};

use super::layout::PanelLayout;
use super::layout_file::SavedLayout;
use super::session::Session;
use super::shell::{ScreenshotTarget, View};
use super::source::inbox::{CycleInbox, forward_feed};
use super::source::live::LiveSource;
use pipeline::PipelineConfig;
use pipeline::feed::Feed;
use pipeline::setup::Setup;

/// Application id: names the window for the desktop, and the folder of the saved state.
const NAME: &str = "mirrorball";
/// Key of the saved state in the storage.
const STORAGE_KEY: &str = "view";
/// Initial window size, points: fits a laptop.
const SIZE: [f32; 2] = [1280.0, 800.0];
/// Nice value of the view's threads (0 to 19; higher yields more processor time to others).
const NICE: i32 = 10;
/// Frames drawn with a cycle before the screenshot is taken: layers are rendered by then.
const SCREENSHOT_DELAY_FRAMES: u32 = 12;

/// Longest time for which a screenshot waits until the whole log is read, seconds.
const SCREENSHOT_READ_MAX: f64 = 10.0;

/// Options of the window, from the command line.
#[derive(Clone, Default)]
pub(crate) struct WindowOptions {
    /// Overrides the saved layout.
    pub(crate) layout: Option<PanelLayout>,
    /// Overrides the saved layout and what its panels show.
    pub(crate) layout_file: Option<SavedLayout>,
    /// Write a screenshot here, then close.
    pub(crate) screenshot: Option<PathBuf>,
    /// Close after this many seconds.
    pub(crate) close_after: Option<f64>,
    /// Close as soon as this is true.
    pub(crate) close_requested: Arc<AtomicBool>,
}

/// Output of `--json`.
#[derive(serde::Serialize)]
pub(crate) struct Outcome {
    pub(crate) frames: u64,
    pub(crate) seconds: f64,
    pub(crate) frames_per_s: f64,
    /// Longest time for a frame after the first second, drawing included.
    pub(crate) longest_frame_ms: f32,
    /// Processor time of the window's thread for a frame: mean and longest after the first second.
    pub(crate) frame_cpu_ms: f64,
    pub(crate) longest_frame_cpu_ms: f64,
    /// Processor time of all threads for a frame, after the first second: with a software renderer, its threads too.
    pub(crate) frame_process_cpu_ms: f64,
    pub(crate) cycles: u64,
    pub(crate) dropped_cycles: u64,
    /// The last error.
    #[serde(skip)]
    pub(crate) error: Option<String>,
}

/// State saved between sessions.
#[derive(Serialize, Deserialize)]
struct SavedState {
    layout: SavedLayout,
    recent_files: Vec<PathBuf>,
}

/// Fails if no display is configured.
pub(crate) fn require_display() -> Result<()> {
    if std::env::var_os("DISPLAY").is_none_or(|display| display.is_empty()) {
        bail!(
            "cannot open a window: DISPLAY is not set. Run on a desktop, with `ssh -X`, or under `xvfb-run`"
        );
    }
    Ok(())
}

/// Shows a session until its window is closed.
pub(crate) fn run_window(session: Session, options: WindowOptions) -> Result<Outcome> {
    // Start the rayon threads first: new threads would inherit this thread's lower priority.
    rayon::broadcast(|_| ());
    // Failure is harmless: the view then runs at normal priority.
    let _ = rustix::process::setpriority_process(None, NICE);
    crate::memory::retain_freed_memory(crate::memory::WINDOW_RETAINED_BYTES);
    let native_options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title(format!("Mirrorball: {}", session.title))
            .with_app_id(NAME)
            .with_inner_size(SIZE),
        renderer: eframe::Renderer::Glow,
        // New cycles trigger repaints, and a software renderer has no display refresh to wait for.
        glow_options: eframe::egui_glow::GlowConfiguration {
            vsync: false,
            ..Default::default()
        },
        // The view draws no gradients, and a software renderer would pay for dithering at every pixel.
        dithering: false,
        persist_window: options.screenshot.is_none(),
        ..Default::default()
    };
    let outcome = Arc::new(Mutex::new(None));
    let outcome_slot = outcome.clone();
    let start = move |context: &eframe::CreationContext<'_>| {
        let layout = options.layout.unwrap_or(PanelLayout::Watch);
        let mut view = View::new(session, layout);
        restore_state(&mut view, context.storage, &options);
        view.repaint_on_cycle(&context.egui_ctx);
        Ok(Box::new(ViewerApp {
            view,
            options,
            frames: 0,
            opened: Instant::now(),
            outcome: outcome_slot,
        }) as Box<dyn eframe::App>)
    };
    eframe::run_native(NAME, native_options, Box::new(start)).map_err(|error| {
        // Keep only the reason: the error's prefix is a source location of the windowing library.
        let text = error.to_string();
        let reason = text.rsplit(": ").next().unwrap_or(&text);
        let display = std::env::var("DISPLAY").unwrap_or_default();
        anyhow!("cannot open a window on display {display}: {reason}")
    })?;
    let outcome = outcome
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .take();
    outcome.context("the window closed before it was drawn")
}

fn restore_state(view: &mut View, storage: Option<&dyn eframe::Storage>, options: &WindowOptions) {
    // A screenshot must depend on its command line only, not on saved state.
    let storage = storage.filter(|_| options.screenshot.is_none());
    let saved = storage.and_then(|storage| eframe::get_value::<SavedState>(storage, STORAGE_KEY));
    if let Some(saved) = saved {
        view.recent_files = saved.recent_files;
        let (layout, tree) = saved.layout.restore(&mut view.panels);
        if options.layout.is_none() {
            (view.layout, view.tree) = (layout, tree);
        }
    }
    if let Some(file) = &options.layout_file {
        view.restore_layout(file.clone());
    }
    if let Some(path) = view.session.log_path() {
        view.remember_file(&path);
    }
}

/// Processor time that a clock counts: of this thread, or of the process.
fn cpu_time(clock: ClockId) -> Duration {
    let time = rustix::time::clock_gettime(clock);
    Duration::new(
        time.tv_sec.unsigned_abs(),
        time.tv_nsec.unsigned_abs() as u32,
    )
}

struct ViewerApp {
    view: View,
    options: WindowOptions,
    /// Frames drawn since the first cycle.
    frames: u32,
    opened: Instant,
    outcome: Arc<Mutex<Option<Outcome>>>,
}

impl eframe::App for ViewerApp {
    fn ui(&mut self, ui: &mut egui::Ui, frame: &mut eframe::Frame) {
        if let Some(seconds) = frame.info().cpu_usage {
            self.view.frame_rate.record_duration(seconds);
        }
        let (thread, process) = (ClockId::ThreadCPUTime, ClockId::ProcessCPUTime);
        self.view
            .frame_rate
            .record_cpu(cpu_time(thread), cpu_time(process));
        self.view.ui(ui);
        let ctx = ui.ctx();
        let elapsed = |seconds| self.opened.elapsed().as_secs_f64() > seconds;
        if self.options.close_after.is_some_and(elapsed)
            || self.options.close_requested.load(Ordering::Relaxed)
            || crate::interrupt::stop_requested()
        {
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
        if let Some(path) = &self.options.screenshot {
            let session = &self.view.session;
            // Of a log that is damaged all over, the notice is shown.
            let is_open =
                session.shown.is_some() || session.title.is_empty() || session.last_error.is_some();
            let is_read = session.is_read() || elapsed(SCREENSHOT_READ_MAX);
            self.frames += u32::from(is_open && is_read);
            if self.frames == SCREENSHOT_DELAY_FRAMES {
                let target = ScreenshotTarget::File(path.clone());
                self.view.request_screenshot(ctx, target);
            } else if self.frames > SCREENSHOT_DELAY_FRAMES
                && self.view.pending_screenshots.is_empty()
            {
                ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            }
            ctx.request_repaint_after(Duration::from_millis(30));
        }
    }

    fn raw_input_hook(&mut self, ctx: &egui::Context, input: &mut egui::RawInput) {
        self.view.pointer.translate(ctx, input);
    }

    fn clear_color(&self, visuals: &egui::Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        if self.options.screenshot.is_some() {
            return;
        }
        let view = &self.view;
        let saved = SavedState {
            layout: SavedLayout::of(view.layout, &view.tree, &view.panels),
            recent_files: view.recent_files.clone(),
        };
        eframe::set_value(storage, STORAGE_KEY, &saved);
    }

    fn on_exit(&mut self, _gl: Option<&eframe::glow::Context>) {
        let (frames, seconds) = self.view.frame_rate.totals();
        let (mean_cpu, longest_cpu) = self.view.frame_rate.frame_cpu();
        let process_cpu = self.view.frame_rate.process_cpu();
        let devices = &self.view.session.devices;
        let outcome = Outcome {
            frames,
            seconds,
            frames_per_s: frames as f64 / seconds.max(1e-3),
            frame_cpu_ms: 1e3 * mean_cpu.as_secs_f64(),
            longest_frame_cpu_ms: 1e3 * longest_cpu.as_secs_f64(),
            frame_process_cpu_ms: 1e3 * process_cpu.as_secs_f64(),
            longest_frame_ms: 1e3 * self.view.frame_rate.longest(),
            cycles: devices.cycles,
            dropped_cycles: devices.dropped,
            error: (self.view.problem.clone())
                .or_else(|| self.view.session.last_error.clone())
                .or_else(|| self.view.session.source_problem()),
        };
        *self.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
    }
}

/// Cycles queued for the view.
const FEED_CAPACITY: usize = 16;

/// What the window does when its run has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AfterRun {
    /// Stays open until the user closes it or presses Ctrl-C.
    KeepOpen,
    /// Closes with the run.
    Close,
}

/// Runs `drive` in a separate thread and shows the cycles it publishes to its feed in a window.
///
/// Closing the window does not end `drive`. An error of `drive` closes the window.
pub(crate) fn run_with_window(
    name: &str,
    (setup, config): (Setup, PipelineConfig),
    after: AfterRun,
    drive: impl FnOnce(Feed) -> Result<()> + Send,
) -> Result<()> {
    require_display()?;
    let feed = Feed::new();
    let options = WindowOptions::default();
    let close_requested = options.close_requested.clone();
    let inbox = CycleInbox::default();
    let guard = forward_feed(feed.subscribe(FEED_CAPACITY), inbox.clone())?;
    std::thread::scope(|scope| {
        let driver = std::thread::Builder::new()
            .name("drive".to_owned())
            .spawn_scoped(scope, move || {
                let result = drive(feed);
                close_requested.store(
                    result.is_err() || after == AfterRun::Close,
                    Ordering::Relaxed,
                );
                result
            })?;
        let live = LiveSource::new(inbox, None).with_guard(guard, None);
        let session = Session::from_live(name.to_owned(), live, setup, config);
        if let Err(error) = session.and_then(|session| run_window(session, options)) {
            stderr_line!("mirrorball: {error:#}. The run continues without a window");
        }
        driver
            .join()
            .unwrap_or_else(|_| Err(anyhow!("the run's thread panicked")))
    })
}
