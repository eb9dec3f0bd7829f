//! Tests of complete logs: content, replay and export.

use std::sync::Arc;

use localize::Pose;
use localize::estimate::Reason;
use localize::map_correction::{MapCorrection, MapFit};
use nalgebra::Matrix3;
use vision::image::Image;

use crate::config::PipelineConfig;
use crate::cycle::{Cycle, Inputs};
use crate::feed::Pace;
use crate::log::verify::first_difference;
use crate::log::{
    Header, ImageCompression, LogCompleteness, LogConfig, LogReader, Recorder, UnpackedSetup,
    VerificationReport, export, verify,
};
use crate::pipeline::Pipeline;
use crate::recording::Recording;
use crate::sample::{Sample, SettingsChange};
use crate::setup::Setup;
use crate::testing::{random_cycle, random_image, read, record, sample_recording};
use crate::warm_start::StampedPose;

#[test]
fn recorded_cycles_read_back_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let written = record(&path, 40, &LogConfig::default());
    assert_eq!(
        (written.cycles, written.images, written.dropped.is_zero()),
        (40, 40, true)
    );
    let log = LogReader::open(&path).expect("a log");
    assert_eq!(
        (log.header().seed, log.header().source.as_str()),
        (Some(7), "test")
    );
    assert_eq!(log.header().version_mismatch(), None);
    let logged = read(&path);
    assert_eq!(logged.len(), 40);
    for (number, logged) in logged.iter().enumerate() {
        let wanted = random_cycle(number as u64);
        assert_eq!(logged.index, number as u64);
        assert_eq!(first_difference(&wanted, &logged.cycle, true), None);
        assert_eq!(
            format!(
                "{:?}",
                Cycle {
                    inputs: Inputs {
                        image: None,
                        ..wanted.inputs
                    },
                    ..wanted
                }
            ),
            format!("{:?}", logged.cycle)
        );
        let image = logged
            .image
            .as_ref()
            .expect("an image")
            .decode()
            .expect("decoded");
        assert_eq!(image, random_image(number as u64));
    }
}

#[test]
fn single_bit_flip_is_detected() {
    let mut other = random_cycle(5);
    other.estimate.covariance[(2, 1)] =
        f32::from_bits(other.estimate.covariance[(2, 1)].to_bits() ^ 1);
    let difference = first_difference(&random_cycle(5), &other, true).expect("a difference");
    assert_eq!(difference.quantity, "covariance");
    let mut negated = random_cycle(5);
    negated.estimate.tilt[0] = 0.0;
    let mut zero = random_cycle(5);
    zero.estimate.tilt[0] = -0.0;
    assert!(first_difference(&negated, &zero, true).is_some());
}

#[test]
fn difference_names_the_value_that_differs() {
    let recorded = random_cycle(5);
    let mut other = recorded.clone();
    let pose = recorded.estimate.pose.expect("a pose");
    other.estimate.pose = Some(Pose::new(pose.x, 7.5, pose.theta));
    let difference = first_difference(&recorded, &other, true).expect("a difference");
    assert_eq!(difference.quantity, "pose");
    assert_eq!(difference.recorded, format!("y: {:?}", pose.y));
    assert_eq!(difference.computed, "y: 7.5");
    other.estimate.pose = None;
    let difference = first_difference(&recorded, &other, true).expect("a difference");
    assert_eq!(
        (&*difference.recorded, &*difference.computed),
        ("a value", "none")
    );
}

