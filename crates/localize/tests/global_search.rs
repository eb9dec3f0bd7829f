//! Each method of global localization locates the robot on the field of its paper.

use localize::frames::wrap_angle;
use localize::global_search::branch_and_bound::{BranchAndBound, HeadingPrior, half_turn};
use localize::global_search::hough::confirm_by_goal_colours;
use localize::global_search::scan_map::{ScanMap, ScanMapConfig};
use localize::global_search::{GlobalSearch, GlobalSearchConfig, GlobalSearchMethod, SearchInput};
use localize::matching::Matcher;
use localize::presets::PRESETS;
use localize::random::standard_normal;
use localize::sample::GoalObservation;
use localize::synthetic::drive::{
    SyntheticDrive, SyntheticDriveConfig, random_pose, simulate_line_points,
};
use localize::{At, DistanceField, Field, FieldFrame, LocalizeConfig, Localizer, Pose, Stamp};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn field(name: &str) -> Field {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
    Field::load(&folder.join(name)).expect("a field")
}

fn near(a: Pose, b: Pose) -> bool {
    a.origin().distance_to(b.origin()) < 0.15 && wrap_angle(a.theta - b.theta).abs() < 0.05
}

/// Number of `count` random poses that are the first hypothesis; without a compass modulo the half turn.
fn count_located(method: GlobalSearchMethod, field: &Field, compass: bool, count: usize) -> usize {
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(field, &config.distance_field);
    let mut search = BranchAndBound::new(field, &distances, config.branch_and_bound.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let search_config = GlobalSearchConfig {
        method,
        ..GlobalSearchConfig::default()
    };
    let mut global_search = GlobalSearch::new(field, &distances, &search_config);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut right = 0;
    for _ in 0..count {
        let truth = random_pose(field, &mut rng);
        let points = simulate_line_points(field, &SyntheticDriveConfig::default(), truth, &mut rng);
        let std = 10.0_f32.to_radians();
        let heading = truth.theta + std * standard_normal(&mut rng);
        global_search.reset();
        let input = SearchInput {
            distances: &distances,
            points: &points,
            heading_prior: compass.then_some(HeadingPrior { heading, std }),
            goals: &[],
            single_image: true,
        };
        let hypotheses = global_search
            .find_hypotheses(&mut search, &mut matcher, &input)
            .hypotheses;
        right += usize::from(hypotheses.first().is_some_and(|best| {
            near(best.pose, truth) || !compass && near(half_turn(best.pose), truth)
        }));
    }
    right
}

#[test]
fn branch_and_bound_locates_without_a_compass() {
    let field = field("msl_18x12.toml");
    assert!(count_located(GlobalSearchMethod::Exact, &field, false, 200) >= 197);
    assert!(count_located(GlobalSearchMethod::Exact, &field, true, 200) >= 199);
}

#[test]
fn hough_locates_on_the_2001_field() {
    let field = field("msl_2001.toml");
    assert!(count_located(GlobalSearchMethod::Hough, &field, true, 90) >= 86);
}

#[test]
fn scan_map_locates_on_the_18x12_field() {
    let field = field("msl_18x12.toml");
    assert!(count_located(GlobalSearchMethod::ScanMap, &field, true, 50) >= 48);
}

#[test]
fn monte_carlo_locates_80_percent_from_one_image() {
    let field = field("msl_18x12.toml");
    assert!(count_located(GlobalSearchMethod::MonteCarlo, &field, true, 60) >= 48);
}

#[test]
fn branch_and_bound_matches_exhaustive_search() {
    // On a small field no pose of a fine grid may score higher than the result.
    let field = field("msl_2001.toml");
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(&field, &config.distance_field);
    let mut search = BranchAndBound::new(&field, &distances, config.branch_and_bound.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let sparse = SyntheticDriveConfig {
        rays: 24,
        outlier_share: 0.3,
        ..SyntheticDriveConfig::default()
    };
    for _ in 0..2 {
        let truth = random_pose(&field, &mut rng);
        let points = simulate_line_points(&field, &sparse, truth, &mut rng);
        let kernel_scale = config.branch_and_bound.kernel_scale;
        let score = |pose: Pose| -> f32 {
            points
                .iter()
                .map(|point| {
                    let at = pose * point.at;
                    let d = distances.nearest(at.x, at.y).signed_distance;
                    kernel_scale * kernel_scale / (kernel_scale * kernel_scale + d * d)
                })
                .sum()
        };
        let hypotheses = search.find_hypotheses(&distances, &mut matcher, &points, None);
        let best = hypotheses
            .iter()
            .map(|hypothesis| score(hypothesis.pose))
            .fold(0.0, f32::max);
        for k in 0..60 * 32 * 90 {
            let (i, j, turn) = (k % 60, k / 60 % 32, k / 1920);
            let pose = Pose::new(
                -4.5 + 0.15 * i as f32,
                -2.25 + 0.15 * j as f32,
                (turn as f32 * 2.0).to_radians(),
            );
            // Rounding to cells and score steps is a few per cent.
            assert!(
                score(pose) < 1.06 * best + 0.5,
                "{pose:?} scores higher than the result"
            );
        }
    }
}

#[test]
fn stored_scan_map_is_rejected_for_another_field_or_config() {
    let (small, other) = (field("msl_2001.toml"), field("msl_12x8.toml"));
    let distances = DistanceField::new(&small, &LocalizeConfig::default().distance_field);
    let config = ScanMapConfig {
        cell: 0.5,
        ..ScanMapConfig::default()
    };
    let map = ScanMap::new(&small, &distances, config.clone());
    let mut bytes = map.to_bytes(&small);
    assert_eq!(ScanMap::from_bytes(&bytes, &small, &config), Some(map));
    assert_eq!(ScanMap::from_bytes(&bytes, &other, &config), None);
    let turned = ScanMapConfig {
        spiral_turn_deg: 90.0,
        ..config.clone()
    };
    assert_eq!(ScanMap::from_bytes(&bytes, &small, &turned), None);
    let last = bytes.len() - 1;
    assert_eq!(ScanMap::from_bytes(&bytes[..last], &small, &config), None);
    bytes[last] ^= 1;
    assert_eq!(ScanMap::from_bytes(&bytes, &small, &config), None);
}

/// Goal detections on the 2001 field at `truth`: the middle of each goal's base at the back of its box.
fn goal_observations(field: &Field, truth: Pose) -> Vec<GoalObservation> {
    let [ahead, behind] = field.config.goal.colours;
    let back = field.length / 2.0 + 0.5 * field.config.goal.depth;
    [(ahead, back), (behind, -back)]
        .into_iter()
        .map(|(colour, x)| {
            let at = truth.inverse() * At::<FieldFrame>::new(x, 0.1);
            GoalObservation {
                colour,
                at,
                std: 0.05 + 0.05 * at.distance(),
                width: 1.7,
            }
        })
        .collect()
}

#[test]
fn goal_colours_resolve_the_half_turn_and_reject_wrong_poses() {
    let field = field("msl_2001.toml");
    let truth = Pose::new(1.0, 0.5, 0.4);
    let goals = goal_observations(&field, truth);
    assert_eq!(confirm_by_goal_colours(&field, &[truth], &goals), [truth]);
    let other = confirm_by_goal_colours(&field, &[half_turn(truth)], &goals);
    assert!(near(other[0], truth));
    let wrong = Pose::new(1.0, 0.5, 0.4 + std::f32::consts::FRAC_PI_2);
    assert_eq!(
        confirm_by_goal_colours(&field, &[wrong, truth], &goals),
        [truth]
    );
    assert_eq!(confirm_by_goal_colours(&field, &[wrong], &goals), []);
    assert_eq!(confirm_by_goal_colours(&field, &[truth], &[]), []);
}

#[test]
fn coloured_goals_resolve_the_field_half_without_a_compass() {
    let field = field("msl_2001.toml");
    for by in [GlobalSearchMethod::Exact, GlobalSearchMethod::Hough] {
        let mut config = LocalizeConfig::default();
        config.global_search.method = by;
        let mut localizer = Localizer::new(&field, config);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut right, mut silently_wrong) = (0, 0);
        for k in 0..40 {
            let truth = random_pose(&field, &mut rng);
            let points =
                simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng);
            let stamp = Stamp::from_seconds(f64::from(k) * 40.0);
            localizer.add_goals(stamp, &goal_observations(&field, truth));
            let estimate = localizer.process_points(stamp, &points);
            let there = estimate.pose.is_some_and(|pose| near(pose, truth));
            right += usize::from(there && estimate.half_known);
            silently_wrong += usize::from(!there && estimate.half_known);
        }
        assert!(
            right >= 36 && silently_wrong == 0,
            "{by:?}: {right}, {silently_wrong}"
        );
    }
}

