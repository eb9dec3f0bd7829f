use super::*;
use crate::field::FieldConfig;
use crate::frames::At;
use crate::matching::distance_field::DistanceFieldConfig;
use crate::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;

const WEIGHTS: PointWeights = PointWeights {
    kernel_scale_sigmas: 3.0,
    map_std: 0.015,
    likelihood_exponent: 0.3,
    deciding_log_odds: 2.94,
};

/// One long line along x, crossed by a short one at x = 3 alone.
fn line_with_one_crossing() -> Field {
    let config: FieldConfig = toml::from_str(
        "length = 16.0\nwidth = 6.0\nline_width = 0.1\nborder = 1.0\nboundary = false\nhalfway_line = false\n\
         extra_lines = [[-8.0, 0.0, 8.0, 0.0], [3.0, -1.5, 3.0, 1.5]]",
    )
    .expect("a field");
    Field::new(config).expect("a field")
}

struct Scene {
    field: Field,
    distances: DistanceField,
    drive: SyntheticDriveConfig,
    advisor: Advisor,
}

impl Scene {
    fn new(field: Field, range: f32) -> Self {
        let config = AdviceConfig {
            view_range: range,
            ..AdviceConfig::default()
        };
        Scene {
            distances: DistanceField::new(&field, &DistanceFieldConfig::default()),
            drive: SyntheticDriveConfig {
                range_max: range,
                outlier_share: 0.0,
                ..SyntheticDriveConfig::default()
            },
            advisor: Advisor::new(&field, config),
            field,
        }
    }

    fn points(&self, pose: Pose) -> Vec<LinePoint> {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        simulate_line_points(&self.field, &self.drive, pose, &mut rng)
    }

    fn advise(&self, points: &[LinePoint], poses: [Pose; 2]) -> Option<MotionAdvice> {
        let checked = poses.map(|pose| {
            let mut checked = CheckedMarkings::default();
            self.advisor.mark_checked(&mut checked, pose, points);
            checked
        });
        self.advise_considering(points, poses, [&checked[0], &checked[1]])
    }

    fn advise_considering(
        &self,
        points: &[LinePoint],
        poses: [Pose; 2],
        checked: [&CheckedMarkings; 2],
    ) -> Option<MotionAdvice> {
        let hypotheses = [0, 1].map(|k| Considered {
            pose: poses[k],
            checked: checked[k],
        });
        self.advisor
            .advise(&self.distances, points, hypotheses, &WEIGHTS, None)
    }
}

#[test]
fn the_advice_leads_to_the_marking_that_only_one_hypothesis_predicts() {
    let scene = Scene::new(line_with_one_crossing(), 2.5);
    // Both look along x and see the line alone. The crossing is 3.2 m ahead of the first.
    let poses = [Pose::new(-0.2, 0.3, 0.0), Pose::new(-4.5, 0.3, 0.0)];
    let advice = scene
        .advise(&scene.points(poses[0]), poses)
        .expect("a motion");
    let [x, y, turn] = advice.motion;
    assert!(
        (0.75..=2.0).contains(&x) && y.abs() < 0.9 && turn == 0.0,
        "{advice:?}"
    );
    // The hypotheses swapped: either may be true.
    let swapped = scene.advise(&scene.points(poses[0]), [poses[1], poses[0]]);
    assert_eq!(swapped.map(|advice| advice.motion), Some(advice.motion));
}

#[test]
fn the_advice_is_given_in_the_robot_frame() {
    let scene = Scene::new(line_with_one_crossing(), 2.5);
    let quarter = std::f32::consts::FRAC_PI_2;
    // Turned to the left, the crossing is to the right.
    let poses = [Pose::new(-0.2, 0.3, quarter), Pose::new(-4.5, 0.3, quarter)];
    let advice = scene
        .advise(&scene.points(poses[0]), poses)
        .expect("a motion");
    assert!(
        advice.motion[1] < -0.7 && advice.motion[0].abs() < 0.9,
        "{advice:?}"
    );
}

