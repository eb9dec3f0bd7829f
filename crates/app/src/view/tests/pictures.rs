//! The picture of every panel, compared with a stored one. `MIRRORBALL_ACCEPT_PICTURES=1` stores those that have changed:
//! look at each before it is committed.

use std::path::{Path, PathBuf};

use eframe::egui::{Frame, Theme, Vec2};
use image::RgbImage;

use super::drawn_run::drawn_log;
use super::rasterizer::Rasterizer;
use super::*;
use crate::view::layout::build_single;
use crate::view::panels::field_layers::FieldBackground;
use crate::view::panels::plots::PlotConfig;
use crate::view::panels::{PANES, Pane, PanelId};
use crate::view::selection::Selection;
use crate::view::source::live::LiveSource;

/// Levels of a colour channel in the stored pictures: these are half as large as with 256 levels.
const STORED_LEVELS: f32 = 16.0;
/// Difference of a colour channel from the stored one that counts, of 255: half a stored level, and 6 for rounding, which
/// may differ between processors.
const CHANNEL_TOLERANCE: u8 = 15;
/// Pixels that may differ by more: fewer than a digit has.
const DIFFERENT_PIXELS_MAX: usize = 8;
/// Stores changed pictures instead of refusing them.
const ACCEPT: &str = "MIRRORBALL_ACCEPT_PICTURES";
/// Moment of the run that the pictures show, seconds.
const SHOWN: f64 = 1.2;

/// A panel that is drawn without a window.
struct DrawnPanel {
    harness: Harness<'static, View>,
    rasterizer: Rasterizer,
    size: [u32; 2],
}

impl DrawnPanel {
    fn new(pane: Pane, session: Session, size: [u32; 2], theme: Theme) -> Self {
        let mut view = View::new(session, PanelLayout::Watch);
        view.session.playback.playing = false;
        view.tree = build_single(pane);
        let rasterizer = Rasterizer::default();
        let mut harness = Harness::builder()
            .with_size(Vec2::new(size[0] as f32, size[1] as f32))
            .with_theme(theme)
            .renderer(rasterizer.clone())
            .build_ui_state(
                move |ui, view: &mut View| {
                    view.session.update(0.0);
                    view.update_layers(ui.ctx());
                    Frame::new().inner_margin(4).show(ui, |ui| {
                        view.panels.show(ui, PanelId::from(pane), &mut view.session);
                    });
                },
                view,
            );
        harness.run_steps(1);
        DrawnPanel {
            harness,
            rasterizer,
            size,
        }
    }

    /// The run of the pictures, read to its end.
    fn of_run(pane: Pane, size: [u32; 2]) -> Self {
        DrawnPanel::of_run_with_theme(pane, size, Theme::Dark)
    }

    fn of_run_with_theme(pane: Pane, size: [u32; 2], theme: Theme) -> Self {
        let session = Session::open(drawn_log()).expect("a session");
        let mut panel = DrawnPanel::new(pane, session, size, theme);
        panel.wait("the whole run", |view| {
            view.session.findings.complete && view.session.series.samples().len() == 20
        });
        panel.view().session.seek(SHOWN);
        panel
    }

    fn view(&mut self) -> &mut View {
        self.harness.state_mut()
    }

    fn wait(&mut self, what: &str, holds: impl Fn(&View) -> bool) {
        step_until(&mut self.harness, what, holds);
    }

    fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        self.harness.run_steps(2);
    }

    fn draw(&mut self) -> RgbImage {
        self.harness.run_steps(4);
        let background = self.harness.ctx.global_style().visuals.panel_fill;
        let output = self.harness.output();
        let ctx = &self.harness.ctx;
        self.rasterizer.draw(ctx, output, self.size, background)
    }
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/view_pictures")
}

/// Pixels whose colour differs; all if the sizes do.
fn different_pixels(one: &RgbImage, other: &RgbImage) -> usize {
    if one.dimensions() != other.dimensions() {
        return one.pixels().len().max(other.pixels().len());
    }
    let differs = |(one, other): &(&image::Rgb<u8>, &image::Rgb<u8>)| {
        let mut channels = one.0.iter().zip(other.0);
        channels.any(|(one, other)| one.abs_diff(other) > CHANNEL_TOLERANCE)
    };
    one.pixels().zip(other.pixels()).filter(differs).count()
}

