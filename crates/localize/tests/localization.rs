//! Reliability of localization: poses are accurate in mode tracking, and failures are reported.

use localize::field::FieldConfig;
use localize::frames::wrap_angle;
use localize::global_search::branch_and_bound::half_turn;
use localize::matching::Matcher;
use localize::sample::{Compass, Imu, LinePoint, Odometry};
use localize::synthetic::drive::{
    SyntheticDrive, SyntheticDriveConfig, random_pose, simulate_line_points,
};
use localize::tilt::map_from_ground;
use localize::{At, DistanceField, Field, LocalizeConfig, Localizer, Mode, Pose, Reason, Stamp};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

fn field() -> Field {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    Field::load(std::path::Path::new(path)).expect("a field")
}

fn drive(seed: u64, config: SyntheticDriveConfig) -> SyntheticDrive<ChaCha8Rng> {
    SyntheticDrive::new(&field(), config, ChaCha8Rng::seed_from_u64(seed))
}

fn localizer() -> Localizer {
    Localizer::new(&field(), LocalizeConfig::default())
}

fn position_error(a: Pose, b: Pose) -> f32 {
    a.origin().distance_to(b.origin())
}

fn point(x: f32, y: f32) -> LinePoint {
    LinePoint {
        at: At::new(x, y),
        std_radial: 0.03,
        std_tangential: 0.03,
    }
}

fn stationary_odometry(seconds: f64) -> Odometry {
    Odometry {
        stamp: Stamp::from_seconds(seconds),
        dx: 0.0,
        dy: 0.0,
        dtheta: 0.0,
        slip: 0.0,
    }
}

#[test]
fn drive_is_tracked_within_6_cm_and_odometry_scale_is_estimated() {
    let mut localizer = localizer();
    let mut last = None;
    for (k, frame) in drive(1, SyntheticDriveConfig::default())
        .take(600)
        .enumerate()
    {
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        let estimate = localizer.process_points(frame.stamp, &frame.points);
        if k >= 15 {
            let pose = estimate.pose.expect("a pose");
            assert!(position_error(pose, frame.true_pose) < 0.06, "frame {k}");
            assert_eq!(estimate.mode, Mode::Tracking);
        }
        last = Some(estimate);
    }
    let [distance_scale, yaw_scale] = last.expect("frames").odometry_scales;
    // Odometry reports 3 % too much.
    assert!(
        (distance_scale - 1.0 / 1.03).abs() < 0.01 && (yaw_scale - 1.0 / 1.03).abs() < 0.02,
        "{distance_scale} {yaw_scale}"
    );
}

#[test]
fn pose_covariance_is_consistent() {
    let mut localizer = localizer();
    let (mut sum, mut count) = (0.0, 0.0_f32);
    for (k, frame) in drive(2, SyntheticDriveConfig::default())
        .take(1800)
        .enumerate()
    {
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        let estimate = localizer.process_points(frame.stamp, &frame.points);
        if k < 60 {
            continue;
        }
        let pose = estimate.pose.expect("a pose");
        let off = nalgebra::Vector3::new(
            pose.x - frame.true_pose.x,
            pose.y - frame.true_pose.y,
            wrap_angle(pose.theta - frame.true_pose.theta),
        );
        let inverse = estimate.covariance.try_inverse().expect("a covariance");
        sum += off.dot(&(inverse * off));
        count += 1.0;
    }
    // Three degrees of freedom. Errors of consecutive images are correlated, so that the mean has a large variance.
    assert!((1.8..4.2).contains(&(sum / count)), "{}", sum / count);
}

#[test]
fn single_images_are_located_with_a_compass() {
    let field = field();
    let mut localizer = localizer();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut right = 0;
    for k in 0..60 {
        let truth = random_pose(&field, &mut rng);
        let points =
            simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng);
        let stamp = Stamp::from_seconds(f64::from(k) * 40.0);
        let heading = truth.theta + 0.2;
        localizer.add_compass(&Compass {
            stamp,
            heading,
            magnetic_field: None,
        });
        let estimate = localizer.process_points(stamp, &points);
        assert_ne!(estimate.mode, Mode::Tracking);
        right += i32::from(
            estimate
                .pose
                .is_some_and(|pose| position_error(pose, truth) < 0.1),
        );
    }
    assert!(right >= 59, "{right} of 60");
}

