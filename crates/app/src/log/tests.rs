//! Claims about the log as a whole: what goes in comes out, from whole, killed and damaged files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use localize::estimate::{Estimate, Mode, Reason};
use localize::frame::At;
use localize::sample::{Compass, Imu, LinePoint, Odometry};
use localize::search::Hypothesis;
use localize::{Field, Pose, Stamp};
use nalgebra::Matrix3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vision::ball::Ball;
use vision::eyes::Seen;
use vision::goals::{Goal, GoalKind};
use vision::image::Image;
use vision::line_points::{Refusal, RefusedRun, SeenLinePoint};
use vision::robots::{Marker, Robot};

use super::*;
use crate::cycle::{Cycle, Inputs, Spine, SpineConfig, Timings};
use crate::recording::Recording;
use crate::sample::Truth;
use crate::setup::Setup;

pub(super) fn field() -> Field {
    Field::load(&sample_folder().join("field.toml")).expect("a field")
}

fn sample_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence")
}

/// A cycle of arbitrary values, zeros of both signs among them.
pub(super) fn cycle(number: u64) -> Cycle {
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    let mut any = || match rng.random_range(0..8) {
        0 => -0.0,
        1 => 0.0,
        2 => f32::from_bits(1),
        _ => rng.random_range(-3.0_f32..3.0),
    };
    let stamp = Stamp(33_333_333 * number as i64);
    let pose = Pose::new(any(), any(), any());
    let matrix = Matrix3::from_fn(|_, _| any());
    let point = |x, y| LinePoint {
        at: At::new(x, y),
        std_radial: 0.01,
        std_tangential: -0.0,
    };
    let points: Vec<LinePoint> = (0..50).map(|_| point(any(), any())).collect();
    let seen = Seen {
        line_points: points
            .iter()
            .map(|&point| SeenLinePoint {
                point,
                at_px: [1.5, 2.5],
                contrast: any(),
                width: any(),
            })
            .collect(),
        refused: vec![RefusedRun {
            at_px: [7.0, any()],
            reason: Refusal::BeyondCarpet,
        }],
        ball: Some(Ball {
            at: At::new(any(), any()),
            covariance: [any(), any(), any()],
            on_ground: true,
            score: any(),
            at_px: [any(), 3.0],
            pixels: 99,
        }),
        robots: vec![Robot {
            at: At::new(any(), any()),
            edge: At::new(any(), any()),
            covariance: [any(), any(), any()],
            width: any(),
            marker: (number % 2 == 0).then_some(Marker::Magenta),
            score: any(),
            at_px: [any(), any()],
        }],
        goals: vec![Goal {
            kind: GoalKind::Post,
            at: At::new(any(), any()),
            covariance: [any(), any(), any()],
            width: any(),
            score: any(),
            at_px: [any(), any()],
        }],
        carpet_end: vec![any(), f32::INFINITY],
        carpet_share: any(),
        learned: number == 0,
    };
    let hypothesis = Hypothesis {
        pose,
        covariance: matrix,
        score: any(),
        inlier_share: any(),
        residual: any(),
        lean: [any(), -0.0],
        probability: any(),
    };
    let inputs = Inputs {
        odometry: (0..3)
            .map(|_| Odometry {
                stamp,
                dx: any(),
                dy: any(),
                dtheta: any(),
            })
            .collect(),
        compass: vec![Compass {
            stamp,
            heading: any(),
        }],
        imu: vec![Imu {
            stamp,
            acceleration: [any(), any(), any()],
            rate: [any(), any(), any()],
        }],
        truth: Some(Truth {
            stamp,
            pose,
            ball: Some(At::new(any(), any())),
            robots: vec![At::new(any(), any())],
        }),
        image: Some(Arc::new(picture(number))),
    };
    let estimate = Estimate {
        stamp,
        pose: (number % 3 > 0).then_some(pose),
        covariance: matrix,
        mode: [Mode::Lost, Mode::Tracking, Mode::Global][number as usize % 3],
        reason: (number % 3 == 0).then_some(Reason::NothingFits),
        residual: any(),
        inlier_share: any(),
        line_points: points.len(),
        lean: [any(), any()],
        half_known: number % 2 == 0,
        odometry_scales: [any(), any()],
        runners_up: vec![hypothesis],
    };
    let timings = Timings {
        see_ms: 0.25,
        localize_ms: 0.0625,
    };
    Cycle {
        stamp,
        inputs,
        seen: Some(seen),
        points,
        estimate,
        fault: None,
        timings,
    }
}

fn picture(number: u64) -> Image {
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    Image {
        width_px: 64,
        height_px: 48,
        rgb: (0..3 * 64 * 48).map(|_| rng.random()).collect(),
    }
}