#[test]
fn export_writes_a_complete_recording_or_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, out) = (
        folder.path().join("a.mcap"),
        folder.path().join("recording"),
    );
    record(&path, 5, &LogConfig::default());
    let exported = export(LogReader::open(&path).expect("a log"), &out).expect("exported");
    assert_eq!(
        (exported.frames, exported.odometry, exported.end),
        (5, 15, LogCompleteness::Complete)
    );
    let frames = std::fs::read_to_string(out.join("frames.csv")).expect("frames");
    assert_eq!(frames.lines().nth(2), Some("0.033333333,frames/000001.png"));
    assert_eq!(
        Image::load(&out.join("frames/000004.png")).expect("an image"),
        random_image(4)
    );
    let odometry = std::fs::read_to_string(out.join("odometry.csv")).expect("odometry");
    let dx: f32 = odometry
        .lines()
        .nth(4)
        .and_then(|row| row.split(',').nth(1))
        .expect("dx")
        .parse()
        .expect("a number");
    assert_eq!(
        dx.to_bits(),
        random_cycle(1).inputs.odometry[0].dx.to_bits()
    );
    assert!(!out.join("points.csv").exists());
    let refused = export(LogReader::open(&path).expect("a log"), &out).expect_err("refused");
    assert!(format!("{refused:#}").contains("not an empty folder"));

    record(&path, 200, &LogConfig::default());
    let mut bytes = std::fs::read(&path).expect("bytes");
    let late = bytes.len() * 2 / 3;
    bytes[late] ^= 0xff;
    std::fs::write(&path, &bytes).expect("damaged");
    let other = folder.path().join("other");
    assert!(export(LogReader::open(&path).expect("a log"), &other).is_err());
    let left: Vec<_> = folder
        .path()
        .read_dir()
        .expect("entries")
        .map(|entry| entry.expect("one").file_name())
        .collect();
    assert_eq!(left.len(), 2, "{left:?}");
}

#[test]
fn a_log_without_images_exports_line_points() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, out) = (
        folder.path().join("a.mcap"),
        folder.path().join("recording"),
    );
    record(
        &path,
        5,
        &LogConfig {
            images: ImageCompression::None,
            ..LogConfig::default()
        },
    );
    assert_eq!(
        export(LogReader::open(&path).expect("a log"), &out)
            .expect("exported")
            .frames,
        5
    );
    let points = std::fs::read_to_string(out.join("points.csv")).expect("points");
    assert_eq!(points.lines().count(), 1 + 5 * 50);
    assert!(!out.join("frames.csv").exists() && !out.join("frames").exists());
}

/// Cycles during which the set-up counts as doubtful.
const DOUBTED: std::ops::Range<usize> = 8..14;

/// Cycle from which on the images' own mount is in use.
const OTHER_MOUNT: usize = 11;

/// Errors of the map as images may tell them.
fn other_mount(pipeline: &Pipeline) -> MapFit {
    let terms = pipeline.map_correction().expect("a map").basis().terms();
    let unknowns: Vec<f64> = terms.iter().map(|term| 0.1 * f64::from(term.std)).collect();
    let row = |i| -> Vec<f64> {
        let variance = |k| {
            if k == i {
                unknowns[i] * unknowns[i]
            } else {
                0.0
            }
        };
        (0..terms.len()).map(variance).collect()
    };
    let covariance: Vec<Vec<f64>> = (0..terms.len()).map(row).collect();
    let text =
        format!("unknowns = {unknowns:?}\ncovariance = {covariance:?}\nviewpoint_shift = 0.01\n");
    toml::from_str(&text).expect("a fit")
}

/// The set-up of the sample recording, and the header of a log with it.
fn sample_setup() -> (Setup, Header) {
    let setup = Setup::load(&sample_recording().join("robot.toml"), None).expect("a setup");
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new("test", None)
        .with_robot(&setup.robot, map, None)
        .expect("a header");
    (setup, header)
}

/// Records a run on the sample recording, whose set-up is doubted for some cycles and whose mount turns out to be another one, and recomputes it from the log alone.
fn record_and_verify(images: ImageCompression) -> VerificationReport {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let (setup, header) = sample_setup();
    let config = LogConfig {
        images,
        ..LogConfig::default()
    };
    let mut recorder = Recorder::create(&path, &header, &setup.field, Pace::Lockstep, &config)
        .expect("a recorder");
    let mut pipeline = Pipeline::new(&setup, &PipelineConfig::default()).expect("a pipeline");
    let mut cycles = 0;
    for sample in Recording::open(&sample_recording(), 0.04).expect("a recording") {
        let Some(cycle) = pipeline.process_sample(sample) else {
            continue;
        };
        let is_mounted_otherwise = pipeline
            .map_correction()
            .is_some_and(MapCorrection::is_in_use);
        assert_eq!(
            is_mounted_otherwise,
            cycles >= OTHER_MOUNT,
            "cycle {cycles}"
        );
        let is_doubtful = cycle.estimate.reason == Some(Reason::DoubtfulSetup);
        assert_eq!(is_doubtful, DOUBTED.contains(&cycles), "cycle {cycles}");
        cycles += 1;
        if cycles == DOUBTED.start {
            pipeline.mark_setup_doubtful(Matrix3::identity());
        } else if cycles == DOUBTED.end {
            pipeline.mark_setup_doubtful(Matrix3::zeros());
        } else if cycles == OTHER_MOUNT {
            pipeline.adopt_map_fit(other_mount(&pipeline));
        }
        recorder.record_cycle(Arc::new(cycle)).expect("taken");
    }
    recorder.finish().expect("written");
    let log = LogReader::open(&path).expect("a log");
    let unpacked = UnpackedSetup::load(log.header()).expect("the log's own setup");
    let mut pipeline =
        Pipeline::new(&unpacked.setup, &PipelineConfig::default()).expect("a pipeline");
    verify(log, |sample| pipeline.process_sample(sample)).expect("a verdict")
}