#[test]
fn robot_that_sees_three_metres_knows_its_place_after_five_seconds_and_keeps_it() {
    for seed in 0..6 {
        let short_sight = SyntheticDriveConfig {
            range_max: 3.0,
            ..SyntheticDriveConfig::default()
        };
        let mut localizer = localizer();
        for (k, frame) in drive(seed, short_sight).take(600).enumerate() {
            localizer.add_odometry(&frame.odometry);
            localizer.add_compass(&frame.compass);
            let estimate = localizer.process_points(frame.stamp, &frame.points);
            if k < 150 {
                continue;
            }
            assert_eq!(estimate.mode, Mode::Tracking, "seed {seed}, frame {k}");
            let error = position_error(estimate.pose.expect("a pose"), frame.true_pose);
            assert!(error < 0.1, "seed {seed}, frame {k}: {error} m");
        }
    }
}

#[test]
fn field_half_is_unknown_until_a_compass_reading() {
    let mut localizer = localizer();
    let mut frames = drive(4, SyntheticDriveConfig::default());
    for _ in 0..30 {
        let frame = frames.next().expect("an endless drive");
        localizer.add_odometry(&frame.odometry);
        let estimate = localizer.process_points(frame.stamp, &frame.points);
        assert_eq!(estimate.mode, Mode::Global);
        assert!(!estimate.half_known && estimate.reason.is_some());
        let pose = estimate.pose.expect("a pose");
        let either = position_error(pose, frame.true_pose)
            .min(position_error(half_turn(pose), frame.true_pose));
        assert!(either < 0.1, "{either}");
    }
    let mut known = None;
    for k in 0..10 {
        let frame = frames.next().expect("an endless drive");
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        let estimate = localizer.process_points(frame.stamp, &frame.points);
        if estimate.mode == Mode::Tracking {
            assert!(position_error(estimate.pose.expect("a pose"), frame.true_pose) < 0.1);
            known = known.or(Some(k));
        }
    }
    assert!(known.is_some_and(|k| k < 5), "{known:?}");
}

#[test]
fn localizer_that_goes_on_keeps_the_doubt_about_the_field_half() {
    let mut rest = drive(5, SyntheticDriveConfig::default()).take(60);
    let mut before = localizer();
    for frame in rest.by_ref().take(30) {
        before.add_odometry(&frame.odometry);
        before.process_points(frame.stamp, &frame.points);
    }
    let half = before.tracked_half().expect("tracked");
    assert!(half.log_odds < 1.0 && !half.established, "{half:?}");
    let frame = rest.next().expect("a frame");
    before.add_odometry(&frame.odometry);
    let last = before.process_points(frame.stamp, &frame.points);
    let pose = last.pose.expect("a pose");
    let mut resumed = localizer();
    resumed.resume_pose(frame.stamp, pose, &last.covariance, half);
    let mut given = localizer();
    given.set_pose(frame.stamp, pose, &last.covariance);
    for frame in rest {
        for localizer in [&mut resumed, &mut given] {
            localizer.add_odometry(&frame.odometry);
        }
        let estimate = resumed.process_points(frame.stamp, &frame.points);
        assert_eq!(
            (estimate.mode, estimate.half_known),
            (Mode::Global, false),
            "a new localizer knows no more than the one before"
        );
        let estimate = given.process_points(frame.stamp, &frame.points);
        assert!(estimate.half_known, "the half of a given pose is known");
    }
}