fn record(path: &Path, count: u64, config: &LogConfig) -> Written {
    let header = Header::new("test", Some(7)).with_file("robot.toml", "field = \"field.toml\"\n");
    let mut recorder =
        Recorder::create(path, &header, &field(), Pace::Lockstep, config).expect("a recorder");
    for number in 0..count {
        recorder.cycle(Arc::new(cycle(number))).expect("taken");
    }
    recorder.finish().expect("written")
}

fn read(path: &Path) -> Vec<Logged> {
    Log::open(path)
        .expect("a log")
        .collect::<anyhow::Result<_>>()
        .expect("cycles")
}

/// The error of a log that cannot be read to its end, as the user sees it.
fn complaint(path: &Path) -> String {
    let read = Log::open(path).and_then(|log| log.collect::<anyhow::Result<Vec<_>>>());
    format!("{:#}", read.map(|_| ()).expect_err("an error"))
}

#[test]
fn what_is_recorded_reads_back_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let written = record(&path, 40, &LogConfig::default());
    assert_eq!(
        (written.cycles, written.images, written.dropped.none()),
        (40, 40, true)
    );
    let log = Log::open(&path).expect("a log");
    assert_eq!(
        (log.header().seed, log.header().source.as_str()),
        (Some(7), "test")
    );
    assert_eq!(log.header().other_version(), None);
    let logged = read(&path);
    assert_eq!(logged.len(), 40);
    for (number, logged) in logged.iter().enumerate() {
        let wanted = cycle(number as u64);
        assert_eq!(logged.index, number as u64);
        assert_eq!(compare(&wanted, &logged.cycle), None);
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
        assert_eq!(image, picture(number as u64));
    }
}

#[test]
fn one_flipped_bit_is_a_difference() {
    let mut other = cycle(5);
    other.estimate.covariance[(2, 1)] =
        f32::from_bits(other.estimate.covariance[(2, 1)].to_bits() ^ 1);
    let difference = compare(&cycle(5), &other).expect("a difference");
    assert_eq!(difference.what, "covariance");
    let mut negated = cycle(5);
    negated.estimate.lean[0] = 0.0;
    let mut zero = cycle(5);
    zero.estimate.lean[0] = -0.0;
    assert!(compare(&negated, &zero).is_some());
}

#[test]
fn a_cut_log_reads_to_its_last_whole_chunk_and_is_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, cut, whole) = (
        folder.path().join("a.mcap"),
        folder.path().join("cut.mcap"),
        folder.path().join("b.mcap"),
    );
    record(&path, 300, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("bytes");
    std::fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).expect("cut");
    let before = read(&cut);
    assert!(before.len() > 100 && before.len() < 300, "{}", before.len());
    let recovered = recover(&cut, &whole).expect("recovered");
    assert!(!recovered.was_whole && recovered.lost.is_empty());
    assert!(recovered.until >= before.last().map(|logged| logged.cycle.stamp));
    let mut log = Log::open(&whole).expect("a log");
    assert_eq!(log.header(), Log::open(&path).expect("a log").header());
    assert_eq!(
        log.by_ref()
            .map(|logged| logged.expect("a cycle").index)
            .last(),
        before.last().map(|logged| logged.index)
    );
    assert_eq!(log.end(), Some(End::Whole));
    let bytes = std::fs::read(&whole).expect("bytes");
    let summary = mcap::Summary::read(&bytes)
        .expect("readable")
        .expect("a summary");
    assert_eq!(
        summary.stats.expect("statistics").message_count,
        recovered.messages
    );
    assert!(format!("{:#}", recover(&cut, &cut).expect_err("refused")).contains("into itself"));
}

#[test]
fn a_damaged_log_is_one_clear_message_and_recover_skips_the_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, whole) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&path, 300, &LogConfig::default());
    let mut bytes = std::fs::read(&path).expect("bytes");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 16].fill(0x55);
    std::fs::write(&path, &bytes).expect("damaged");
    let told = complaint(&path);
    assert!(
        told.contains("is damaged at byte") && told.contains("mirrorball recover"),
        "{told}"
    );
    let recovered = recover(&path, &whole).expect("recovered");
    assert_eq!(recovered.lost.len(), 1);
    let indices: Vec<u64> = read(&whole).iter().map(|logged| logged.index).collect();
    assert!(
        indices.len() > 200 && indices.last() == Some(&299),
        "{} cycles",
        indices.len()
    );
}

