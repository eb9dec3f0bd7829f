//! Wrong units are named, and odd but right tables are not.

use std::fmt::Write;
use std::path::Path;

use localize::Field;
use localize::math;
use localize::setup_check::WheelMotion;
use localize::synthetic::drive::{SyntheticDrive, SyntheticDriveConfig};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::latency::OtherLatency;
use super::ranges::{RangeFinding, check_ranges};
use super::{Effort, MeasuredKeyframe, SetupReport, check};
use crate::recording::{Recording, Table};
use crate::setup::Setup;

/// Ten seconds at 20 Hz of a robot that turns at 1 rad/s. Arguments: factor of the images' stamps, factor of the turns,
/// and heading of the compass by time.
fn findings(stamps: f64, turns: f64, heading: impl Fn(f64) -> f64) -> Vec<RangeFinding> {
    let folder = tempfile::tempdir().expect("a folder");
    let mut points = "stamp_s,x_m,y_m\n".to_owned();
    let mut odometry = "stamp_s,dx_m,dy_m,dtheta_rad\n".to_owned();
    let mut compass = "stamp_s,heading_rad\n".to_owned();
    for k in 0..200 {
        let time = f64::from(k) / 20.0;
        writeln!(points, "{:.4},1.0,0.5", (3.0 + time) * stamps).expect("text");
        writeln!(odometry, "{:.4},0.05,0.0,{:.5}", 3.0 + time, 0.05 * turns).expect("text");
        writeln!(compass, "{:.4},{:.5}", 3.0 + time, heading(time)).expect("text");
    }
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text);
    write("points.csv", &points).expect("a file");
    write("odometry.csv", &odometry).expect("a file");
    write("compass.csv", &compass).expect("a file");
    read(folder.path())
}

fn read(folder: &Path) -> Vec<RangeFinding> {
    check_ranges(&Recording::open(folder, 0.04).expect("a recording"))
}

fn wrapped(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    (angle + turn / 2.0).rem_euclid(turn) - turn / 2.0
}

#[test]
fn right_tables_and_a_continuous_heading_have_no_finding() {
    assert_eq!(findings(1.0, 1.0, wrapped), []);
    assert_eq!(findings(1.0, 1.0, |time| 2.0 + time), []);
}

#[test]
fn headings_and_turns_in_degrees_are_named() {
    let headings = findings(1.0, 1.0, |time| wrapped(time).to_degrees());
    assert_eq!(headings.len(), 1, "{headings:?}");
    assert_eq!(headings[0].table, Table::Compass);
    let turns = findings(1.0, 57.295_78, wrapped);
    assert_eq!(turns.len(), 1, "{turns:?}");
    assert_eq!(turns[0].table, Table::Odometry);
    assert!(turns[0].found.contains("57 rad/s"), "{turns:?}");
}

#[test]
fn stamps_of_another_unit_or_clock_are_named() {
    let milliseconds = findings(1e3, 1.0, wrapped);
    assert_eq!(milliseconds.len(), 1, "{milliseconds:?}");
    assert!(
        milliseconds[0]
            .change
            .contains("points.csv: convert stamp_s from milliseconds"),
        "{milliseconds:?}"
    );
    assert!(milliseconds[0].fit[0] < 0.1 && milliseconds[0].fit[1] > 0.9);
}

#[test]
fn recording_whose_odometry_ends_early_has_no_finding() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows = |count: i32, text: &str| -> String {
        (0..count).fold(String::new(), |all, k| {
            format!("{all}{:.2},{text}\n", f64::from(k) / 10.0)
        })
    };
    let points = format!("stamp_s,x_m,y_m\n{}", rows(600, "1.0,0.5"));
    let header = "stamp_s,dx_m,dy_m,dtheta_rad\n";
    // One row of a counter that overflowed is no wrong unit either.
    let odometry = format!("{header}{}20.0,0.1,0.0,31.0\n", rows(200, "0.1,0.0,0.01"));
    std::fs::write(folder.path().join("points.csv"), points).expect("a file");
    std::fs::write(folder.path().join("odometry.csv"), odometry).expect("a file");
    assert_eq!(read(folder.path()), []);
}