#[test]
fn kidnapped_robot_says_lost_and_is_located_within_24_frames() {
    let covered = SyntheticDriveConfig {
        occluded_share: 0.25,
        ..SyntheticDriveConfig::default()
    };
    let mut frames = drive(5, covered);
    let mut localizer = localizer();
    for _ in 0..12 {
        for _ in 0..60 {
            let frame = frames.next().expect("an endless drive");
            localizer.add_odometry(&frame.odometry);
            localizer.add_compass(&frame.compass);
            localizer.process_points(frame.stamp, &frame.points);
        }
        frames.kidnap();
        let (mut lost_after, mut found_after) = (None, None);
        for k in 0..24 {
            let frame = frames.next().expect("an endless drive");
            localizer.add_odometry(&frame.odometry);
            localizer.add_compass(&frame.compass);
            let estimate = localizer.process_points(frame.stamp, &frame.points);
            if estimate.mode == Mode::Lost {
                lost_after = lost_after.or(Some(k));
            }
            if estimate
                .pose
                .is_some_and(|pose| position_error(pose, frame.true_pose) < 0.15)
            {
                found_after = found_after.or(Some(k));
            }
        }
        assert!(
            lost_after.is_some_and(|lost| found_after.is_some_and(|found| lost < found)),
            "lost after {lost_after:?}, found after {found_after:?}"
        );
    }
}

#[test]
fn push_missed_by_odometry_is_corrected_within_5_frames() {
    let field = field();
    let mut localizer = localizer();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for k in 0..60 {
        let x = if k < 30 { 4.0 } else { 4.25 };
        let truth = Pose::new(x, 3.0, 0.5);
        let stamp = Stamp::from_seconds(f64::from(k) / 30.0);
        let heading = 0.5;
        localizer.add_odometry(&stationary_odometry(f64::from(k) / 30.0));
        localizer.add_compass(&Compass {
            stamp,
            heading,
            magnetic_field: None,
        });
        let points =
            simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng);
        let estimate = localizer.process_points(stamp, &points);
        if k == 29 || k > 34 {
            let pose = estimate.pose.expect("a pose");
            assert!(position_error(pose, truth) < 0.05, "frame {k}: {pose:?}");
        }
    }
}

#[test]
fn covered_camera_is_dead_reckoned_then_reported_lost() {
    let mut config = LocalizeConfig::default();
    config.mode.lost_position_std = 0.2;
    let mut localizer = Localizer::new(&field(), config);
    let mut frames = drive(7, SyntheticDriveConfig::default());
    let mut before = 0.0;
    let mut lost_at = None;
    for k in 0..30 * 40 {
        let frame = frames.next().expect("an endless drive");
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        let covered = k >= 300;
        let points = if covered { &[][..] } else { &frame.points };
        let estimate = localizer.process_points(frame.stamp, points);
        let std = estimate.covariance[(0, 0)].sqrt();
        if (300..330).contains(&k) {
            assert_eq!(estimate.reason, Some(Reason::FewPoints));
            assert!(std >= before, "frame {k}");
        }
        before = std;
        if let Some(pose) = estimate.pose {
            let error = position_error(pose, frame.true_pose);
            assert!(k < 15 || error < 0.8, "frame {k}: off by {error}");
        } else if k > 300 {
            lost_at = lost_at.or(Some(k));
        }
    }
    assert!(lost_at.is_some(), "never reported lost");
}

#[test]
fn estimates_are_bit_reproducible() {
    let run = || -> Vec<u32> {
        let mut localizer = localizer();
        drive(8, SyntheticDriveConfig::default())
            .take(120)
            .flat_map(|frame| {
                localizer.add_odometry(&frame.odometry);
                let estimate = localizer.process_points(frame.stamp, &frame.points);
                let pose = estimate.pose.unwrap_or(Pose::new(0.0, 0.0, 0.0));
                [pose.x.to_bits(), pose.y.to_bits(), pose.theta.to_bits()]
            })
            .collect()
    };
    assert_eq!(run(), run());
}