/// Compares a picture with the stored one.
fn check(name: &str, drawn: &RgbImage) {
    let path = folder().join(format!("{name}.png"));
    let stored = image::open(&path).ok().map(|stored| stored.to_rgb8());
    let different = stored
        .as_ref()
        .map(|stored| different_pixels(drawn, stored));
    if different.is_some_and(|different| different <= DIFFERENT_PIXELS_MAX) {
        return;
    }
    if std::env::var_os(ACCEPT).is_some_and(|value| value == "1") {
        write_png(&path, drawn);
        return;
    }
    let refused = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/view_pictures");
    let refused = refused.join(format!("{name}.png"));
    write_png(&refused, drawn);
    let problem = different.map_or("there is no such picture".to_owned(), |different| {
        format!("{different} pixels differ (expected <= {DIFFERENT_PIXELS_MAX})")
    });
    panic!(
        "{}: {problem}. Compare it with {}. {ACCEPT}=1 accepts the change",
        path.display(),
        refused.display()
    );
}

/// Writes a picture with [`STORED_LEVELS`].
fn write_png(path: &Path, picture: &RgbImage) {
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    let file = std::fs::File::create(path).expect("a file");
    let encoder = PngEncoder::new_with_quality(file, CompressionType::Best, FilterType::Adaptive);
    let step = 255.0 / (STORED_LEVELS - 1.0);
    let mut stored = picture.clone();
    for channel in stored.iter_mut() {
        *channel = ((f32::from(*channel) / step).round() * step).round() as u8;
    }
    stored.write_with_encoder(encoder).expect("written");
}

#[test]
fn every_panel_has_a_picture() {
    for pane in PANES {
        let path = folder().join(format!("{}.png", pane.title().to_lowercase()));
        assert!(path.is_file(), "{} is missing", path.display());
    }
}

#[test]
fn picture_of_another_content_is_refused() {
    let mut panel = DrawnPanel::of_run(Pane::Field, [520, 400]);
    let field = panel.draw();
    assert_eq!(different_pixels(&field, &panel.draw()), 0, "the same again");
    panel.view().panels.field.layers.truth = false;
    let without_truth = panel.draw();
    assert!(different_pixels(&field, &without_truth) > DIFFERENT_PIXELS_MAX);
    panel.view().panels.field.layers.truth = true;
    // The next cycle: the robot has moved by 15 cm.
    panel.view().session.step(1);
    let later = panel.draw();
    assert!(different_pixels(&field, &later) > DIFFERENT_PIXELS_MAX);
}

#[test]
fn picture_with_one_other_digit_is_refused() {
    let mut panel = DrawnPanel::of_run(Pane::Health, [560, 330]);
    let health = panel.draw();
    panel.view().session.devices.devices[0].samples += 1;
    let other = panel.draw();
    let different = different_pixels(&health, &other);
    assert!(different > DIFFERENT_PIXELS_MAX, "{different}");
}

#[test]
fn camera_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Camera, [380, 360]);
    check("camera", &panel.draw());
}

#[test]
fn classes_and_scan_pixels_are_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Camera, [380, 360]);
    let layers = &mut panel.view().panels.camera.layers;
    (layers.image, layers.classes, layers.grid) = (false, true, true);
    wait_for_layer(&mut panel, |layers| layers.classes.is_some());
    check("camera_classes", &panel.draw());
}

#[test]
fn birds_eye_view_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Camera, [340, 330]);
    panel.view().panels.camera.birds_eye = true;
    wait_for_layer(&mut panel, |layers| layers.birds_eye.is_some());
    check("camera_birds_eye", &panel.draw());
}

/// Waits for a layer of the shown cycle.
fn wait_for_layer(
    panel: &mut DrawnPanel,
    is_there: impl Fn(&super::super::layer_worker::RenderedLayers) -> bool,
) {
    panel.wait("the layer", |view| {
        let layers = &view.session.rendered_layers;
        let stamp = |cycle: &Arc<Cycle>| cycle.stamp.seconds();
        let of = layers.cycle.as_ref().map(stamp);
        is_there(layers) && of == view.session.shown_time()
    });
}