#[test]
fn no_truncation_or_damage_panics() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    record(
        &path,
        3,
        &LogConfig {
            images: ImageMode::None,
            ..LogConfig::default()
        },
    );
    let bytes = std::fs::read(&path).expect("bytes");
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for round in 0..400 {
        let mut broken = bytes.clone();
        if round % 2 == 0 {
            broken.truncate(rng.random_range(0..bytes.len()));
        }
        for _ in 0..round % 5 {
            if !broken.is_empty() {
                let at = rng.random_range(0..broken.len());
                broken[at] = rng.random();
            }
        }
        std::fs::write(&path, &broken).expect("written");
        if let Ok(log) = Log::open(&path) {
            log.for_each(drop);
        }
        let _ = recover(&path, &folder.path().join("b.mcap"));
    }
}

#[test]
fn what_is_no_log_of_this_form_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, "no log at all").expect("written");
    assert!(complaint(&path).ends_with("a.mcap is no MCAP file"));
    assert!(complaint(&folder.path().join("b.mcap")).contains("cannot read"));
    let mut foreign =
        mcap::Writer::new(std::fs::File::create(&path).expect("a file")).expect("a writer");
    foreign.finish().expect("finished");
    assert!(complaint(&path).contains("no log of mirrorball"));
    let mut other =
        mcap::Writer::new(std::fs::File::create(&path).expect("a file")).expect("a writer");
    let values = [("format", "99"), ("version", "7.1.0")]
        .map(|(key, value)| (key.to_owned(), value.to_owned()));
    other
        .write_metadata(&mcap::records::Metadata {
            name: "mirrorball".to_owned(),
            metadata: values.into(),
        })
        .expect("metadata");
    other.finish().expect("finished");
    let told = complaint(&path);
    assert!(
        told.contains("written by mirrorball 7.1.0 in log format 99"),
        "{told}"
    );
}

#[test]
fn an_exported_log_is_a_recording_folder_whole_or_not_at_all() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, out) = (
        folder.path().join("a.mcap"),
        folder.path().join("recording"),
    );
    record(&path, 5, &LogConfig::default());
    let exported = export(Log::open(&path).expect("a log"), &out).expect("exported");
    assert_eq!(
        (exported.frames, exported.odometry, exported.end),
        (5, 15, End::Whole)
    );
    let frames = std::fs::read_to_string(out.join("frames.csv")).expect("frames");
    assert_eq!(frames.lines().nth(2), Some("0.033333333,frames/000001.png"));
    assert_eq!(
        Image::load(&out.join("frames/000004.png")).expect("an image"),
        picture(4)
    );
    let odometry = std::fs::read_to_string(out.join("odometry.csv")).expect("odometry");
    let dx: f32 = odometry
        .lines()
        .nth(4)
        .and_then(|row| row.split(',').nth(1))
        .expect("dx")
        .parse()
        .expect("a number");
    assert_eq!(dx.to_bits(), cycle(1).inputs.odometry[0].dx.to_bits());
    assert!(!out.join("points.csv").exists());
    let refused = export(Log::open(&path).expect("a log"), &out).expect_err("refused");
    assert!(format!("{refused:#}").contains("not an empty folder"));

    record(&path, 200, &LogConfig::default());
    let mut bytes = std::fs::read(&path).expect("bytes");
    let late = bytes.len() * 2 / 3;
    bytes[late] ^= 0xff;
    std::fs::write(&path, &bytes).expect("damaged");
    let other = folder.path().join("other");
    assert!(export(Log::open(&path).expect("a log"), &other).is_err());
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
            images: ImageMode::None,
            ..LogConfig::default()
        },
    );
    assert_eq!(
        export(Log::open(&path).expect("a log"), &out)
            .expect("exported")
            .frames,
        5
    );
    let points = std::fs::read_to_string(out.join("points.csv")).expect("points");
    assert_eq!(points.lines().count(), 1 + 5 * 50);
    assert!(!out.join("frames.csv").exists() && !out.join("frames").exists());
}

#[test]
fn a_full_live_queue_drops_images_before_cycles_and_counts_them() {
    let queue = queue::Queue::new(Pace::Live, 2, 4);
    for number in 0..6 {
        queue.push(queue::Entry::Cycle(number, Arc::new(cycle(number))));
    }
    queue.close();
    let mut found = Vec::new();
    let mut dropped = Dropped::default();
    while let Some((queue::Entry::Cycle(number, cycle), lost)) = queue.pop() {
        found.push((number, cycle.inputs.image.is_some()));
        dropped.images += lost.images;
        dropped.cycles += lost.cycles;
    }
    assert_eq!(found, [(2, false), (3, false), (4, true), (5, true)]);
    assert_eq!((dropped.images, dropped.cycles), (4, 2));
}