#[test]
fn single_line_leaves_position_along_it_unconstrained() {
    let distances = DistanceField::new(&field(), &LocalizeConfig::default().distance_field);
    let mut matcher = Matcher::new(LocalizeConfig::default().matching);
    // Along the touch line at y = 5.9375, seen from (3, 4).
    let points: Vec<_> = (0..30)
        .map(|k| point(-1.5 + 0.1 * k as f32, 5.9375 - 4.0))
        .collect();
    let matched = matcher.refine(&distances, &points, Pose::new(3.0, 4.02, 0.0), 0.05);
    assert!((matched.pose.y - 4.0).abs() < 0.01);
    assert!((matched.pose.x - 3.0).abs() < 0.01, "x moved though free");
    assert!(matched.covariance[(0, 0)].sqrt() > 1.0);
    assert!(matched.covariance[(1, 1)].sqrt() < 0.05);
}

/// Points of the centre circle alone (1.9375 m to the line's centre), with errors.
fn circle_points(truth: Pose, image: usize, rng: &mut ChaCha8Rng) -> Vec<LinePoint> {
    let bearing = localize::math::atan2(truth.y, truth.x);
    let points = (0..40).map(|k| {
        let angle = bearing + 0.03 * (k as f32 - 20.0 + 0.25 * (image % 4) as f32);
        let (sin, cos) = localize::math::sin_cos(angle);
        let at = truth.inverse() * At::new(1.9375 * cos, 1.9375 * sin);
        point(at.x + normal(0.02, rng), at.y + normal(0.02, rng))
    });
    points.collect()
}

fn normal(std: f32, rng: &mut ChaCha8Rng) -> f32 {
    let sum: f32 = (0..12)
        .map(|_| rng.next_u32() as f32 / u32::MAX as f32 - 0.5)
        .sum();
    std * sum
}

#[test]
fn points_of_one_circle_tell_no_turn_about_its_centre() {
    let distances = DistanceField::new(&field(), &LocalizeConfig::default().distance_field);
    let mut matcher = Matcher::new(LocalizeConfig::default().matching);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    // Beside the halfway line.
    for bearing in [-0.7_f32, -0.3, 0.1, 0.6] {
        let (sin, cos) = localize::math::sin_cos(bearing);
        let truth = Pose::new(3.1 * cos, 3.1 * sin, 1.7 * bearing);
        let points = circle_points(truth, 0, &mut rng);
        let matched = matcher.refine(&distances, &points, truth, 0.05);
        let information = matched.covariance.try_inverse().expect("an inverse");
        let turn = nalgebra::Vector3::new(-matched.pose.y, matched.pose.x, 1.0);
        let std = 1.0 / turn.dot(&(information * turn)).max(1e-6).sqrt();
        assert!(
            std > 0.5,
            "from {bearing}: the turn is known to {std} radians"
        );
    }
}

/// A drive of ten seconds about a circle that is all that the robot sees (1.5 m): heading errors and their standard deviations,
/// radians, in each image. The heading is known to 6° at the start, and with it the place on the arc about the centre.
fn drive_beside_a_circle(seed: u64, wheel_noise: f32, wheel_scale: f32) -> Vec<[f32; 2]> {
    let mut config = FieldConfig::without_markings([16.0, 12.0], 0.05, 1.0);
    config.extra_arcs = vec![[0.0, 0.0, 2.0, 0.0, 360.0]];
    let field = Field::new(config).expect("a field");
    let mut localizer = Localizer::new(&field, LocalizeConfig::default());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let pose_at = |time: f32| {
        let sin = localize::math::sin::<f32>;
        let (x, y) = (1.0 + 0.3 * sin(0.5 * time), 0.5 * sin(0.8 * time));
        Pose::new(x, y, 0.4 + 1.5 * sin(0.7 * time))
    };
    let mut truth = pose_at(0.0);
    let turn = nalgebra::Vector3::new(-truth.y, truth.x, 1.0);
    let covariance = turn * turn.transpose() * 0.01 + nalgebra::Matrix3::identity() * 1e-5;
    localizer.set_pose(Stamp::from_seconds(0.0), truth, &covariance);
    let mut errors = Vec::new();
    for k in 1..=600 {
        let seconds = k as f32 / 60.0;
        let stamp = Stamp::from_seconds(f64::from(seconds));
        let next = pose_at(seconds);
        let moved = truth.inverse() * next.origin();
        let turned = next.theta - truth.theta;
        let mut wheel = |motion: f32, scale: f32, noise: f32| {
            let noise = noise * wheel_noise * motion.abs().sqrt();
            motion * (1.0 + scale) + normal(noise, &mut rng)
        };
        let odometry = Odometry {
            stamp,
            dx: wheel(moved.x, wheel_scale, 0.1),
            dy: wheel(moved.y, wheel_scale, 0.1),
            dtheta: wheel(turned, -wheel_scale, 0.3),
            slip: 0.0,
        };
        localizer.add_odometry(&odometry);
        truth = next;
        if k % 2 == 1 {
            continue;
        }
        let mut points = Vec::new();
        for step in (k % 3..400).step_by(3) {
            let (sin, cos) = localize::math::sin_cos(step as f32 * 0.015_708);
            let at = truth.inverse() * At::new(2.0 * cos, 2.0 * sin);
            if at.distance() < 1.5 {
                points.push(point(
                    at.x + normal(0.02, &mut rng),
                    at.y + normal(0.02, &mut rng),
                ));
            }
        }
        let estimate = localizer.process_points(stamp, &points);
        let pose = estimate.pose.expect("a pose");
        errors.push([
            wrap_angle(pose.theta - truth.theta),
            estimate.covariance[(2, 2)].sqrt(),
        ]);
    }
    errors
}