#[test]
fn field_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Field, [640, 460]);
    check("field", &panel.draw());
}

#[test]
fn field_in_the_light_theme_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run_with_theme(Pane::Field, [520, 400], Theme::Light);
    panel.view().session.select_next(true);
    check("field_light", &panel.draw());
}

#[test]
fn error_landscape_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Field, [520, 400]);
    panel.view().panels.field.layers.background = FieldBackground::ErrorLandscape;
    wait_for_layer(&mut panel, |layers| layers.error_landscape.is_some());
    check("field_landscape", &panel.draw());
}

#[test]
fn plots_are_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Plots, [560, 420]);
    check("plots", &panel.draw());
}

#[test]
fn other_kinds_of_plots_are_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Plots, [560, 760]);
    let plots = PlotConfig::one_of_each_kind(["= 100 * {position error}", "std y"]);
    panel.view().panels.plots.set_plots(plots);
    panel.wait("the formula", |view| {
        let curve = view.session.curve("= 100 * {position error}");
        curve.is_some_and(|curve| curve.len() == 20)
    });
    check("plots_kinds", &panel.draw());
}

#[test]
fn timeline_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Timeline, [560, 150]);
    let opened = panel.view().session.open_beside(drawn_log());
    opened.expect("a second run");
    panel.view().session.add_mark("ball lost");
    panel.wait("the other run", |view| {
        view.session.others[0].series.samples().len() == 20
    });
    check("timeline", &panel.draw());
}

#[test]
fn simulator_is_drawn_as_stored() {
    // The simulation stands at its beginning; its cycles go elsewhere, and one of the drawn run is shown.
    let config = PipelineConfig::default();
    let elsewhere = CycleInbox::default();
    let (worker, setup) =
        SimWorker::start(&scenario(), None, config.clone(), elsewhere).expect("a simulation");
    worker.request(SourceRequest::Pause(true));
    worker.request(SourceRequest::Restart(7));
    worker.request(SourceRequest::Pause(true));
    let inbox = CycleInbox::default();
    let live = LiveSource::new(inbox, Some(worker));
    let session = Session::from_live("simulation".to_owned(), live, setup, config);
    let session = session.expect("a session");
    let mut panel = DrawnPanel::new(Pane::Simulator, session, [460, 420], Theme::Dark);
    panel.wait("the beginning", |view| {
        let status = view.session.source.simulation().map(SimWorker::status);
        status.is_some_and(|status| status.paused && status.seed == 7 && status.time == 0.0)
    });
    check("simulator", &panel.draw());
}

#[test]
fn calibration_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Calibration, [520, 560]);
    check("calibration", &panel.draw());
}

#[test]
fn parameters_are_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Parameters, [560, 420]);
    let mut config = PipelineConfig::default();
    config.vision.scan.range_max = 7.0;
    panel.view().session.apply_config(config);
    panel.view().panels.parameters.find("vision.scan");
    check("parameters", &panel.draw());
}

#[test]
fn health_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Health, [640, 260]);
    check("health", &panel.draw());
}

#[test]
fn findings_are_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Findings, [560, 160]);
    panel.click("Next moment");
    check("findings", &panel.draw());
}

#[test]
fn details_are_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Details, [400, 280]);
    panel.view().session.selection = Some(Selection::Estimate);
    panel.harness.run_steps(1);
    panel.wait("the history", |view| {
        let session = &view.session;
        let cycle = session.shown.as_ref().expect("a cycle").cycle.clone();
        let fields = Selection::Estimate.fields(&cycle);
        let whole = |path: &str| session.curve(path).is_some_and(|curve| curve.len() >= 20);
        fields.iter().all(|(_, path)| whole(path))
    });
    check("details", &panel.draw());
}

#[test]
fn scene_is_drawn_as_stored() {
    let mut panel = DrawnPanel::of_run(Pane::Scene, [560, 400]);
    panel.view().session.pointed_ground = Some(localize::At::new(2.0, 1.0));
    check("scene", &panel.draw());
}