#[test]
fn a_lockstep_queue_waits_and_drops_nothing() {
    let queue = queue::Queue::new(Pace::Lockstep, 1, 2);
    let popped = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            std::iter::from_fn(|| queue.pop())
                .map(|(_, lost)| u64::from(lost.none()))
                .sum::<u64>()
        });
        (0..50).for_each(|number| queue.push(queue::Entry::Cycle(number, Arc::new(cycle(number)))));
        queue.close();
        reader.join().expect("joined")
    });
    assert_eq!(popped, 50);
}

#[test]
fn a_disk_that_refuses_is_told_with_its_reason() {
    if !Path::new("/dev/full").exists() {
        return;
    }
    let created = Recorder::create(
        Path::new("/dev/full"),
        &Header::new("test", None),
        &field(),
        Pace::Live,
        &LogConfig::default(),
    );
    let told = format!("{:#}", created.map(|_| ()).expect_err("refused"));
    assert!(
        told.contains("cannot write /dev/full") && told.contains("No space left"),
        "{told}"
    );
}

/// Not a test of its own: the process that the next test kills.
#[test]
#[ignore = "runs until it is killed"]
fn record_until_killed() {
    let Some(path) = std::env::var_os("MIRRORBALL_KILLED_LOG") else {
        return;
    };
    let config = LogConfig {
        flush_period: 0.1,
        ..LogConfig::default()
    };
    let header = Header::new("test", None);
    let mut recorder = Recorder::create(Path::new(&path), &header, &field(), Pace::Live, &config)
        .expect("a recorder");
    // Should nobody kill it, it ends by itself.
    for number in 0..4000 {
        recorder.cycle(Arc::new(cycle(number))).expect("taken");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}

#[test]
fn a_log_whose_writer_is_killed_can_be_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, whole) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let mut child = std::process::Command::new(std::env::current_exe().expect("this program"))
        .args([
            "--exact",
            "log::tests::record_until_killed",
            "--ignored",
            "--nocapture",
        ])
        .env("MIRRORBALL_KILLED_LOG", &path)
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("a process");
    // Some flushes after the header; how long they take is the machine's matter.
    let size = || std::fs::metadata(&path).map_or(0, |file| file.len());
    while size() < 400_000 && child.try_wait().expect("a state").is_none() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    let mut log = Log::open(&path).expect("a log");
    let cycles = log
        .by_ref()
        .map(|logged| logged.expect("a cycle").index)
        .collect::<Vec<_>>();
    assert_eq!(log.end(), Some(End::Cut));
    assert!(
        cycles.len() > 10 && cycles.iter().copied().eq(0..cycles.len() as u64),
        "{}",
        cycles.len()
    );
    let recovered = recover(&path, &whole).expect("recovered");
    assert_eq!(recovered.until, Some(cycle(cycles.len() as u64 - 1).stamp));
    assert_eq!(read(&whole).len(), cycles.len());
}

/// The samples' run through the spine: recorded, and computed again from what the log alone holds.
fn recorded_and_verified(images: ImageMode) -> Verdict {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let setup = Setup::load(&sample_folder().join("robot.toml"), None).expect("a setup");
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new("test", None)
        .with_robot(&setup.robot, map)
        .expect("a header");
    let config = LogConfig {
        images,
        ..LogConfig::default()
    };
    let mut recorder = Recorder::create(&path, &header, &setup.field, Pace::Lockstep, &config)
        .expect("a recorder");
    let mut spine = Spine::new(&setup, &SpineConfig::default()).expect("a spine");
    for sample in Recording::open(&sample_folder(), 0.04).expect("a recording") {
        if let Some(cycle) = spine.take(sample) {
            recorder.cycle(Arc::new(cycle)).expect("taken");
        }
    }
    recorder.finish().expect("written");
    let log = Log::open(&path).expect("a log");
    log.header().write_files(folder.path()).expect("files");
    let setup = Setup::load(&folder.path().join("robot.toml"), None).expect("the log's own setup");
    let mut spine = Spine::new(&setup, &SpineConfig::default()).expect("a spine");
    verify(log, |sample| spine.take(sample)).expect("a verdict")
}

#[test]
fn the_samples_verify_bit_for_bit_vision_included() {
    let verdict = recorded_and_verified(ImageMode::Png);
    assert_eq!(verdict.first, None);
    assert_eq!(
        (verdict.cycles, verdict.seen, verdict.unverified),
        (20, 20, 0)
    );
}

#[test]
fn without_exact_images_localisation_verifies_from_line_points() {
    for images in [ImageMode::Jpeg, ImageMode::None] {
        let verdict = recorded_and_verified(images);
        assert_eq!(verdict.first, None);
        assert_eq!((verdict.cycles, verdict.seen), (20, 0));
    }
}