#[test]
fn robot_that_sees_one_circle_keeps_the_doubt_about_its_heading() {
    for (seed, wheel_noise, wheel_scale) in [
        (0, 0.0, 0.0),
        (1, 0.0, 0.02),
        (2, 0.02, 0.0),
        (3, 0.02, 0.02),
        (4, 0.02, -0.02),
        (5, 0.0, 0.0),
    ] {
        for (image, [error, std]) in drive_beside_a_circle(seed, wheel_noise, wheel_scale)
            .into_iter()
            .enumerate()
        {
            assert!(
                std > 0.07 && error.abs() < 2.0 * std,
                "seed {seed}, image {image}: {error} rad off at {std}"
            );
        }
    }
}

#[test]
fn invalid_points_give_no_pose() {
    let mut localizer = localizer();
    let nan = vec![point(f32::NAN, 1.0), point(1.0, f32::INFINITY)];
    let far: Vec<_> = (0..50).map(|k| point(40.0 + k as f32, 40.0)).collect();
    let heap: Vec<_> = (0..50).map(|_| point(1.0, 1.0)).collect();
    for (k, points) in [&[][..], &nan, &far].into_iter().enumerate() {
        let estimate = localizer.process_points(Stamp::from_seconds(k as f64), points);
        assert_eq!((estimate.mode, estimate.pose), (Mode::Lost, None));
        assert!(estimate.covariance[(0, 0)].sqrt() > 3.0);
    }
    let estimate = localizer.process_points(Stamp::from_seconds(10.0), &heap);
    assert_ne!(estimate.mode, Mode::Tracking);
}

#[test]
fn single_line_grows_the_covariance_along_it() {
    let field = field();
    let mut localizer = localizer();
    let truth = Pose::new(3.0, 4.0, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let mut begun = None;
    for k in 0..240 {
        let stamp = Stamp::from_seconds(f64::from(k) / 30.0);
        localizer.add_odometry(&stationary_odometry(f64::from(k) / 30.0));
        localizer.add_compass(&Compass {
            stamp,
            heading: 0.0,
            magnetic_field: None,
        });
        let points = if k < 60 {
            simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng)
        } else {
            // Along the touch line at y = 5.9375.
            (0..30)
                .map(|k| point(-1.5 + 0.1 * k as f32, 5.9375 - 4.0))
                .collect()
        };
        let estimate = localizer.process_points(stamp, &points);
        let [along, across] = [0, 1].map(|i| estimate.covariance[(i, i)].sqrt());
        if k >= 59 {
            assert!(
                position_error(estimate.pose.expect("a pose"), truth) < 0.05,
                "frame {k}"
            );
            assert!(across < 0.05, "frame {k}");
        }
        if k == 59 {
            begun = Some(along);
        }
        if k == 239 {
            let begun = begun.expect("tracked");
            assert!(along > 2.0 * begun, "{begun} {along}");
        }
    }
}

