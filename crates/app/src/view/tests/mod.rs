//! Drives the view without a window: finds widgets by their label and clicks them.

mod curves;
mod damaged;
mod drawn_run;
mod dropped;
mod keyboard;
mod panels;
mod pictures;
mod rasterizer;
mod runs;
mod two_robots;
mod workspace;

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use eframe::egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use localize::Pose;

use super::layout::PanelLayout;
use super::session::Session;
use super::shell::View;
use super::source::inbox::CycleInbox;
use super::source::sim_worker::{SimWorker, SourceRequest};
use pipeline::findings::{FindingKind, Severity};
use pipeline::log::start_log;
use pipeline::log::{ImageCompression, LogConfig};
use pipeline::simulation::Simulation;
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Generous for a loaded machine; no test waits for it unless it fails.
const TIMEOUT: Duration = Duration::from_secs(120);

fn scenario() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios/demo.toml")
}

/// Records the first second of the demo scenario.
fn record(path: &Path, images: ImageCompression) {
    record_changed(path, images, |_, _| {});
}

/// Records it with cycles that `change` spoils; its first argument counts them.
fn record_changed(path: &Path, images: ImageCompression, change: impl Fn(usize, &mut Cycle)) {
    record_with(path, images, &PipelineConfig::default(), change);
}

/// The same with other settings.
fn record_with(
    path: &Path,
    images: ImageCompression,
    config: &PipelineConfig,
    change: impl Fn(usize, &mut Cycle),
) {
    let simulation = Simulation::load(&scenario(), None, Some(1.0)).expect("a scenario");
    let setup = simulation.setup().expect("a robot");
    let mut pipeline = Pipeline::new(&setup, config).expect("a pipeline");
    let log = LogConfig {
        images,
        ..LogConfig::default()
    };
    let mut recorder = start_log(path, "sim demo", Some(1), (&setup, config), &log).expect("a log");
    let cycles = simulation.filter_map(|sample| pipeline.process_sample(sample));
    for (number, mut cycle) in cycles.enumerate() {
        change(number, &mut cycle);
        recorder.record_cycle(Arc::new(cycle)).expect("written");
    }
    recorder.finish().expect("closed");
}

/// A log of one second, recorded once.
fn log() -> &'static Path {
    static LOG: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = LOG.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("demo.mcap");
        record(&path, ImageCompression::Png);
        (folder, path)
    });
    path
}

fn harness(session: Session, preset: PanelLayout) -> Harness<'static, View> {
    let mut view = View::new(session, preset);
    view.session.playback.playing = false;
    Harness::builder()
        .with_size([1280.0, 800.0])
        .allow_missing_glyphs()
        .build_ui_state(|ui, view: &mut View| view.ui(ui), view)
}

fn open_demo_log(preset: PanelLayout) -> Harness<'static, View> {
    let session = Session::open(log()).expect("a session");
    let mut harness = harness(session, preset);
    harness.run_steps(3);
    harness
}

/// Draws frames until `holds` is true.
fn step_until(harness: &mut Harness<'_, View>, what: &str, holds: impl Fn(&View) -> bool) {
    let started = Instant::now();
    while !holds(harness.state()) {
        assert!(started.elapsed() < TIMEOUT, "timeout: {what}");
        std::thread::sleep(Duration::from_millis(5));
        harness.run_steps(1);
    }
}

#[test]
fn log_opens_at_first_cycle_with_image_ground_truth_and_field() {
    let harness = open_demo_log(PanelLayout::Watch);
    let session = &harness.state().session;
    let now = session.shown.as_ref().expect("a cycle");
    assert!(now.cycle.inputs.image.is_some() && now.cycle.inputs.truth.is_some());
    assert_eq!(session.warnings, Vec::<String>::new());
    for panel in ["Camera", "Field", "Timeline", "Plots"] {
        harness.get_by_label(panel);
    }
}

#[test]
fn step_buttons_move_one_cycle_and_play_reaches_the_end() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    let before = harness.state().session.shown_time().expect("a time");
    harness.get_by_label(">").click();
    harness.run_steps(2);
    let after = harness.state().session.shown_time().expect("a time");
    assert!(
        (after - before - 1.0 / 30.0).abs() < 2e-3,
        "{before} {after}"
    );
    harness.get_by_label("<").click();
    harness.run_steps(2);
    assert_eq!(harness.state().session.shown_time(), Some(before));
    harness.get_by_label("Play").click();
    harness.run_steps(2);
    assert!(harness.state().session.playback.playing);
    harness.get_by_label("Pause");
    step_until(&mut harness, "the end", |view| {
        !view.session.playback.playing
    });
    let end = harness.state().session.shown_time().expect("a time");
    assert!(end > 0.9, "{end}");
}

