//! Panels without a window: what stands in them is asked for by its words, and clicked.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use eframe::egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use localize::Pose;

use super::layout::Preset;
use super::session::Session;
use super::shell::View;
use super::source::live::Inbox;
use super::source::worker::{Order, SimWorker};
use pipeline::cycle::{Pipeline, PipelineConfig};
use pipeline::log::start_log;
use pipeline::log::{ImageCompression, LogConfig};
use pipeline::simulation::Simulation;

/// Long enough for a loaded machine; nothing waits for it to pass.
const PATIENCE: Duration = Duration::from_secs(120);

fn scenario() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios/demo.toml")
}

/// Records the first second of the demo.
fn record(path: &Path, images: ImageCompression) {
    let simulation = Simulation::load(&scenario(), None, Some(1.0)).expect("a scenario");
    let setup = simulation.setup().expect("a robot");
    let config = PipelineConfig::default();
    let mut spine = Pipeline::new(&setup, &config).expect("a spine");
    let log = LogConfig {
        images,
        ..LogConfig::default()
    };
    let mut recorder =
        start_log(path, "sim demo", Some(1), (&setup, &config), &log).expect("a log");
    for cycle in simulation.filter_map(|sample| spine.process_sample(sample)) {
        recorder.record_cycle(Arc::new(cycle)).expect("written");
    }
    recorder.finish().expect("closed");
}

/// A log of one second, made once.
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

fn harness(session: Session, preset: Preset) -> Harness<'static, View> {
    let mut view = View::new(session, preset);
    view.session.clock.playing = false;
    Harness::builder()
        .with_size([1280.0, 800.0])
        .allow_missing_glyphs()
        .build_ui_state(|ui, view: &mut View| view.ui(ui), view)
}

fn opened(preset: Preset) -> Harness<'static, View> {
    let session = Session::open(log()).expect("a session");
    let mut harness = harness(session, preset);
    harness.run_steps(3);
    harness
}

/// Steps until something holds.
fn until(harness: &mut Harness<'_, View>, what: &str, holds: impl Fn(&View) -> bool) {
    let started = Instant::now();
    while !holds(harness.state()) {
        assert!(started.elapsed() < PATIENCE, "{what} did not come");
        std::thread::sleep(Duration::from_millis(5));
        harness.run_steps(1);
    }
}

#[test]
fn a_log_opens_at_its_first_cycle_with_image_truth_and_field() {
    let harness = opened(Preset::Watch);
    let session = &harness.state().session;
    let now = session.now.as_ref().expect("a cycle");
    assert!(now.cycle.inputs.image.is_some() && now.cycle.inputs.truth.is_some());
    assert_eq!(session.missing, Vec::<String>::new());
    for panel in ["Camera", "Field", "Timeline", "Plots"] {
        harness.get_by_label(panel);
    }
}

#[test]
fn clicking_steps_and_play_moves_the_moment() {
    let mut harness = opened(Preset::Watch);
    let before = harness.state().session.time().expect("a time");
    harness.get_by_label(">").click();
    harness.run_steps(2);
    let after = harness.state().session.time().expect("a time");
    assert!(
        (after - before - 1.0 / 30.0).abs() < 2e-3,
        "{before} {after}"
    );
    harness.get_by_label("<").click();
    harness.run_steps(2);
    assert_eq!(harness.state().session.time(), Some(before));
    harness.get_by_label("Play").click();
    harness.run_steps(2);
    assert!(harness.state().session.clock.playing);
    harness.get_by_label("Pause");
    until(&mut harness, "the end", |view| !view.session.clock.playing);
    let end = harness.state().session.time().expect("a time");
    assert!(end > 0.9, "{end}");
}

#[test]
fn keys_do_what_the_list_under_the_question_mark_says() {
    let mut harness = opened(Preset::Watch);
    assert!(harness.query_by_label("play or pause").is_none());
    harness.key_press(Key::Questionmark);
    harness.run_steps(2);
    harness.get_by_label("play or pause");
    harness.key_press(Key::Num3);
    harness.key_press(Key::B);
    harness.key_press(Key::M);
    harness.run_steps(2);
    let view = harness.state();
    assert_eq!(view.preset, Preset::Place);
    assert!(view.panels.camera.bird);
    assert_eq!(view.session.marks.len(), 1);
    harness.key_press_modifiers(Modifiers::SHIFT, Key::ArrowRight);
    harness.run_steps(2);
    assert!(harness.state().session.time().expect("a time") > 0.9);
}

#[test]
fn layers_are_painted_once_they_are_switched_on() {
    let mut harness = opened(Preset::Eyes);
    let switches = harness.get_all_by_label("Classes");
    switches.into_iter().next().expect("a switch").click();
    until(&mut harness, "classes", |view| {
        view.session.painted.classes.is_some()
    });
    let classes = harness.state().session.painted.classes.clone();
    let classes = classes.expect("classes");
    let carpet = super::ink::class(vision::colours::ColourClass::CARPET);
    let green = classes.pixels.iter().filter(|&&pixel| pixel == carpet);
    assert!(
        green.count() * 5 > classes.pixels.len(),
        "a fifth is carpet"
    );
    harness.get_by_label("Bird's-eye").click();
    until(&mut harness, "the floor", |view| {
        view.session.painted.bird.is_some()
    });
}