#[test]
fn points_outside_the_field_do_not_move_a_tracked_pose() {
    let mut localizer = localizer();
    let mut frames = drive(15, SyntheticDriveConfig::default());
    let mut last = None;
    for k in 0..90 {
        let frame = frames.next().expect("an endless drive");
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        let astray =
            [30.0_f32, -40.0, 60.0].map(|x| [point(x, x), point(-x, 0.5 * x), point(x, 0.0)]);
        let points = if k < 60 {
            frame.points.clone()
        } else {
            astray.as_flattened().to_vec()
        };
        let estimate = localizer.process_points(frame.stamp, &points);
        if k >= 60 {
            assert_ne!(estimate.reason, None, "frame {k}");
            if let Some(pose) = estimate.pose {
                assert!(position_error(pose, frame.true_pose) < 0.3, "frame {k}");
            }
            let std = estimate.covariance[(0, 0)].sqrt();
            assert!(
                last.is_none_or(|last| std > 0.95 * last),
                "frame {k}: {std} {last:?}"
            );
            last = Some(std);
        }
    }
}

#[test]
fn single_line_is_reported_ambiguous() {
    // A single line leaves the position along it undetermined.
    let mut localizer = localizer();
    let line: Vec<_> = (0..40).map(|k| point(-2.0 + 0.1 * k as f32, 1.5)).collect();
    for k in 0..3 {
        let stamp = Stamp::from_seconds(f64::from(k) / 30.0);
        localizer.add_odometry(&stationary_odometry(f64::from(k) / 30.0));
        let estimate = localizer.process_points(stamp, &line);
        assert_ne!(estimate.mode, Mode::Tracking);
        assert!(!estimate.half_known && estimate.reason.is_some());
        assert!(estimate.covariance[(0, 0)].max(estimate.covariance[(1, 1)]) > 0.5);
    }
}

#[test]
fn nan_points_are_ignored() {
    let (mut clean, mut dirty) = (localizer(), localizer());
    for frame in drive(9, SyntheticDriveConfig::default()).take(60) {
        let mut points = frame.points.clone();
        points.insert(points.len() / 2, point(f32::NAN, f32::NAN));
        clean.add_odometry(&frame.odometry);
        dirty.add_odometry(&frame.odometry);
        let a = clean.process_points(frame.stamp, &frame.points);
        let b = dirty.process_points(frame.stamp, &points);
        assert_eq!(a.pose, b.pose);
    }
}

#[test]
fn out_of_order_image_is_rejected_and_clock_reset_accepted() {
    let mut localizer = localizer();
    let mut frames = drive(10, SyntheticDriveConfig::default());
    let mut shown = Vec::new();
    for _ in 0..30 {
        let frame = frames.next().expect("an endless drive");
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        localizer.process_points(frame.stamp, &frame.points);
        shown.push((frame.stamp, frame.true_pose));
    }
    let frame = frames.next().expect("an endless drive");
    // An image of another place, 0.1 s before the last one: the pose is that of its own time, and it changes nothing.
    let (stamp, truth) = shown[26];
    let elsewhere = drive(11, SyntheticDriveConfig::default()).next();
    let late = localizer.process_points(stamp, &elsewhere.expect("a frame").points);
    assert_eq!(late.reason, Some(Reason::OutOfOrder));
    let pose = late.pose.expect("a pose");
    let std = (late.covariance[(0, 0)] + late.covariance[(1, 1)]).sqrt();
    assert!(std < 0.08, "{std}");
    assert!(
        position_error(pose, truth) < 2.0 * std,
        "{pose:?} {truth:?}"
    );
    assert!(
        position_error(truth, shown[29].1) > 0.1,
        "the robot has moved"
    );
    let early = Stamp::from_seconds(0.1);
    let mut again = localizer.process_points(early, &frame.points);
    assert_eq!(again.reason, Some(Reason::OutOfOrder));
    for k in 0..10 {
        let stamp = Stamp::from_seconds(0.2 + 0.03 * f64::from(k));
        let heading = frame.true_pose.theta;
        localizer.add_compass(&Compass {
            stamp,
            heading,
            magnetic_field: None,
        });
        again = localizer.process_points(stamp, &frame.points);
    }
    assert_ne!(again.reason, Some(Reason::OutOfOrder));
    assert!(position_error(again.pose.expect("a pose"), frame.true_pose) < 0.1);
}