#[test]
fn listed_shortcuts_have_their_effect() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    assert!(harness.query_by_label("play or pause").is_none());
    harness.key_press(Key::Questionmark);
    harness.run_steps(2);
    harness.get_by_label("play or pause");
    harness.key_press(Key::Num3);
    harness.key_press(Key::B);
    harness.key_press(Key::M);
    harness.run_steps(2);
    let view = harness.state();
    assert_eq!(view.layout, PanelLayout::Localization);
    assert!(view.panels.camera.birds_eye);
    assert_eq!(view.session.marks.len(), 1);
    harness.key_press_modifiers(Modifiers::SHIFT, Key::ArrowRight);
    harness.run_steps(2);
    assert!(harness.state().session.shown_time().expect("a time") > 0.9);
}

#[test]
fn layers_are_rendered_once_switched_on() {
    let mut harness = open_demo_log(PanelLayout::Vision);
    let switches = harness.get_all_by_label("Classes");
    switches.into_iter().next().expect("a switch").click();
    step_until(&mut harness, "classes", |view| {
        view.session.rendered_layers.classes.is_some()
    });
    let classes = harness.state().session.rendered_layers.classes.clone();
    let classes = classes.expect("classes");
    let carpet = super::palette::class_colour(vision::colour::lookup_table::ColourClass::CARPET);
    let green = classes.pixels.iter().filter(|&&pixel| pixel == carpet);
    assert!(
        green.count() * 5 > classes.pixels.len(),
        "at least 20 % of the pixels are carpet"
    );
    harness.get_by_label("Bird's-eye").click();
    step_until(&mut harness, "the floor", |view| {
        view.session.rendered_layers.birds_eye.is_some()
    });
}

#[test]
fn error_landscape_minimum_is_at_the_true_position() {
    let mut harness = open_demo_log(PanelLayout::Localization);
    harness.get_by_label("Error landscape").click();
    step_until(&mut harness, "a landscape", |view| {
        view.session.rendered_layers.error_landscape.is_some()
    });
    let session = &harness.state().session;
    let image = session
        .rendered_layers
        .error_landscape
        .clone()
        .expect("a landscape");
    let scene = session.scene.as_ref().expect("a field");
    let now = session.shown.as_ref().expect("a cycle");
    let truth = now.cycle.inputs.truth.as_ref().expect("truth").pose;
    let (half_x, half_y) = scene.field.carpet_half_extent();
    let brightness = |pixel: &eframe::egui::Color32| u32::from(pixel.r()) + u32::from(pixel.g());
    let best = (0..image.pixels.len())
        .max_by_key(|&cell| brightness(&image.pixels[cell]))
        .expect("cells");
    let x = (best % image.size[0]) as f32 / image.size[0] as f32 * 2.0 * half_x - half_x;
    let y = half_y - (best / image.size[0]) as f32 / image.size[1] as f32 * 2.0 * half_y;
    let error = (x - truth.x).hypot(y - truth.y);
    // The field is symmetric: a heading of the other half gives the mirrored position.
    let mirrored_error = (x + truth.x).hypot(y + truth.y);
    assert!(error.min(mirrored_error) < 0.5, "({x}, {y}) for {truth:?}");
}

#[test]
fn changed_setting_is_marked_and_can_be_reset() {
    let mut harness = open_demo_log(PanelLayout::Vision);
    let mut config = PipelineConfig::default();
    config.vision.scan.range_max = 7.0;
    let view = harness.state_mut();
    view.session.apply_config(config);
    harness.get_by_label("Only what differs").click();
    harness.run_steps(2);
    harness.get_by_label("range_max");
    assert!(harness.query_by_label("spiral_turns").is_none());
    harness.get_by_label("Default").click();
    harness.run_steps(2);
    let config = harness.state().session.settings.config();
    assert_eq!(config.vision.scan.range_max, 9.0);
    assert!(harness.query_by_label("range_max").is_none());
}

#[test]
fn recompute_with_recorded_settings_reproduces_the_poses() {
    let mut harness = open_demo_log(PanelLayout::Vision);
    let same = |view: &View| view.session.recompute.as_ref().is_some_and(|r| r.done);
    harness.get_by_label("Recompute log").click();
    harness.run_steps(1);
    step_until(&mut harness, "the run", same);
    let recompute = harness.state().session.recompute.as_ref().expect("a run");
    assert_eq!(
        (recompute.error.as_deref(), recompute.changed_poses),
        (None, 0)
    );
    assert!(recompute.cycles >= 29, "{}", recompute.cycles);
    let mut config = PipelineConfig::default();
    config.vision.scan.range_max = 4.0;
    let view = harness.state_mut();
    view.session.apply_config(config);
    harness.run_steps(2);
    harness.get_by_label("Recompute log").click();
    harness.run_steps(1);
    step_until(&mut harness, "the run", same);
    let recompute = harness.state().session.recompute.as_ref().expect("a run");
    assert!(recompute.changed_poses > 0);
}

#[test]
fn log_without_images_opens_with_a_warning() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bare.mcap");
    record(&path, ImageCompression::None);
    let mut harness = harness(Session::open(&path).expect("a session"), PanelLayout::Watch);
    harness.run_steps(3);
    harness.get_by_label("no images: the camera panel stays empty");
    let session = &harness.state().session;
    let now = session.shown.as_ref().expect("a cycle");
    assert!(now.cycle.detections.is_some() && now.cycle.inputs.truth.is_some());
}

