//! Mistakes are found, and hard halls are no mistakes.

use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;

use super::chain::{SelectedHypothesis, select_chain};
use super::led_by_wheels::select_led_chain;
use super::{Explanation, FieldTables, Keyframe, KeyframeFit, WheelMotion, compare, explain};
use crate::config::LocalizeConfig;
use crate::field::Field;
use crate::field::tests::league_18x12;
use crate::frames::{At, Pose, Tf};
use crate::sample::LinePoint;
use crate::synthetic::drive::{SyntheticDrive, SyntheticDriveConfig};

/// Keyframes of a drive, a metre of motion apart.
fn keyframes(
    field: &Field,
    config: SyntheticDriveConfig,
    seed: u64,
    count: usize,
) -> Vec<Keyframe> {
    let drive = SyntheticDrive::new(field, config, Xoshiro256PlusPlus::seed_from_u64(seed));
    let mut keyframes: Vec<Keyframe> = Vec::new();
    let mut rows = Vec::new();
    for sample in drive.take(1800) {
        rows.push([
            sample.odometry.dx,
            sample.odometry.dy,
            sample.odometry.dtheta,
        ]);
        let motion = WheelMotion::from_increments(&rows);
        if !keyframes.is_empty() && motion.path + 0.5 * motion.turned < 1.0 {
            continue;
        }
        keyframes.push(Keyframe {
            stamp: sample.stamp,
            points: sample.points,
            motion: (!keyframes.is_empty()).then_some(motion),
            compass: Some(sample.compass.heading),
        });
        rows.clear();
        if keyframes.len() == count {
            break;
        }
    }
    keyframes
}

fn explain_on(field: &Field, keyframes: &[Keyframe]) -> Explanation {
    let mut tables = FieldTables::new(field, &LocalizeConfig::default());
    explain(&mut tables, keyframes)
}

fn resized(length: f32, width: f32) -> Field {
    let mut config = league_18x12("centres").config;
    (config.length, config.width) = (length, width);
    Field::new(config).expect("a field")
}

/// The line points of a camera that is turned by quarters and perhaps mirrored.
fn turned(keyframes: &[Keyframe], quarters: u8, mirrored: bool) -> Vec<Keyframe> {
    let turn = |point: &LinePoint| {
        let (mut x, mut y) = (point.at.x, point.at.y);
        for _ in 0..quarters {
            (x, y) = (-y, x);
        }
        LinePoint {
            at: At::new(x, if mirrored { -y } else { y }),
            ..*point
        }
    };
    keyframes
        .iter()
        .map(|keyframe| Keyframe {
            points: keyframe.points.iter().map(turn).collect(),
            ..keyframe.clone()
        })
        .collect()
}

#[test]
fn true_width_beats_a_field_three_metres_too_narrow_and_not_the_reverse() {
    // Half of the points being false, fourteen keyframes do not suffice on every drive: a recording has up to 40.
    for (seed, outlier_share, count) in [(1, 0.1, 14), (2, 0.5, 40)] {
        let config = SyntheticDriveConfig {
            outlier_share,
            ..SyntheticDriveConfig::default()
        };
        let right = league_18x12("centres");
        let keyframes = keyframes(&right, config, seed, count);
        let wrong = explain_on(&resized(18.0, 9.0), &keyframes);
        let right = explain_on(&right, &keyframes);
        let found = compare(&wrong, &right);
        assert!(found.is_better(), "seed {seed}: {found:?}");
        assert!(!compare(&right, &wrong).is_better(), "seed {seed}");
    }
}

#[test]
fn no_other_size_beats_the_right_field_in_a_hard_hall() {
    let config = SyntheticDriveConfig {
        outlier_share: 0.5,
        occluded_share: 0.4,
        range_max: 3.5,
        ..SyntheticDriveConfig::default()
    };
    let right = league_18x12("centres");
    let keyframes = keyframes(&right, config, 3, 14);
    let explained = explain_on(&right, &keyframes);
    for (length, width) in [(18.0, 9.0), (12.0, 12.0), (18.5, 12.0), (18.0, 13.0)] {
        let other = explain_on(&resized(length, width), &keyframes);
        let comparison = compare(&explained, &other);
        assert!(
            !comparison.is_better(),
            "{length} × {width}: {comparison:?}"
        );
    }
}

