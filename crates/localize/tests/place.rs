//! What a robot must be able to rely on: right when it says so, and saying so when it is not.

use localize::drive::{Drive, DriveConfig, anywhere, see};
use localize::frame::wrap_angle;
use localize::matching::Matcher;
use localize::sample::{Compass, LinePoint, Odometry};
use localize::search::half_turn;
use localize::{At, DistanceField, Field, LocalizeConfig, Localizer, Mode, Pose, Reason, Stamp};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn field() -> Field {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    Field::load(std::path::Path::new(path)).expect("a field")
}

fn drive(seed: u64, config: DriveConfig) -> Drive<ChaCha8Rng> {
    Drive::new(&field(), config, ChaCha8Rng::seed_from_u64(seed))
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

fn still(seconds: f64) -> Odometry {
    Odometry {
        stamp: Stamp::from_seconds(seconds),
        dx: 0.0,
        dy: 0.0,
        dtheta: 0.0,
        slip: 0.0,
    }
}

#[test]
fn a_drive_is_followed_within_centimetres_and_its_odometry_scale_learnt() {
    let mut localizer = localizer();
    let mut last = None;
    for (k, frame) in drive(1, DriveConfig::default()).take(600).enumerate() {
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        let estimate = localizer.see(frame.stamp, &frame.points);
        if k >= 15 {
            let pose = estimate.pose.expect("a pose");
            assert!(position_error(pose, frame.truth) < 0.06, "frame {k}");
            assert_eq!(estimate.mode, Mode::Tracking);
        }
        last = Some(estimate);
    }
    let [way, turn] = last.expect("frames").odometry_scales;
    // Odometry reports 3 % too much.
    assert!((way - 1.0 / 1.03).abs() < 0.01 && (turn - 1.0 / 1.03).abs() < 0.02);
}

#[test]
fn the_stated_uncertainty_is_honest() {
    let mut localizer = localizer();
    let (mut sum, mut count) = (0.0, 0.0_f32);
    for (k, frame) in drive(2, DriveConfig::default()).take(1800).enumerate() {
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        let estimate = localizer.see(frame.stamp, &frame.points);
        if k < 60 {
            continue;
        }
        let pose = estimate.pose.expect("a pose");
        let off = nalgebra::Vector3::new(
            pose.x - frame.truth.x,
            pose.y - frame.truth.y,
            wrap_angle(pose.theta - frame.truth.theta),
        );
        let inverse = estimate.covariance.try_inverse().expect("a covariance");
        sum += off.dot(&(inverse * off));
        count += 1.0;
    }
    // Three degrees of freedom; neighbouring frames share their errors, so that the mean scatters.
    assert!((1.8..4.2).contains(&(sum / count)), "{}", sum / count);
}

#[test]
fn stills_are_each_found_by_themselves_with_their_compass() {
    let field = field();
    let mut localizer = localizer();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut right = 0;
    for k in 0..60 {
        let truth = anywhere(&field, &mut rng);
        let points = see(&field, &DriveConfig::default(), truth, &mut rng);
        let stamp = Stamp::from_seconds(f64::from(k) * 40.0);
        let heading = truth.theta + 0.2;
        localizer.compass(&Compass {
            stamp,
            heading,
            field: None,
        });
        let estimate = localizer.see(stamp, &points);
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
fn without_a_compass_the_half_is_said_to_be_unknown_until_one_decides() {
    let mut localizer = localizer();
    let mut frames = drive(4, DriveConfig::default());
    for _ in 0..30 {
        let frame = frames.next().expect("endless");
        localizer.odometry(&frame.odometry);
        let estimate = localizer.see(frame.stamp, &frame.points);
        assert_eq!(estimate.mode, Mode::Global);
        assert!(!estimate.half_known && estimate.reason.is_some());
        let pose = estimate.pose.expect("a pose");
        let either =
            position_error(pose, frame.truth).min(position_error(half_turn(pose), frame.truth));
        assert!(either < 0.1, "{either}");
    }
    let mut known = None;
    for k in 0..10 {
        let frame = frames.next().expect("endless");
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        let estimate = localizer.see(frame.stamp, &frame.points);
        if estimate.mode == Mode::Tracking {
            assert!(position_error(estimate.pose.expect("a pose"), frame.truth) < 0.1);
            known = known.or(Some(k));
        }
    }
    assert!(known.is_some_and(|k| k < 5), "{known:?}");
}

#[test]
fn a_kidnapped_robot_says_lost_and_finds_itself_again() {
    let covered = DriveConfig {
        covered: 0.25,
        ..DriveConfig::default()
    };
    let mut frames = drive(5, covered);
    let mut localizer = localizer();
    for _ in 0..12 {
        for _ in 0..60 {
            let frame = frames.next().expect("endless");
            localizer.odometry(&frame.odometry);
            localizer.compass(&frame.compass);
            localizer.see(frame.stamp, &frame.points);
        }
        frames.kidnap();
        let (mut lost_after, mut found_after) = (None, None);
        for k in 0..24 {
            let frame = frames.next().expect("endless");
            localizer.odometry(&frame.odometry);
            localizer.compass(&frame.compass);
            let estimate = localizer.see(frame.stamp, &frame.points);
            if estimate.mode == Mode::Lost {
                lost_after = lost_after.or(Some(k));
            }
            if estimate
                .pose
                .is_some_and(|pose| position_error(pose, frame.truth) < 0.15)
            {
                found_after = found_after.or(Some(k));
            }
        }
        assert!(found_after.is_some(), "lost {lost_after:?}");
    }
}

#[test]
fn a_push_that_odometry_missed_is_followed() {
    let field = field();
    let mut localizer = localizer();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for k in 0..60 {
        let x = if k < 30 { 4.0 } else { 4.25 };
        let truth = Pose::new(x, 3.0, 0.5);
        let stamp = Stamp::from_seconds(f64::from(k) / 30.0);
        let heading = 0.5;
        localizer.odometry(&still(f64::from(k) / 30.0));
        localizer.compass(&Compass {
            stamp,
            heading,
            field: None,
        });
        let points = see(&field, &DriveConfig::default(), truth, &mut rng);
        let estimate = localizer.see(stamp, &points);
        if k == 29 || k > 34 {
            let pose = estimate.pose.expect("a pose");
            assert!(position_error(pose, truth) < 0.05, "frame {k}: {pose:?}");
        }
    }
}

#[test]
fn a_covered_camera_is_bridged_and_then_admitted() {
    let mut config = LocalizeConfig::default();
    config.mode.lost_std = 0.2;
    let mut localizer = Localizer::new(&field(), config);
    let mut frames = drive(7, DriveConfig::default());
    let mut before = 0.0;
    let mut said = None;
    for k in 0..30 * 40 {
        let frame = frames.next().expect("endless");
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        let covered = k >= 300;
        let points = if covered { &[][..] } else { &frame.points };
        let estimate = localizer.see(frame.stamp, points);
        let std = estimate.covariance[(0, 0)].sqrt();
        if (300..330).contains(&k) {
            assert_eq!(estimate.reason, Some(Reason::FewPoints));
            assert!(std >= before, "frame {k}");
        }
        before = std;
        if let Some(pose) = estimate.pose {
            let error = position_error(pose, frame.truth);
            assert!(k < 15 || error < 0.8, "frame {k}: off by {error}");
        } else if k > 300 {
            said = said.or(Some(k));
        }
    }
    assert!(said.is_some(), "never lost");
}

#[test]
fn the_same_samples_give_the_same_bits() {
    let run = || -> Vec<u32> {
        let mut localizer = localizer();
        drive(8, DriveConfig::default())
            .take(120)
            .flat_map(|frame| {
                localizer.odometry(&frame.odometry);
                let estimate = localizer.see(frame.stamp, &frame.points);
                let pose = estimate.pose.unwrap_or(Pose::new(0.0, 0.0, 0.0));
                [pose.x.to_bits(), pose.y.to_bits(), pose.theta.to_bits()]
            })
            .collect()
    };
    assert_eq!(run(), run());
}

#[test]
fn points_on_one_line_leave_their_direction_free() {
    let distances = DistanceField::new(&field(), &LocalizeConfig::default().distance);
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

#[test]
fn worthless_points_make_no_pose() {
    let mut localizer = localizer();
    let nan = vec![point(f32::NAN, 1.0), point(1.0, f32::INFINITY)];
    let far: Vec<_> = (0..50).map(|k| point(40.0 + k as f32, 40.0)).collect();
    let heap: Vec<_> = (0..50).map(|_| point(1.0, 1.0)).collect();
    for (k, points) in [&[][..], &nan, &far].into_iter().enumerate() {
        let estimate = localizer.see(Stamp::from_seconds(k as f64), points);
        assert_eq!((estimate.mode, estimate.pose), (Mode::Lost, None));
        assert!(estimate.covariance[(0, 0)].sqrt() > 3.0);
    }
    let estimate = localizer.see(Stamp::from_seconds(10.0), &heap);
    assert_ne!(estimate.mode, Mode::Tracking);
}

#[test]
fn a_tracked_robot_that_sees_one_line_alone_grows_unsure_along_it() {
    let field = field();
    let mut localizer = localizer();
    let truth = Pose::new(3.0, 4.0, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let mut begun = None;
    for k in 0..240 {
        let stamp = Stamp::from_seconds(f64::from(k) / 30.0);
        localizer.odometry(&still(f64::from(k) / 30.0));
        localizer.compass(&Compass {
            stamp,
            heading: 0.0,
            field: None,
        });
        let points = if k < 60 {
            see(&field, &DriveConfig::default(), truth, &mut rng)
        } else {
            // Along the touch line at y = 5.9375.
            (0..30)
                .map(|k| point(-1.5 + 0.1 * k as f32, 5.9375 - 4.0))
                .collect()
        };
        let estimate = localizer.see(stamp, &points);
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
fn points_outside_the_field_move_no_tracked_robot() {
    let mut localizer = localizer();
    let mut frames = drive(15, DriveConfig::default());
    let mut last = None;
    for k in 0..90 {
        let frame = frames.next().expect("endless");
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        let astray =
            [30.0_f32, -40.0, 60.0].map(|x| [point(x, x), point(-x, 0.5 * x), point(x, 0.0)]);
        let points = if k < 60 {
            frame.points.clone()
        } else {
            astray.as_flattened().to_vec()
        };
        let estimate = localizer.see(frame.stamp, &points);
        if k >= 60 {
            assert_ne!(estimate.reason, None, "frame {k}");
            if let Some(pose) = estimate.pose {
                assert!(position_error(pose, frame.truth) < 0.3, "frame {k}");
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
fn a_view_that_fits_several_places_is_said_to_be_ambiguous_until_the_drive_decides() {
    // Two hypotheses that one line leaves: a robot that sees nothing but a line is nowhere in particular.
    let mut localizer = localizer();
    let line: Vec<_> = (0..40).map(|k| point(-2.0 + 0.1 * k as f32, 1.5)).collect();
    for k in 0..3 {
        let stamp = Stamp::from_seconds(f64::from(k) / 30.0);
        localizer.odometry(&still(f64::from(k) / 30.0));
        let estimate = localizer.see(stamp, &line);
        assert_ne!(estimate.mode, Mode::Tracking);
        assert!(!estimate.half_known && estimate.reason.is_some());
        assert!(estimate.covariance[(0, 0)].max(estimate.covariance[(1, 1)]) > 0.5);
    }
}

#[test]
fn nan_among_good_points_changes_nothing() {
    let (mut clean, mut dirty) = (localizer(), localizer());
    for frame in drive(9, DriveConfig::default()).take(60) {
        let mut points = frame.points.clone();
        points.insert(points.len() / 2, point(f32::NAN, f32::NAN));
        clean.odometry(&frame.odometry);
        dirty.odometry(&frame.odometry);
        let a = clean.see(frame.stamp, &frame.points);
        let b = dirty.see(frame.stamp, &points);
        assert_eq!(a.pose, b.pose);
    }
}

#[test]
fn a_frame_from_the_past_is_refused_and_a_clock_set_back_is_accepted() {
    let mut localizer = localizer();
    let mut frames = drive(10, DriveConfig::default());
    let mut newest = None;
    for _ in 0..30 {
        let frame = frames.next().expect("endless");
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        newest = localizer.see(frame.stamp, &frame.points).pose;
    }
    let frame = frames.next().expect("endless");
    let early = Stamp::from_seconds(0.1);
    let estimate = localizer.see(early, &frame.points);
    assert_eq!(estimate.reason, Some(Reason::FromThePast));
    assert_eq!(estimate.pose, newest);
    let mut again = estimate;
    for k in 0..10 {
        let stamp = Stamp::from_seconds(0.2 + 0.03 * f64::from(k));
        let heading = frame.truth.theta;
        localizer.compass(&Compass {
            stamp,
            heading,
            field: None,
        });
        again = localizer.see(stamp, &frame.points);
    }
    assert_ne!(again.reason, Some(Reason::FromThePast));
    assert!(position_error(again.pose.expect("a pose"), frame.truth) < 0.1);
}

#[test]
fn a_camera_slower_than_odometry_costs_nothing() {
    let mut localizer = localizer();
    let frames: Vec<_> = drive(13, DriveConfig::default()).take(120).collect();
    for (k, now) in frames.iter().enumerate() {
        localizer.odometry(&now.odometry);
        localizer.compass(&now.compass);
        // The frame that arrives was taken two samples ago.
        let Some(frame) = k.checked_sub(2).map(|k| &frames[k]) else {
            continue;
        };
        let estimate = localizer.see(frame.stamp, &frame.points);
        if k > 30 {
            assert_eq!(estimate.mode, Mode::Tracking, "frame {k}");
            let pose = estimate.pose.expect("a pose");
            assert!(position_error(pose, frame.truth) < 0.05, "frame {k}");
        }
    }
}

#[test]
fn odometry_with_a_gap_leads_to_nothing() {
    let mut localizer = localizer();
    let mut frames = drive(11, DriveConfig::default());
    for _ in 0..30 {
        let frame = frames.next().expect("endless");
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        localizer.see(frame.stamp, &frame.points);
    }
    let frame = frames.next().expect("endless");
    localizer.odometry(&still(3.0));
    let estimate = localizer.see(Stamp::from_seconds(3.0), &frame.points);
    assert_ne!(estimate.mode, Mode::Tracking);
}

#[test]
fn a_lean_is_found_and_repaired() {
    let field = field();
    let distances = DistanceField::new(&field, &LocalizeConfig::default().distance);
    let config = LocalizeConfig::default().matching;
    let mut matcher = Matcher::new(config.clone());
    let upright = localize::matching::MatchConfig {
        lean_std_deg: 0.0,
        ..config.clone()
    };
    let mut without = Matcher::new(upright);
    let (mut with_lean, mut without_lean) = (0.0, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let height = config.viewpoint_height;
    let (a, b) = (0.5_f32.to_radians(), -0.4_f32.to_radians());
    for _ in 0..40 {
        let truth = anywhere(&field, &mut rng);
        let mut points = see(&field, &DriveConfig::default(), truth, &mut rng);
        for point in &mut points {
            // What an upright map says of a point that a leaning robot sees: the inverse of MATH.md's formula.
            let (x, y) = (point.at.x, point.at.y);
            let scale = height / (height + a * x + b * y);
            point.at = At::new(
                (x - a * height) * scale + a * a * x,
                (y - b * height) * scale + b * b * y,
            );
        }
        let start = Pose::new(truth.x + 0.03, truth.y - 0.03, truth.theta + 0.01);
        with_lean += position_error(matcher.refine(&distances, &points, start, 0.2).pose, truth);
        without_lean += position_error(without.refine(&distances, &points, start, 0.2).pose, truth);
    }
    assert!(with_lean < 0.6 * without_lean, "{with_lean} {without_lean}");
}