#[test]
fn findings_are_listed_and_a_click_or_a_key_shows_their_moment() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("wrong.mcap");
    record_changed(&path, ImageCompression::None, |number, cycle| {
        if (20..23).contains(&number)
            && let Some(pose) = &mut cycle.estimate.pose
        {
            pose.x += 0.5;
        }
        cycle.image_fault = (number == 10).then(|| "torn".to_owned());
    });
    let mut harness = harness(Session::open(&path).expect("a session"), PanelLayout::Watch);
    step_until(&mut harness, "the findings", |view| {
        view.session.findings.complete
    });
    // The key reaches them while the panel is behind its tab. Moments before the first are those of the start.
    let kinds = |view: &View| {
        let found = view.session.findings.all().iter();
        found.map(|finding| finding.kind).collect::<Vec<_>>()
    };
    let found = kinds(harness.state());
    assert!(found.contains(&FindingKind::Error) && found.contains(&FindingKind::Unusable));
    let all = harness.state().session.findings.all().to_vec();
    let torn = all.iter().find(|f| f.kind == FindingKind::Unusable);
    let wrong = all.iter().find(|f| f.kind == FindingKind::Error);
    let (torn, wrong) = (torn.expect("torn"), wrong.expect("wrong"));
    let shown = |harness: &Harness<'_, View>| harness.state().session.shown_time();
    harness.state_mut().session.seek(torn.worst - 0.01);
    harness.key_press(Key::N);
    harness.run_steps(2);
    assert_eq!(shown(&harness), Some(torn.worst));
    harness.key_press(Key::N);
    harness.run_steps(2);
    assert!(shown(&harness).expect("a time") >= wrong.start - 1e-9);
    harness.key_press_modifiers(Modifiers::SHIFT, Key::N);
    harness.run_steps(2);
    assert_eq!(shown(&harness), Some(torn.worst));
    harness.get_by_label("Findings").click();
    harness.run_steps(2);
    // The shown moment is stated in full above the list.
    harness.get_by_label(&torn.sentence());
    let row = format!("{:9.2} s  {}", wrong.worst, wrong.sentence());
    harness.get_by_label(&row).click();
    harness.run_steps(2);
    assert_eq!(shown(&harness), Some(wrong.worst));
    harness.get_by_label(&wrong.sentence());
    let bad = all.iter().filter(|f| f.kind.severity() == Severity::Bad);
    let bad = format!("{} bad", bad.count());
    harness.get_by_label(&bad).click();
    harness.run_steps(2);
    assert!(harness.query_by_label(&row).is_none());
}

#[test]
fn truncated_log_opens_up_to_its_last_whole_chunk() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cut.mcap");
    let bytes = std::fs::read(log()).expect("a log");
    std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).expect("written");
    let mut harness = harness(Session::open(&path).expect("a session"), PanelLayout::Watch);
    harness.run_steps(3);
    let warning = "the log is cut: it has no summary, and ends with its last whole chunk";
    harness.get_by_label(warning);
    let session = &harness.state().session;
    let (_, end) = session.source.span().expect("a span");
    assert!((0.3..0.8).contains(&end), "{end}");
}

#[test]
fn simulation_worker_applies_a_kidnap() {
    let inbox = CycleInbox::default();
    let (worker, _) = SimWorker::start(&scenario(), None, PipelineConfig::default(), inbox.clone())
        .expect("a simulation");
    worker.request(SourceRequest::SetSpeed(100.0));
    worker.request(SourceRequest::Kidnap(Pose::new(3.0, 1.0, 0.5)));
    let mut live = super::source::live::LiveSource::new(inbox, Some(worker));
    let started = Instant::now();
    loop {
        let (received, _) = live.poll();
        let at_target = received.iter().any(|shown| {
            let truth = shown.cycle.inputs.truth.as_ref();
            truth.is_some_and(|truth| (truth.pose.x - 3.0).hypot(truth.pose.y - 1.0) < 0.5)
        });
        if at_target {
            break;
        }
        assert!(started.elapsed() < TIMEOUT, "timeout: kidnap");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn gaps_of_devices_are_those_of_the_log_at_any_playback_speed() {
    let mut harness = open_demo_log(PanelLayout::Health);
    let session = &mut harness.state_mut().session;
    // Each drawn frame skips several cycles of the log.
    session.playback.playing = true;
    session.set_speed(10.0);
    for _ in 0..30 {
        session.update(0.02);
    }
    let camera = &session.devices.devices[0];
    assert!(camera.samples >= 29, "{}", camera.samples);
    assert!(camera.longest_gap < 0.04, "{} s", camera.longest_gap);
}

#[test]
fn recording_folder_opens_with_its_poses() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
    let session = Session::open(&folder).expect("a session");
    let now = session.shown.as_ref().expect("a cycle");
    assert!(now.cycle.inputs.image.is_some() && now.cycle.estimate.pose.is_some());
    assert!(session.title.starts_with("recording "));
}
