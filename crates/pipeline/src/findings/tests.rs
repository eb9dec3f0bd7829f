//! Runs with one known fault each, and what is found in them.

use localize::estimate::{Estimate, Mode, Reason};
use localize::frames::Pose;
use localize::robot::ExposureSetting;
use localize::sample::Odometry;
use localize::{Stamp, math};
use nalgebra::Matrix3;
use vision::exposure::ExposureStatus;

use super::wheel_path::WheelPath;
use super::{Finding, FindingKind, RunHistory};
use crate::cycle::{Cycle, Inputs};
use crate::sample::GroundTruth;

const RATE: f64 = 30.0;
/// Metres per cycle along x.
const STEP: f32 = 0.02;
const STD: f32 = 0.01;

/// A run of `count` cycles along x, tracked and right; `change` spoils single cycles.
fn run(count: u64, change: impl Fn(u64, &mut Cycle)) -> RunHistory {
    let mut history = RunHistory::default();
    for index in 0..count {
        let mut cycle = cycle(index);
        change(index, &mut cycle);
        history.push(index, &cycle);
    }
    history
}

fn cycle(index: u64) -> Cycle {
    let stamp = Stamp::from_seconds(index as f64 / RATE);
    let pose = Pose::new(STEP * index as f32, 0.0, 0.0);
    let inputs = Inputs {
        odometry: vec![Odometry {
            stamp,
            dx: STEP,
            dy: 0.0,
            dtheta: 0.0,
            slip: 0.0,
        }],
        truth: Some(GroundTruth {
            stamp,
            pose,
            ball: None,
            ball_height: 0.0,
            robots: Vec::new(),
            robot_headings: Vec::new(),
            people: Vec::new(),
        }),
        ..Inputs::default()
    };
    let covariance = Matrix3::from_diagonal_element(STD * STD);
    let mut cycle = Cycle::from_inputs(stamp, inputs, covariance);
    cycle.estimate = Estimate::tracked(stamp, pose, covariance);
    cycle.estimate.inlier_share = 0.9 + 0.01 * (index % 5) as f32;
    cycle
}

fn kinds(found: &[Finding]) -> Vec<FindingKind> {
    found.iter().map(|finding| finding.kind).collect()
}

fn shift(cycle: &mut Cycle, by: f32) {
    if let Some(pose) = &mut cycle.estimate.pose {
        pose.x += by;
    }
}

#[test]
fn a_clean_run_has_no_finding() {
    assert_eq!(run(90, |_, _| {}).findings(), []);
    assert_eq!(RunHistory::default().findings(), []);
}

#[test]
fn an_error_is_found_with_its_leap_and_its_cause() {
    let found = run(90, |index, cycle| {
        if (30..36).contains(&index) {
            shift(cycle, if index == 33 { 0.6 } else { 0.5 });
            cycle.estimate.inlier_share = 0.2;
        }
    })
    .findings();
    assert_eq!(kinds(&found), [FindingKind::Error, FindingKind::Leap]);
    let error = &found[0];
    assert!((error.start - 1.0).abs() < 1e-6 && (error.stop - 36.0 / RATE).abs() < 1e-6);
    assert!((error.worst - 33.0 / RATE).abs() < 1e-6 && (error.size - 0.6).abs() < 1e-4);
    assert_eq!(
        error.causes,
        ["points off the markings (20% on them, usually 92%)"]
    );
    assert_eq!(
        error.sentence(),
        "60 cm wrong at 1.10 s: points off the markings (20% on them, usually 92%)"
    );
}

#[test]
fn the_same_error_is_overconfident_or_none_by_the_stated_uncertainty() {
    for (std, expected) in [(0.01_f32, vec![FindingKind::Overconfident]), (0.1, vec![])] {
        let found = run(60, |_, cycle| {
            cycle.estimate.covariance = Matrix3::from_diagonal_element(std * std);
            shift(cycle, 0.08);
        })
        .findings();
        assert_eq!(kinds(&found), expected, "{std}");
    }
}

#[test]
fn a_lost_robot_names_its_reason_and_a_pause_below_a_second_is_one_moment() {
    let found = run(90, |index, cycle| {
        if (30..50).contains(&index) && index != 40 {
            cycle.estimate = Estimate::lost(cycle.stamp, Matrix3::identity());
            cycle.estimate.reason = Some(Reason::FewPoints);
            cycle.estimate.half_known = true;
        }
    })
    .findings();
    assert_eq!(kinds(&found), [FindingKind::Lost]);
    // A lost robot has no points on markings, so that cause comes with it.
    assert!(found[0].causes.contains(&"few points".to_owned()));
    assert!((found[0].stop - found[0].start - 20.0 / RATE).abs() < 1e-6);
}

