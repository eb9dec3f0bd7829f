//! Two live robots in one field panel.

use eframe::egui::Color32;
use pipeline::config::PIPELINE_FILE;
use pipeline::feed::Feed;
use pipeline::log::Header;

use super::panels::texts;
use super::rasterizer::Rasterizer;
use super::*;
use crate::stream::{StreamConfig, StreamPreamble, StreamServer};
use crate::view::layout::build_single;
use crate::view::palette;
use crate::view::panels::Pane;

/// Wall clock at the zero of the first robot's stamps, nanoseconds. The second one's began later.
const FIRST_CLOCK_NS: i64 = 1_800_000_000_000_000_000;
const SECOND_LATER_NS: i64 = 200_000_000;

/// A simulated robot with a live stream on this machine.
struct LiveRobot {
    feed: Feed,
    server: StreamServer,
    cycles: Vec<Arc<Cycle>>,
}

impl LiveRobot {
    /// Simulates it first, so that its cycles can be sent at any time.
    fn simulate(scenario: &str, clock_offset_ns: i64) -> Self {
        let path = super::scenario().with_file_name(scenario);
        let simulation = Simulation::load(&path, None, Some(0.6)).expect("a scenario");
        let setup = simulation.setup().expect("a robot");
        let config = PipelineConfig::default();
        let mut pipeline = Pipeline::new(&setup, &config).expect("a pipeline");
        let cycles = simulation.filter_map(|sample| pipeline.process_sample(sample));
        let cycles = cycles.map(|mut cycle| {
            cycle.inputs.image = None;
            Arc::new(cycle)
        });
        let cycles = cycles.collect();
        let map = setup.camera.as_ref().map(|(_, map)| &**map);
        let settings = config.to_table().expect("settings").to_string();
        let header = Header::new("run", None)
            .with_robot(&setup.robot, map, setup.colours.as_ref())
            .expect("a robot")
            .with_file(PIPELINE_FILE, settings)
            .with_clock_offset_ns(clock_offset_ns);
        let preamble = StreamPreamble {
            header: &header,
            field: &setup.field,
        };
        let stream = StreamConfig {
            port: 0,
            ..StreamConfig::default()
        };
        let feed = Feed::new();
        let server = StreamServer::start(&feed, preamble, None, &stream).expect("a stream");
        LiveRobot {
            feed,
            server,
            cycles,
        }
    }

    fn address(&self) -> PathBuf {
        PathBuf::from(format!("127.0.0.1:{}", self.server.port()))
    }

    /// Sends the cycle of a number, as the robot would at its stamp.
    fn send(&self, number: usize) {
        self.feed.publish(&self.cycles[number]);
    }
}

/// Pixels of about a colour.
fn pixels_of(picture: &image::RgbImage, colour: Color32) -> usize {
    let is_near = |pixel: &&image::Rgb<u8>| {
        let mut channels = pixel.0.iter().zip(colour.to_array());
        channels.all(|(one, other)| one.abs_diff(other) < 30)
    };
    picture.pixels().filter(is_near).count()
}

fn shown_stamps(view: &View) -> Option<[localize::Stamp; 2]> {
    let first = view.session.shown.as_ref()?.cycle.stamp;
    let second = view.session.others[0].cycle.as_ref()?.stamp;
    Some([first, second])
}