#[test]
fn late_images_are_applied_at_their_stamp() {
    let mut localizer = localizer();
    let frames: Vec<_> = drive(13, SyntheticDriveConfig::default())
        .take(120)
        .collect();
    for (k, now) in frames.iter().enumerate() {
        localizer.add_odometry(&now.odometry);
        localizer.add_compass(&now.compass);
        // Images arrive two samples late.
        let Some(frame) = k.checked_sub(2).map(|k| &frames[k]) else {
            continue;
        };
        let estimate = localizer.process_points(frame.stamp, &frame.points);
        if k > 30 {
            assert_eq!(estimate.mode, Mode::Tracking, "frame {k}");
            let pose = estimate.pose.expect("a pose");
            assert!(position_error(pose, frame.true_pose) < 0.05, "frame {k}");
        }
    }
}

#[test]
fn odometry_gap_ends_tracking() {
    let mut localizer = localizer();
    let mut frames = drive(11, SyntheticDriveConfig::default());
    for _ in 0..30 {
        let frame = frames.next().expect("an endless drive");
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        localizer.process_points(frame.stamp, &frame.points);
    }
    let frame = frames.next().expect("an endless drive");
    localizer.add_odometry(&stationary_odometry(3.0));
    let estimate = localizer.process_points(Stamp::from_seconds(3.0), &frame.points);
    assert_ne!(estimate.mode, Mode::Tracking);
}

#[test]
fn pause_of_all_sensors_ends_tracking() {
    let mut localizer = localizer();
    let mut frames = drive(11, SyntheticDriveConfig::default());
    let imu = |stamp| Imu {
        stamp,
        specific_force: [0.0, 0.0, 9.806_65],
        angular_velocity: [0.0; 3],
    };
    for k in 0..60 {
        let mut frame = frames.next().expect("an endless drive");
        // A recording that was interrupted.
        let pause = if k < 30 { 0.0 } else { 60.0 };
        frame.odometry.stamp = frame.odometry.stamp + pause;
        frame.compass.stamp = frame.compass.stamp + pause;
        localizer.add_imu(&imu(frame.stamp + pause));
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        let estimate = localizer.process_points(frame.stamp + pause, &frame.points);
        if k == 30 {
            assert_ne!(estimate.mode, Mode::Tracking);
        }
        let error = estimate
            .pose
            .map_or(0.0, |pose| position_error(pose, frame.true_pose));
        assert!(error < 0.2, "{error} m off in image {k}");
    }
}

#[test]
fn lines_contradict_a_compass_that_iron_turns() {
    let field = field();
    for seed in 0..8 {
        let mut localizer = localizer();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let truth = random_pose(&field, &mut rng);
        for k in 0..10 {
            let seconds = f64::from(k) / 30.0;
            localizer.add_odometry(&stationary_odometry(seconds));
            localizer.add_compass(&Compass {
                stamp: Stamp::from_seconds(seconds),
                heading: wrap_angle(truth.theta + 80.0_f32.to_radians()),
                magnetic_field: None,
            });
            let drive = SyntheticDriveConfig::default();
            let points = simulate_line_points(&field, &drive, truth, &mut rng);
            let estimate = localizer.process_points(Stamp::from_seconds(seconds), &points);
            let Some(pose) = estimate.pose else { continue };
            let known = estimate.reason != Some(Reason::Ambiguous);
            let [error, mirrored] = [pose, half_turn(pose)].map(|pose| position_error(pose, truth));
            let variance = (0..2)
                .map(|k| estimate.covariance[(k, k)])
                .fold(0.0, f32::max);
            assert!(
                error < 0.1 || !known && mirrored < 0.1 || variance > 0.25,
                "seed {seed}: {pose:?} with {:?}, at {truth:?}",
                estimate.reason
            );
        }
    }
}

