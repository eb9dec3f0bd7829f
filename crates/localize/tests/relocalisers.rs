//! Each paper's way of finding the place from nothing does find it, on the field its paper had.

use localize::drive::{Drive, DriveConfig, anywhere, normal, see};
use localize::frame::wrap_angle;
use localize::matching::Matcher;
use localize::presets::PRESETS;
use localize::relocalise::hough::settle;
use localize::relocalise::scan_map::{Origin, ScanMap, ScanMapConfig};
use localize::relocalise::{RelocaliseConfig, Relocaliser, RelocaliserKind, Sight};
use localize::sample::GoalSight;
use localize::search::{HeadingPrior, Search, half_turn};
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

/// How many of `count` random poses the relocaliser puts first, with or without a compass (then up to the half turn).
fn found(by: RelocaliserKind, field: &Field, compass: bool, count: usize) -> usize {
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(field, &config.distance);
    let mut search = Search::new(field, &distances, config.search.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let chosen = RelocaliseConfig {
        by,
        ..RelocaliseConfig::default()
    };
    let mut relocaliser = Relocaliser::new(field, &distances, &chosen);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut right = 0;
    for _ in 0..count {
        let truth = anywhere(field, &mut rng);
        let points = see(field, &DriveConfig::default(), truth, &mut rng);
        let std = 10.0_f32.to_radians();
        let heading = truth.theta + std * normal(&mut rng);
        relocaliser.restart();
        let sight = Sight {
            distances: &distances,
            points: &points,
            prior: compass.then_some(HeadingPrior { heading, std }),
            goals: &[],
            alone: true,
        };
        let all = relocaliser.find(&mut search, &mut matcher, &sight);
        right += usize::from(all.first().is_some_and(|best| {
            near(best.pose, truth) || !compass && near(half_turn(best.pose), truth)
        }));
    }
    right
}

#[test]
fn the_exact_search_needs_no_compass() {
    let field = field("msl_18x12.toml");
    assert!(found(RelocaliserKind::Exact, &field, false, 200) >= 197);
    assert!(found(RelocaliserKind::Exact, &field, true, 200) >= 199);
}

#[test]
fn hough_locates_on_the_field_of_its_paper() {
    let field = field("msl_2001.toml");
    assert!(found(RelocaliserKind::Hough, &field, true, 90) >= 86);
}

#[test]
fn the_scan_map_locates_on_the_field_of_its_paper() {
    let field = field("msl_18x12.toml");
    assert!(found(RelocaliserKind::ScanMap, &field, true, 50) >= 48);
}

#[test]
fn particles_gather_at_most_places_in_one_frame() {
    let field = field("msl_18x12.toml");
    assert!(found(RelocaliserKind::MonteCarlo, &field, true, 60) >= 48);
}

#[test]
fn the_exact_search_finds_the_best_cell_that_exhaustion_finds() {
    // On a small field: no pose of a fine lattice may explain the points better than the one found.
    let field = field("msl_2001.toml");
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(&field, &config.distance);
    let mut search = Search::new(&field, &distances, config.search.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let sparse = DriveConfig {
        rays: 24,
        outliers: 0.3,
        ..DriveConfig::default()
    };
    for _ in 0..2 {
        let truth = anywhere(&field, &mut rng);
        let points = see(&field, &sparse, truth, &mut rng);
        let reach = config.search.reach;
        let score = |pose: Pose| -> f32 {
            points
                .iter()
                .map(|point| {
                    let at = pose * point.at;
                    let d = distances.nearest(at.x, at.y).distance;
                    reach * reach / (reach * reach + d * d)
                })
                .sum()
        };
        let all = search.find(&distances, &mut matcher, &points, None);
        let best = all.iter().map(|one| score(one.pose)).fold(0.0, f32::max);
        for k in 0..60 * 32 * 90 {
            let (i, j, turn) = (k % 60, k / 60 % 32, k / 1920);
            let pose = Pose::new(
                -4.5 + 0.15 * i as f32,
                -2.25 + 0.15 * j as f32,
                (turn as f32 * 2.0).to_radians(),
            );
            // Rounding to cells and steps of scores is worth a few per cent.
            assert!(score(pose) < 1.06 * best + 0.5, "{pose:?} beats the search");
        }
    }
}

#[test]
fn a_stored_scan_map_is_read_back_and_refused_for_another_field_or_pattern() {
    let (small, other) = (field("msl_2001.toml"), field("msl_12x8.toml"));
    let distances = DistanceField::new(&small, &LocalizeConfig::default().distance);
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

#[test]
fn a_map_is_kept_and_a_damaged_or_unwritable_file_costs_only_the_time_to_build() {
    let field = field("msl_2001.toml");
    let distances = DistanceField::new(&field, &LocalizeConfig::default().distance);
    let config = ScanMapConfig {
        cell: 0.5,
        ..ScanMapConfig::default()
    };
    let fresh = ScanMap::new(&field, &distances, config.clone());
    let folder = tempfile::tempdir().expect("a folder");
    let cached = |folder: &std::path::Path| {
        let (map, origin) = ScanMap::cached(folder, &field, &distances, config.clone());
        assert_eq!(map, fresh);
        origin
    };
    // The folder is made when there is none.
    let inside = folder.path().join("maps");
    assert_eq!(cached(&inside), Origin::Built);
    assert_eq!(cached(&inside), Origin::Read);
    let files: Vec<_> = std::fs::read_dir(&inside).expect("files").collect();
    let [file] = &files[..] else {
        panic!("{files:?}")
    };
    let file = file.as_ref().expect("a file").path();
    std::fs::write(&file, b"MBSCAN, but cut off").expect("written");
    assert_eq!(cached(&inside), Origin::Rebuilt);
    assert_eq!(cached(&inside), Origin::Read);
    // A file stands where the folder should be.
    let Origin::NotKept(reason) = cached(&file) else {
        panic!("kept in a file")
    };
    assert!(reason.contains("scan_map_"), "{reason}");
}

/// What vision reports of the 2001 field's goals from `truth`: the middle of each goal's foot at the back of its box.
fn goals_seen(field: &Field, truth: Pose) -> Vec<GoalSight> {
    let [ahead, behind] = field.config.goal.colours;
    let back = field.length / 2.0 + 0.5 * field.config.goal.depth;
    [(ahead, back), (behind, -back)]
        .into_iter()
        .map(|(colour, x)| {
            let at = truth.inverse() * At::<FieldFrame>::new(x, 0.1);
            GoalSight {
                colour,
                at,
                std: 0.05 + 0.05 * at.distance(),
                width: 1.7,
            }
        })
        .collect()
}

#[test]
fn goal_colours_decide_the_half_turn_and_anything_else_takes_the_next_maximum() {
    let field = field("msl_2001.toml");
    let truth = Pose::new(1.0, 0.5, 0.4);
    let seen = goals_seen(&field, truth);
    assert_eq!(settle(&field, &[truth], &seen), [truth]);
    let other = settle(&field, &[half_turn(truth)], &seen);
    assert!(near(other[0], truth));
    let wrong = Pose::new(1.0, 0.5, 0.4 + std::f32::consts::FRAC_PI_2);
    assert_eq!(settle(&field, &[wrong, truth], &seen), [truth]);
    assert_eq!(settle(&field, &[wrong], &seen), []);
    assert_eq!(settle(&field, &[truth], &[]), []);
}

#[test]
fn coloured_goals_tell_the_half_where_no_compass_does() {
    let field = field("msl_2001.toml");
    for by in [RelocaliserKind::Exact, RelocaliserKind::Hough] {
        let mut config = LocalizeConfig::default();
        config.relocalise.by = by;
        let mut localizer = Localizer::new(&field, config);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut right, mut silently_wrong) = (0, 0);
        for k in 0..40 {
            let truth = anywhere(&field, &mut rng);
            let points = see(&field, &DriveConfig::default(), truth, &mut rng);
            let stamp = Stamp::from_seconds(f64::from(k) * 40.0);
            localizer.goals(stamp, &goals_seen(&field, truth));
            let estimate = localizer.see(stamp, &points);
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
fn coloured_goals_turn_a_tracked_pose_that_lies_in_the_wrong_half() {
    let field = field("msl_2001.toml");
    let mut localizer = Localizer::new(&field, LocalizeConfig::default());
    let mut frames = Drive::new(&field, DriveConfig::default(), ChaCha8Rng::seed_from_u64(6));
    let first = frames.next().expect("endless");
    let certain = nalgebra::Matrix3::identity() * 1e-3;
    localizer.set_pose(first.stamp, half_turn(first.truth), &certain);
    let mut last = None;
    for frame in frames.take(60) {
        localizer.odometry(&frame.odometry);
        localizer.goals(frame.stamp, &goals_seen(&field, frame.truth));
        let estimate = localizer.see(frame.stamp, &frame.points);
        last = Some((estimate, frame.truth));
    }
    let (estimate, truth) = last.expect("frames");
    assert!(estimate.half_known && near(estimate.pose.expect("a pose"), truth));
}

#[test]
fn every_preset_follows_a_drive_on_the_small_field() {
    let field = field("msl_2001.toml");
    for name in PRESETS {
        let config = LocalizeConfig::preset(name).expect("a preset");
        let mut localizer = Localizer::new(&field, config);
        let frames = Drive::new(&field, DriveConfig::default(), ChaCha8Rng::seed_from_u64(3));
        let (mut near_enough, mut count) = (0, 0);
        for frame in frames.take(150).skip(30) {
            localizer.odometry(&frame.odometry);
            localizer.compass(&frame.compass);
            let estimate = localizer.see(frame.stamp, &frame.points);
            count += 1;
            near_enough += usize::from(
                estimate
                    .pose
                    .is_some_and(|pose| pose.origin().distance_to(frame.truth.origin()) < 0.2),
            );
        }
        assert!(
            near_enough * 10 >= count * 8,
            "{name}: {near_enough} of {count}"
        );
    }
    assert!(LocalizeConfig::preset("nobody").is_none());
}