#[test]
fn coloured_goals_correct_a_pose_in_the_wrong_half() {
    let field = field("msl_2001.toml");
    let mut localizer = Localizer::new(&field, LocalizeConfig::default());
    let mut frames = SyntheticDrive::new(
        &field,
        SyntheticDriveConfig::default(),
        ChaCha8Rng::seed_from_u64(6),
    );
    let first = frames.next().expect("an endless drive");
    let certain = nalgebra::Matrix3::identity() * 1e-3;
    localizer.set_pose(first.stamp, half_turn(first.true_pose), &certain);
    let mut last = None;
    for frame in frames.take(60) {
        localizer.add_odometry(&frame.odometry);
        localizer.add_goals(frame.stamp, &goal_observations(&field, frame.true_pose));
        let estimate = localizer.process_points(frame.stamp, &frame.points);
        last = Some((estimate, frame.true_pose));
    }
    let (estimate, truth) = last.expect("frames");
    assert!(estimate.half_known && near(estimate.pose.expect("a pose"), truth));
}

#[test]
fn every_preset_tracks_a_drive_on_the_2001_field() {
    let field = field("msl_2001.toml");
    for name in PRESETS {
        let config = LocalizeConfig::preset(name).expect("a preset");
        let mut localizer = Localizer::new(&field, config);
        let frames = SyntheticDrive::new(
            &field,
            SyntheticDriveConfig::default(),
            ChaCha8Rng::seed_from_u64(3),
        );
        let (mut near_enough, mut count) = (0, 0);
        for frame in frames.take(150).skip(30) {
            localizer.add_odometry(&frame.odometry);
            localizer.add_compass(&frame.compass);
            let estimate = localizer.process_points(frame.stamp, &frame.points);
            count += 1;
            near_enough += usize::from(
                estimate
                    .pose
                    .is_some_and(|pose| pose.origin().distance_to(frame.true_pose.origin()) < 0.2),
            );
        }
        assert!(
            near_enough * 10 >= count * 8,
            "{name}: {near_enough} of {count}"
        );
    }
    assert!(LocalizeConfig::preset("nobody").is_none());
}
