//! Does a log replay to the same bits while vision reads half of the scan lines in each image?

use std::path::Path;
use std::sync::Arc;

use pipeline::feed::Pace;
use pipeline::log::{Header, LogConfig, LogReader, Recorder, UnpackedSetup, verify};
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};

/// Images of the drive: 1.5 s.
const IMAGES: usize = 45;

#[test]
fn interlaced_drive_verifies_with_its_images() {
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios/demo.toml");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    let mut sim = Simulation::load(&scenario, Some(3), None).expect("a scenario");
    let setup = sim.setup().expect("a setup");
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new("test", Some(3))
        .with_robot(&setup.robot, map, None)
        .expect("a header");
    let log_config = LogConfig::default();
    let mut recorder = Recorder::create(&path, &header, &setup.field, Pace::Lockstep, &log_config)
        .expect("a recorder");

    let config = PipelineConfig::default();
    let mut every_line = config.clone();
    every_line.vision.scan.interlaced_points_min = 0;
    let mut interlaced = Pipeline::new(&setup, &config).expect("a pipeline");
    let mut whole = Pipeline::new(&setup, &every_line).expect("a pipeline");
    let (mut halves, mut images) = (0, 0);
    while images < IMAGES {
        let sample = sim.next_sample();
        let compared = whole.process_sample(sample.clone());
        let cycle = interlaced.process_sample(sample);
        let (Some(cycle), Some(compared)) = (cycle, compared) else {
            continue;
        };
        halves += usize::from(4 * cycle.line_points.len() < 3 * compared.line_points.len());
        images += 1;
        recorder.record_cycle(Arc::new(cycle)).expect("recorded");
    }
    recorder.finish().expect("written");
    assert!(
        halves > IMAGES / 2,
        "{halves} of {IMAGES} images interlaced"
    );

    let log = LogReader::open(&path).expect("a log");
    let unpacked = UnpackedSetup::load(log.header()).expect("the log's setup");
    let config = unpacked.config().expect("settings");
    let mut pipeline = Pipeline::new(&unpacked.setup, &config).expect("a pipeline");
    let report = verify(log, |sample| pipeline.process_sample(sample)).expect("verified");
    assert_eq!(report.first_difference, None);
    assert_eq!(report.vision_cycles, IMAGES as u64);
}