#[test]
fn sample_recording_replays_bit_for_bit_including_vision() {
    let verdict = record_and_verify(ImageCompression::Png);
    assert_eq!(verdict.first_difference, None);
    assert_eq!(
        (verdict.cycles, verdict.vision_cycles, verdict.unverified),
        (20, 20, 0)
    );
}

#[test]
fn localization_replays_from_line_points_without_lossless_images() {
    for images in [ImageCompression::Jpeg, ImageCompression::None] {
        let verdict = record_and_verify(images);
        assert_eq!(verdict.first_difference, None);
        assert_eq!((verdict.cycles, verdict.vision_cycles), (20, 0));
    }
}

/// Cycles of the sample recording before a pipeline goes on with the log that begins with a gap.
const BEFORE_GAP: usize = 8;

/// Records the part after a gap, whose first cycle holds the state of the pipeline, moved by `shift` metres, and recomputes it.
fn verify_after_gap(shift: f32) -> VerificationReport {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let (setup, header) = sample_setup();
    let log_config = LogConfig {
        images: ImageCompression::None,
        ..LogConfig::default()
    };
    let mut recorder = Recorder::create(&path, &header, &setup.field, Pace::Lockstep, &log_config)
        .expect("a recorder");
    let config = PipelineConfig::default();
    let mut pipeline = Pipeline::new(&setup, &config).expect("a pipeline");
    recorder.set_next_index(BEFORE_GAP as u64);
    let mut number = 0;
    for sample in Recording::open(&sample_recording(), 0.04).expect("a recording") {
        let Some(mut cycle) = pipeline.process_sample(sample) else {
            continue;
        };
        number += 1;
        if number > BEFORE_GAP {
            let state = cycle.inputs.warm_start.as_mut();
            if let Some(last) = state.and_then(|state| state.pose.as_mut()) {
                let (stamp, pose, covariance) = last.parts();
                let moved = Pose::new(pose.x + shift, pose.y, pose.theta);
                *last = StampedPose::new(stamp, moved, &covariance);
            }
            recorder.record_cycle(Arc::new(cycle)).expect("taken");
        }
        if number == BEFORE_GAP {
            let next = Pipeline::new(&setup, &config).expect("a pipeline");
            let change = SettingsChange {
                config_toml: toml::to_string(&config).expect("settings").into(),
                warm_start: None,
            };
            pipeline.replace_by(next, change);
        }
    }
    recorder.finish().expect("written");
    let mut pipeline = Pipeline::new(&setup, &config).expect("a pipeline");
    let log = LogReader::open(&path).expect("a log");
    let verdict = verify(log, |sample| match sample {
        Sample::Settings(change) => {
            let next = Pipeline::new(&setup, &config).expect("a pipeline");
            pipeline.replace_by(next, change);
            None
        }
        other => pipeline.process_sample(other),
    });
    verdict.expect("a verdict")
}

#[test]
fn log_after_a_gap_replays_from_its_own_state_and_from_no_other() {
    let own = verify_after_gap(0.0);
    assert_eq!(own.first_difference, None);
    assert_eq!((own.cycles, own.resumed.len()), (12, 1));
    let other = verify_after_gap(0.3);
    assert!(other.different > 0, "{other:?}");
}