#[test]
fn two_live_robots_are_drawn_in_one_field_panel() {
    let first = LiveRobot::simulate("demo.toml", FIRST_CLOCK_NS);
    let second = LiveRobot::simulate("game_18x12.toml", FIRST_CLOCK_NS + SECOND_LATER_NS);
    let mut session = Session::open(&first.address()).expect("the first robot");
    session
        .open_beside(&second.address())
        .expect("the second robot");
    let mut view = View::new(session, PanelLayout::Localization);
    view.tree = build_single(Pane::Field);
    let rasterizer = Rasterizer::default();
    let mut harness = Harness::builder()
        .with_size([900.0, 700.0])
        .renderer(rasterizer.clone())
        .build_ui_state(|ui, view: &mut View| view.ui(ui), view);
    // A viewer gets what is sent after its subscription: repeat the first cycle until both arrive.
    let started = Instant::now();
    while shown_stamps(harness.state()).is_none() {
        assert!(started.elapsed() < TIMEOUT, "timeout: both robots");
        first.send(0);
        second.send(0);
        std::thread::sleep(Duration::from_millis(20));
        harness.run_steps(1);
    }
    let last = first.cycles.len().min(second.cycles.len()) - 1;
    for number in 1..=last {
        first.send(number);
        second.send(number);
        let stamps = [&first, &second].map(|robot| robot.cycles[number].stamp);
        step_until(&mut harness, "the next cycles", |view| {
            shown_stamps(view) == Some(stamps)
        });
    }
    let pose = |robot: &LiveRobot| robot.cycles[last].estimate.pose.expect("a pose");
    assert_eq!(
        harness.state().session.others[0].pose(),
        Some(pose(&second)),
        "it is drawn where it is, not where the first one is"
    );
    let apart = pose(&first).origin().distance_to(pose(&second).origin());
    assert!(apart > 0.5, "different places: {apart} m");

    // Its name is there, without a difference of two runs of one robot.
    let texts: Vec<String> = texts(&harness.output().shapes)
        .into_iter()
        .map(|(text, _)| text)
        .collect();
    let name = second.address().display().to_string();
    assert!(texts.contains(&name), "{texts:?}");
    assert!(
        !texts.iter().any(|text| text.contains("apart")),
        "{texts:?}"
    );

    // Both are in the picture, the second one as long as it is open.
    let draw = |harness: &mut Harness<'_, View>| {
        harness.run_steps(2);
        rasterizer.draw(&harness.ctx, harness.output(), [900, 700], Color32::BLACK)
    };
    let both = draw(&mut harness);
    let closed = harness.state_mut().session.others.pop();
    let alone = draw(&mut harness);
    let [with, without] = [&both, &alone].map(|it| pixels_of(it, palette::run_colour(0)));
    assert!(with > without + 20, "second robot: {with} and {without}");
    let estimate = pixels_of(&both, palette::ESTIMATE);
    assert!(estimate > 20, "first robot: {estimate}");

    // At an earlier moment each shows its cycle of that time by the clock on the wall.
    harness.state_mut().session.others.extend(closed);
    let time = first.cycles[last].stamp.seconds() - 0.1;
    harness.state_mut().session.seek(time);
    harness.run_steps(2);
    let stamps = shown_stamps(harness.state()).expect("two cycles");
    let [first_at, second_at] = stamps.map(localize::Stamp::seconds);
    assert!((0.0..0.04).contains(&(time - first_at)), "{first_at}");
    let second_at = second_at + 1e-9 * SECOND_LATER_NS as f64;
    assert!((0.0..0.04).contains(&(time - second_at)), "{second_at}");
}

#[test]
fn logs_of_one_robot_are_compared_and_those_of_team_mates_are_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let mate = folder.path().join("mate.mcap");
    let mut config = PipelineConfig::default();
    config.team.number += 1;
    record_with(&mate, ImageCompression::None, &config, |_, _| {});
    for (other, compared) in [(log(), true), (&*mate, false)] {
        let mut harness = open_demo_log(PanelLayout::Watch);
        let opened = harness.state_mut().session.open_beside(other);
        opened.expect("a second run");
        harness.run_steps(3);
        let texts = texts(&harness.output().shapes);
        let name = other.file_name().expect("a name").to_string_lossy();
        let mut labels = texts.iter().filter(|(text, _)| text.starts_with(&*name));
        assert!(
            labels.any(|(text, _)| text.contains("apart") == compared),
            "{texts:?}"
        );
        assert_eq!(
            texts.iter().any(|(text, _)| text.contains("apart")),
            compared
        );
    }
}