#[test]
fn odometry_of_positions_is_named_and_that_of_another_unit_is_not() {
    let found = |row: &dyn Fn(f64) -> [f64; 2]| {
        let folder = tempfile::tempdir().expect("a folder");
        let rows = (0..800).fold("stamp_s,dx_m,dy_m,dtheta_rad\n".to_owned(), |all, k| {
            let time = 0.01 * f64::from(k);
            let [x, y] = row(time);
            format!("{all}{time:.2},{x},{y},0.01\n")
        });
        std::fs::write(folder.path().join("odometry.csv"), rows).expect("written");
        let points = (0..80).fold("stamp_s,x_m,y_m\n".to_owned(), |all, k| {
            format!("{all}{:.1},1.0,0.0\n", 0.1 * f64::from(k))
        });
        std::fs::write(folder.path().join("points.csv"), points).expect("written");
        check_ranges(&Recording::open(folder.path(), 0.04).expect("a recording"))
    };
    // A drive of 1.5 m/s.
    let velocity =
        |time: f64| [math::cos(0.7 * time), math::sin(0.7 * time)].map(|part| 1.5 * part);
    let position =
        |time: f64| [math::sin(0.7 * time), 1.0 - math::cos(0.7 * time)].map(|part| 2.1 * part);
    let positions = found(&position);
    assert_eq!(positions.len(), 1, "{positions:?}");
    assert!(positions[0].found.contains("positions"), "{positions:?}");
    assert_eq!(found(&|time| velocity(time).map(|v| 0.01 * v)), []);
    let noise = |time: f64| 1.0 + 0.2 * math::sin(1000.0 * time);
    assert_eq!(
        found(&|time| velocity(time).map(|v| 10.0 * v * noise(time))),
        []
    );
}

/// The report of a drive whose wheels measure `wheels` of each motion (metres, metres, radians).
fn report_of_drive(wheels: impl Fn([f32; 3]) -> [f32; 3]) -> SetupReport {
    let path = crate::paths::find_resource("config/fields/msl_12x8.toml").expect("a file");
    let field = Field::load(&path).expect("a field");
    let random = ChaCha8Rng::seed_from_u64(7);
    let drive = SyntheticDrive::new(&field, SyntheticDriveConfig::default(), random);
    let mut measured: Vec<MeasuredKeyframe> = Vec::new();
    let mut rows = Vec::new();
    for sample in drive {
        let odometry = sample.odometry;
        rows.push([odometry.dx, odometry.dy, odometry.dtheta]);
        let motion = WheelMotion::from_increments(&rows);
        if !measured.is_empty() && motion.path + 0.5 * motion.turned < 1.0 {
            continue;
        }
        let rows = std::mem::take(&mut rows).into_iter().map(&wheels);
        measured.push(MeasuredKeyframe {
            stamp: sample.stamp,
            points: sample.points,
            odometry: (!measured.is_empty()).then(|| rows.collect()),
            ..MeasuredKeyframe::default()
        });
        if measured.len() == 40 {
            break;
        }
    }
    let setup = Setup::without_camera(field);
    check(&setup, &Default::default(), &measured, Effort::Brief)
}

#[test]
fn wheels_that_turn_about_another_point_are_not_taken_for_wrong_radii() {
    let report = report_of_drive(|[dx, dy, turn]| [dx - 0.4 * turn, dy + 0.5 * turn, turn]);
    assert_eq!(report.suggestions, [], "{:?}", report.warnings);
    assert!(report.warnings[0].contains("turn about"), "{report:?}");
    let covariance = report.added_pose_covariance.expect("doubtful poses");
    let std = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
    assert!((std - math::hypot(0.4, 0.5)).abs() < 0.1, "{std} m");
    let report = report_of_drive(|[dx, dy, turn]| [1.15 * dx, dy, turn]);
    assert!(
        report.suggestions[0].change.contains("matrix"),
        "{report:?}"
    );
    assert_eq!(report.added_pose_covariance, None);
}

#[test]
fn latency_that_is_set_too_high_is_named_before_the_stamps_of_the_wheels() {
    let doubt = |age: f32, configured: f32| {
        let mut report = SetupReport::default();
        let wheels = nalgebra::Matrix3::identity();
        report.doubt_latency(&OtherLatency::new(age, configured, &[], &wheels));
        report.warnings.remove(0)
    };
    let text = doubt(-0.004, 0.1);
    let [latency, stamps] =
        ["camera_latency = 0.000", "odometry.csv are late"].map(|part| text.find(part));
    assert!(latency.is_some() && latency < stamps, "{text}");
    // No latency explains images from the future.
    for configured in [0.0, 0.05] {
        let text = doubt(-0.1, configured);
        assert!(!text.contains("camera_latency"), "{text}");
        assert!(text.contains("odometry.csv: subtract"), "{text}");
    }
}