#[test]
fn wheels_and_compass_tell_a_turned_or_mirrored_camera() {
    let field = league_18x12("centres");
    let keyframes = keyframes(&field, SyntheticDriveConfig::default(), 4, 14);
    let right = explain_on(&field, &keyframes);
    assert!(right.fit() > 0.8, "{}", right.fit());
    for (quarters, mirrored) in [(1, false), (3, false), (0, true), (2, true)] {
        let wrong = explain_on(&field, &turned(&keyframes, quarters, mirrored));
        // The points alone fit as well: the field is symmetric.
        assert!((wrong.on_markings() - right.on_markings()).abs() < 0.05);
        assert!(compare(&wrong, &right).is_better(), "{quarters} {mirrored}");
        assert!(wrong.fit() < 0.5, "{quarters} {mirrored}: {}", wrong.fit());
    }
}

#[test]
fn recording_without_wheels_and_compass_is_judged_by_its_points_alone() {
    let field = league_18x12("centres");
    let mut keyframes = keyframes(&field, SyntheticDriveConfig::default(), 5, 14);
    for keyframe in &mut keyframes {
        (keyframe.motion, keyframe.compass) = (None, None);
    }
    let right = explain_on(&field, &keyframes);
    assert_eq!((right.wheels_agree(), right.compass_agrees()), (None, None));
    let mirrored = explain_on(&field, &turned(&keyframes, 0, true));
    assert!(!compare(&right, &mirrored).is_better());
    assert!(!compare(&mirrored, &right).is_better());
}

/// A robot that turns by 0.5 rad from keyframe to keyframe and is pushed by 0.4 m in one of them.
fn pushed_while_turning(turn_by_wheels: f32) -> Explanation {
    let keyframe = |k: usize| KeyframeFit {
        pose: Some(Pose::new(
            if k < 10 { 0.0 } else { 0.4 },
            0.0,
            0.5 * k as f32,
        )),
        cost: 0.0,
        points: 100,
        on_markings: 1.0,
        residual: 0.0,
        wheel_step: (k > 0).then(|| Tf::new(0.0, 0.0, turn_by_wheels)),
        by_matrix: None,
        wheels_agree: (k > 0).then_some(k != 10),
        compass_agrees: None,
    };
    Explanation {
        keyframes: (0..30).map(keyframe).collect(),
    }
}

#[test]
fn wheels_of_a_turning_robot_agree_although_it_was_pushed() {
    let agree = |turn| pushed_while_turning(turn).wheels_agree();
    assert!(
        agree(0.5).is_some_and(|share| share > 0.9),
        "{:?}",
        agree(0.5)
    );
    assert!(
        agree(-0.5).is_some_and(|share| share < 0.1),
        "{:?}",
        agree(-0.5)
    );
    assert!(
        agree(0.1).is_some_and(|share| share < 0.5),
        "{:?}",
        agree(0.1)
    );
}

#[test]
fn images_that_show_few_lines_are_placed_where_the_wheels_lead() {
    let field = league_18x12("centres");
    let mut keyframes = keyframes(&field, SyntheticDriveConfig::default(), 6, 24);
    for keyframe in keyframes.iter_mut().skip(3).step_by(4) {
        // Points of one line: they lie anywhere along every line of the field.
        let of_distance = |point: &LinePoint| point.at.distance();
        keyframe
            .points
            .sort_by(|a, b| of_distance(a).total_cmp(&of_distance(b)));
        keyframe.points.truncate(8);
    }
    let mut config = LocalizeConfig::default();
    config.branch_and_bound.hypotheses_max = 2;
    let mut tables = FieldTables::new(&field, &config);
    let mut hypotheses: Vec<_> = keyframes
        .iter()
        .map(|keyframe| tables.hypotheses(keyframe))
        .collect();
    let contradictions = |links: &[SelectedHypothesis]| {
        let agree = links.iter().map(SelectedHypothesis::wheels_agree);
        agree.filter(|agree| *agree == Some(false)).count()
    };
    let alone = contradictions(&select_chain(&keyframes, &hypotheses));
    let led = contradictions(&select_led_chain(&mut tables, &keyframes, &mut hypotheses));
    assert!(alone >= 4 && led <= alone / 4, "{led} of {alone} are left");
}
