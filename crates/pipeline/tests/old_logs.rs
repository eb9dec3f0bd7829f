//! Does a log of version 0.1.0 open and verify? It holds its settings as spine.toml, under their old names.

use std::path::Path;
use std::sync::Arc;

use pipeline::feed::Pace;
use pipeline::log::{Header, LogConfig, LogReader, Recorder, UnpackedSetup, verify};
use pipeline::recording::Recording;
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Settings as `mirrorball sim` of version 0.1.0 wrote them into its logs: all defaults.
const OLD_SETTINGS: &str = include_str!("data/spine_0.1.0.toml");

#[test]
fn a_log_of_version_0_1_0_verifies_with_its_own_settings() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.mcap");
    // One setting differs from the default, so that a lost one would show.
    let settings = OLD_SETTINGS.replace("way_noise = 0.02", "way_noise = 0.05");
    let mut config = PipelineConfig::default();
    config.localize.filter.odometry_noise_per_metre = 0.05;
    // The defaults were others.
    config.vision.objects.robot_range_max = 7.0;
    for tracks in [&mut config.world.ball, &mut config.world.robots] {
        tracks.false_alarm_probability = 0.08;
        tracks.detection_probability = 0.6;
        tracks.confirm_probability = 0.7;
    }

    let setup = Setup::load(&sample.join("robot.toml"), None).expect("a setup");
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new("test", None)
        .with_robot(&setup.robot, map, None)
        .expect("a header")
        .with_file("spine.toml", settings);
    let mut recorder = Recorder::create(
        &path,
        &header,
        &setup.field,
        Pace::Lockstep,
        &LogConfig::default(),
    )
    .expect("a recorder");
    let mut pipeline = Pipeline::new(&setup, &config).expect("a pipeline");
    for sample in Recording::open(&sample, 0.04).expect("a recording") {
        if let Some(cycle) = pipeline.process_sample(sample) {
            recorder.record_cycle(Arc::new(cycle)).expect("recorded");
        }
    }
    recorder.finish().expect("written");

    let log = LogReader::open(&path).expect("a log");
    assert!(!log.header().files.contains_key("spine.toml"));
    let unpacked = UnpackedSetup::load(log.header()).expect("the log's setup");
    let config = unpacked.config().expect("settings");
    let mut pipeline = Pipeline::new(&unpacked.setup, &config).expect("a pipeline");
    let report = verify(log, |sample| pipeline.process_sample(sample)).expect("verified");
    assert_eq!(report.first_difference, None);
    assert_eq!((report.cycles, report.vision_cycles), (20, 20));
}

#[test]
fn settings_of_version_0_1_0_are_today_s_defaults_under_new_names() {
    let folder = tempfile::tempdir().expect("a folder");
    let old = folder.path().join("spine.toml");
    std::fs::write(&old, OLD_SETTINGS).expect("written");
    let error = PipelineConfig::load("default", Some(&old)).expect_err("old names by hand");
    let error = format!("{error:#}");
    let line = 1 + OLD_SETTINGS
        .lines()
        .position(|line| line.starts_with("drift ="))
        .expect("drift");
    let expected = format!(
        "spine.toml: line {line}: unknown setting localize.filter.drift (renamed localize.filter.odometry_drift)"
    );
    assert!(error.contains(&expected), "{error}");
}