#[test]
fn tilt_estimation_reduces_position_error() {
    let field = field();
    let distances = DistanceField::new(&field, &LocalizeConfig::default().distance_field);
    let config = LocalizeConfig::default().matching;
    let mut matcher = Matcher::new(config.clone());
    let upright = localize::matching::MatchConfig {
        tilt_std_deg: 0.0,
        ..config.clone()
    };
    let mut without = Matcher::new(upright);
    let (mut with_tilt, mut without_tilt) = (0.0, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let height = config.viewpoint_height;
    let (a, b) = (0.5_f32.to_radians(), -0.4_f32.to_radians());
    for _ in 0..40 {
        let truth = random_pose(&field, &mut rng);
        let mut points =
            simulate_line_points(&field, &SyntheticDriveConfig::default(), truth, &mut rng);
        for point in &mut points {
            let [x, y] = map_from_ground([point.at.x, point.at.y], [a, b], height)
                .expect("a point below the horizon");
            point.at = At::new(x, y);
        }
        let start = Pose::new(truth.x + 0.03, truth.y - 0.03, truth.theta + 0.01);
        with_tilt += position_error(matcher.refine(&distances, &points, start, 0.2).pose, truth);
        without_tilt += position_error(without.refine(&distances, &points, start, 0.2).pose, truth);
    }
    assert!(with_tilt < 0.6 * without_tilt, "{with_tilt} {without_tilt}");
}

#[test]
fn wheels_doubt_a_turned_camera_but_not_a_hard_hall_or_kidnaps() {
    let hard = SyntheticDriveConfig {
        outlier_share: 0.5,
        ..SyntheticDriveConfig::default()
    };
    for (turned, config) in [(true, SyntheticDriveConfig::default()), (false, hard)] {
        let mut localizer = localizer();
        let mut frames = drive(9, config);
        let mut doubted = 0;
        for k in 0..900 {
            if !turned && k % 200 == 199 {
                frames.kidnap();
            }
            let mut frame = frames.next().expect("an endless drive");
            if turned {
                for point in &mut frame.points {
                    point.at = At::new(-point.at.y, point.at.x);
                }
            }
            localizer.add_odometry(&frame.odometry);
            let estimate = localizer.process_points(frame.stamp, &frame.points);
            if estimate.reason == Some(Reason::DoubtfulSetup) {
                doubted += 1;
                assert_ne!(estimate.mode, Mode::Tracking);
                assert!(estimate.covariance[(0, 0)] > 1.0);
            }
        }
        assert_eq!(doubted > 200, turned, "{doubted} images doubted");
        assert!(turned || doubted == 0, "{doubted} images doubted");
    }
}

/// The pose of a robot that begins at a known place: before its wheels have said anything.
#[test]
fn pose_that_was_told_holds_for_the_image_of_that_time() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let config = SyntheticDriveConfig::default();
    let pose = Pose::new(3.0, -2.0, 0.7);
    let cases = [
        (pose, false),
        (half_turn(pose), false),
        (half_turn(pose), true),
    ];
    for (told, wheels) in cases {
        let mut localizer = localizer();
        let covariance = nalgebra::Matrix3::identity() * 0.01;
        localizer.set_pose(Stamp::from_seconds(1.0), told, &covariance);
        // Wheels of the time before may be read after it.
        let after = 0.02 * f64::from(u8::from(wheels));
        for k in 0..10 * usize::from(wheels) {
            localizer.add_odometry(&stationary_odometry(0.92 + 0.01 * k as f64));
        }
        let points = simulate_line_points(&field(), &config, told, &mut rng);
        let estimate = localizer.process_points(Stamp::from_seconds(1.0 + after), &points);
        let pose = estimate.pose.expect("a pose");
        assert!(
            estimate.half_known && estimate.mode == Mode::Tracking,
            "{:?}",
            estimate.mode
        );
        assert!(position_error(pose, told) < 0.1, "{pose:?}");
    }
}