#[test]
fn wheels_that_slip_are_a_note_and_an_uncertain_pose_a_warning() {
    let found = run(60, |index, cycle| {
        cycle.estimate.collision = (20..25).contains(&index);
        if index >= 50 {
            cycle.estimate.covariance = Matrix3::from_diagonal_element(0.04);
            cycle.estimate.mode = Mode::Global;
        }
    })
    .findings();
    assert_eq!(kinds(&found), [FindingKind::Slip, FindingKind::Uncertain]);
    assert!((found[1].size - 0.08_f64.sqrt()).abs() < 1e-6);
}

#[test]
fn light_is_compared_by_exposure_and_gain() {
    let lit = |exposure_of: fn(u64) -> f32, level_of: fn(u64) -> f32| {
        let found = run(150, |index, cycle| {
            cycle.exposure = Some(ExposureStatus {
                entropy: 10.0,
                centre_brightness: level_of(index),
                applied_setting: Some(ExposureSetting {
                    exposure: exposure_of(index),
                    gain: 1.0,
                }),
                searching: false,
                command: None,
                setting_changed_brightness: false,
                uncontrolled_light_change: false,
            });
        })
        .findings();
        kinds(&found)
    };
    let dark = |index| if index < 75 { 120.0 } else { 60.0 };
    assert_eq!(lit(|_| 1.0, dark), [FindingKind::Light]);
    // The camera itself made the image darker: 0.5 to the power of 2.2.
    let shorter = |index| if index < 75 { 1.0 } else { 0.2176 };
    assert_eq!(lit(shorter, dark), []);
}

#[test]
fn missing_cycles_are_told_from_gaps_and_unusable_images() {
    let mut history = RunHistory::default();
    for index in (0..60).filter(|index| !(20..25).contains(index)) {
        let mut cycle = cycle(index);
        let late = if index >= 40 { 0.5 } else { 0.0 };
        cycle.stamp = Stamp::from_seconds(cycle.stamp.seconds() + late);
        cycle.image_fault = (index == 30).then(|| "torn".to_owned());
        history.push(index, &cycle);
    }
    let found = history.findings();
    let rest: Vec<&Finding> = found
        .iter()
        .filter(|finding| finding.kind != FindingKind::Leap)
        .collect();
    let kinds: Vec<FindingKind> = rest.iter().map(|finding| finding.kind).collect();
    assert_eq!(
        kinds,
        [
            FindingKind::Dropped,
            FindingKind::Unusable,
            FindingKind::Gap
        ]
    );
    assert_eq!(rest[1].causes, ["torn"]);
    assert!((rest[2].size - 0.5 - 1.0 / RATE).abs() < 1e-6);
}

#[test]
fn motion_by_the_wheels_is_summed_between_images() {
    let mut wheels = WheelPath::default();
    for step in 0..100 {
        wheels.push(&Odometry {
            stamp: Stamp::from_seconds(f64::from(step) / 100.0),
            dx: 0.05,
            dy: 0.0,
            dtheta: 0.02,
            slip: 0.0,
        });
    }
    // Ten arcs of 5 cm that turn by 0.02 rad each.
    let (mut x, mut y) = (0.0, 0.0);
    for step in 0..10 {
        let (sin, cos) = math::sin_cos(0.02 * f64::from(step));
        (x, y) = (x + 0.05 * cos, y + 0.05 * sin);
    }
    let [ahead, aside] = wheels.motion(0.2, 0.3);
    assert!(
        (ahead - x).abs() < 2e-3 && (aside - y).abs() < 2e-3,
        "{ahead} {aside}"
    );
    wheels.forget_before(0.15);
    let [later, _] = wheels.motion(0.2, 0.3);
    assert_eq!(later, ahead);
}

#[test]
fn an_earlier_stamp_begins_a_new_run_and_old_cycles_can_be_forgotten() {
    let mut history = run(60, |_, _| {});
    history.forget_before(1.0);
    assert_eq!(
        (history.len(), history.span().map(|span| span.0)),
        (30, Some(1.0))
    );
    history.push(0, &cycle(0));
    assert_eq!(history.len(), 1);
}