#[test]
fn markings_that_were_in_view_without_a_decision_are_not_visited_again() {
    let scene = Scene::new(line_with_one_crossing(), 2.5);
    let poses = [Pose::new(-0.2, 0.3, 0.0), Pose::new(-4.5, 0.3, 0.0)];
    let points = scene.points(poses[0]);
    let mut checked = CheckedMarkings::default();
    for x in [-0.2, 1.5, 3.0, 4.5] {
        scene
            .advisor
            .mark_checked(&mut checked, Pose::new(x, 0.3, 0.0), &points);
    }
    let first = scene.advise(&points, poses).expect("a motion");
    let again = scene.advise_considering(&points, poses, [&checked, &CheckedMarkings::default()]);
    assert!(
        again.is_none_or(|again| again.motion != first.motion),
        "{again:?}"
    );
}

#[test]
fn no_motion_tells_a_pose_from_its_half_turn_on_a_symmetric_field() {
    let field = crate::field::tests::league_18x12("centres");
    let scene = Scene::new(field, 5.0);
    let pose = Pose::new(2.0, 1.0, 0.4);
    let twin = crate::global_search::branch_and_bound::half_turn(pose);
    assert_eq!(scene.advise(&scene.points(pose), [pose, twin]), None);
}

#[test]
fn the_advice_keeps_the_robot_on_the_carpet_under_both_hypotheses() {
    let scene = Scene::new(line_with_one_crossing(), 2.5);
    // The crossing ahead is out of reach for the second hypothesis, which stands before the carpet's end.
    let poses = [Pose::new(-0.2, 0.3, 0.0), Pose::new(8.2, 0.3, 0.0)];
    if let Some(advice) = scene.advise(&scene.points(poses[0]), poses) {
        for pose in poses {
            let [x, y, _] = advice.motion;
            let at = pose * At::new(x, y);
            assert!(at.x.abs() <= 8.7 && at.y.abs() <= 3.7, "{advice:?}");
        }
    }
}

#[test]
fn a_motion_that_goes_on_is_preferred_to_one_that_turns_back() {
    let mut config = line_with_one_crossing().config;
    // Crossings 2.9 m ahead of the first hypothesis and 2.8 m behind it; the second has none.
    config.extra_lines[1] = [3.0, -1.0, 3.0, 1.0];
    config.extra_lines.push([-2.7, -1.0, -2.7, 1.0]);
    config.extra_lines[0] = [-16.0, 0.0, 8.0, 0.0];
    config.length = 32.0;
    let scene = Scene::new(Field::new(config).expect("a field"), 2.5);
    let poses = [Pose::new(0.1, 0.3, 0.0), Pose::new(-9.0, 0.3, 0.0)];
    let points = scene.points(poses[0]);
    let nothing = CheckedMarkings::default();
    let hypotheses = poses.map(|pose| Considered {
        pose,
        checked: &nothing,
    });
    for direction in [0.0, std::f32::consts::PI] {
        let advice = scene.advisor.advise(
            &scene.distances,
            &points,
            hypotheses,
            &WEIGHTS,
            Some(direction),
        );
        let [x, ..] = advice.expect("a motion").motion;
        assert!(x * direction.cos() > 0.0, "{direction}: {x}");
    }
}

#[test]
fn advice_reads_as_a_sentence() {
    let text = |motion| {
        Advice::Move(MotionAdvice {
            motion,
            expected_log_odds: 3.0,
        })
        .text()
    };
    assert_eq!(text([1.0, 0.0, 0.0]), "drive 1.00 m along x");
    assert_eq!(text([0.0, -0.5, 0.0]), "drive 0.50 m along −y");
    assert_eq!(text([0.0, 0.0, std::f32::consts::FRAC_PI_6]), "turn by 30°");
}