#[test]
fn the_error_landscape_is_lowest_where_the_robot_is() {
    let mut harness = opened(Preset::Place);
    harness.get_by_label("Error landscape").click();
    until(&mut harness, "a landscape", |view| {
        view.session.painted.landscape.is_some()
    });
    let session = &harness.state().session;
    let image = session.painted.landscape.clone().expect("a landscape");
    let stage = session.stage.as_ref().expect("a field");
    let now = session.now.as_ref().expect("a cycle");
    let truth = now.cycle.inputs.truth.as_ref().expect("truth").pose;
    let (half_x, half_y) = stage.field.carpet_half_extent();
    let bright = |pixel: &eframe::egui::Color32| u32::from(pixel.r()) + u32::from(pixel.g());
    let best = (0..image.pixels.len())
        .max_by_key(|&cell| bright(&image.pixels[cell]))
        .expect("cells");
    let x = (best % image.size[0]) as f32 / image.size[0] as f32 * 2.0 * half_x - half_x;
    let y = half_y - (best / image.size[0]) as f32 / image.size[1] as f32 * 2.0 * half_y;
    let off = (x - truth.x).hypot(y - truth.y);
    // The heading may be that of the other half: then so is the place.
    let other = (x + truth.x).hypot(y + truth.y);
    assert!(off.min(other) < 0.5, "({x}, {y}) for {truth:?}");
}

#[test]
fn a_changed_setting_is_marked_and_goes_back_to_its_default() {
    let mut harness = opened(Preset::Eyes);
    let mut config = PipelineConfig::default();
    config.vision.scan.range_max = 7.0;
    let view = harness.state_mut();
    view.panels.parameters.apply(&mut view.session, config);
    harness.get_by_label("Only what differs").click();
    harness.run_steps(2);
    harness.get_by_label("range_max");
    assert!(harness.query_by_label("spiral_turns").is_none());
    harness.get_by_label("Default").click();
    harness.run_steps(2);
    let config = harness.state().panels.parameters.config();
    assert_eq!(config.vision.scan.range_max, 9.0);
    assert!(harness.query_by_label("range_max").is_none());
}

#[test]
fn a_log_computed_again_with_its_own_settings_gives_its_own_poses_and_with_others_not() {
    let mut harness = opened(Preset::Eyes);
    let same = |view: &View| view.session.recompute.as_ref().is_some_and(|r| r.done);
    harness.get_by_label("Recompute log").click();
    harness.run_steps(1);
    until(&mut harness, "the run", same);
    let recompute = harness.state().session.recompute.as_ref().expect("a run");
    assert_eq!((recompute.fault.as_deref(), recompute.different), (None, 0));
    assert!(recompute.cycles >= 29, "{}", recompute.cycles);
    let mut config = PipelineConfig::default();
    config.vision.scan.range_max = 4.0;
    let view = harness.state_mut();
    view.panels.parameters.apply(&mut view.session, config);
    harness.run_steps(2);
    harness.get_by_label("Recompute log").click();
    harness.run_steps(1);
    until(&mut harness, "the run", same);
    let recompute = harness.state().session.recompute.as_ref().expect("a run");
    assert!(recompute.different > 0);
}

#[test]
fn a_log_without_images_says_so_and_shows_the_rest() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bare.mcap");
    record(&path, ImageCompression::None);
    let mut harness = harness(Session::open(&path).expect("a session"), Preset::Watch);
    harness.run_steps(3);
    harness.get_by_label("no images: the camera panel stays empty");
    let session = &harness.state().session;
    let now = session.now.as_ref().expect("a cycle");
    assert!(now.cycle.detections.is_some() && now.cycle.inputs.truth.is_some());
}

#[test]
fn a_cut_log_shows_what_is_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cut.mcap");
    let bytes = std::fs::read(log()).expect("a log");
    std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).expect("written");
    let mut harness = harness(Session::open(&path).expect("a session"), Preset::Watch);
    harness.run_steps(3);
    let told = "the log is cut: it has no summary, and ends with its last whole chunk";
    harness.get_by_label(told);
    let session = &harness.state().session;
    let (_, end) = session.source.span().expect("a span");
    assert!((0.3..0.8).contains(&end), "{end}");
}

#[test]
fn every_arrangement_is_drawn_with_a_log_and_with_nothing() {
    for (preset, _) in super::layout::PRESETS {
        let mut with = opened(preset);
        with.run_steps(2);
        let mut without = harness(Session::default(), preset);
        without.run_steps(2);
    }
}

#[test]
fn a_simulation_of_its_own_is_kidnapped_between_two_samples() {
    let inbox = Inbox::default();
    let (worker, _) = SimWorker::start(&scenario(), None, PipelineConfig::default(), inbox.clone())
        .expect("a simulation");
    worker.order(Order::Pace(100.0));
    worker.order(Order::Kidnap(Pose::new(3.0, 1.0, 0.5)));
    let mut live = super::source::live::Live::new(inbox, Some(worker));
    let started = Instant::now();
    loop {
        let (came, _) = live.poll();
        let there = came.iter().any(|shown| {
            let truth = shown.cycle.inputs.truth.as_ref();
            truth.is_some_and(|truth| (truth.pose.x - 3.0).hypot(truth.pose.y - 1.0) < 0.5)
        });
        if there {
            break;
        }
        assert!(started.elapsed() < PATIENCE, "it was not kidnapped");
        std::thread::sleep(Duration::from_millis(5));
    }
}
