//! Images whose exposure is long past when they arrive: a camera over a network, a slow driver.

use localize::sample::{Compass, Imu, Odometry};
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::{Field, LocalizeConfig, Localizer, Mode, Pose, Stamp, math};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// A drive whose velocity and turns change all the time.
fn pose_at(time: f64) -> Pose {
    let time = time as f32;
    Pose::new(
        3.0 * math::sin(0.6 * time),
        2.0 * math::sin(0.9 * time),
        1.5 * math::sin(0.8 * time) + 0.3 * time,
    )
}

/// Reading of an inertial unit at the robot's centre.
fn imu_at(stamp: Stamp, time: f64) -> Imu {
    const STEP: f64 = 0.02;
    let [before, at, after] = [-STEP, 0.0, STEP].map(|shift| pose_at(time + shift));
    let change =
        |before: f32, at: f32, after: f32| f64::from(before - 2.0 * at + after) / (STEP * STEP);
    let (x, y) = (
        change(before.x, at.x, after.x) as f32,
        change(before.y, at.y, after.y) as f32,
    );
    let (sin, cos) = math::sin_cos(at.theta);
    Imu {
        stamp,
        specific_force: [cos * x + sin * y, cos * y - sin * x, 9.806_65],
        angular_velocity: [0.0, 0.0, (after.theta - before.theta) / (2.0 * STEP) as f32],
    }
}

/// What an image says about its time.
struct Judged {
    tracked: usize,
    images: usize,
    /// Tracked images that are off by more than 3σ and 2 cm.
    wrong: usize,
    largest: f32,
}

/// Twelve seconds from a lost pose on, wheels and compass at 100 Hz, an image with every fifth; `given`: the pose is told at the start.
fn drive(latency: f64, imu: bool, given: bool) -> Judged {
    let config = LocalizeConfig::default();
    drive_with(config, latency, imu, given, &[Mode::Tracking])
}

/// As [`drive`], with other settings; poses of these modes are judged.
fn drive_with(
    mut config: LocalizeConfig,
    latency: f64,
    imu: bool,
    given: bool,
    modes: &[Mode],
) -> Judged {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    config.filter.camera_latency = latency as f32;
    let mut localizer = Localizer::new(&field, config);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let camera = SyntheticDriveConfig::default();
    let mut judged = Judged {
        tracked: 0,
        images: 0,
        wrong: 0,
        largest: 0.0,
    };
    for k in 1..1200 {
        let time = 2.0 + 0.01 * f64::from(k);
        let stamp = Stamp::from_seconds(time);
        let step = pose_at(time - 0.01).inverse() * pose_at(time);
        if imu {
            localizer.add_imu(&imu_at(stamp, time));
        }
        localizer.add_odometry(&Odometry {
            stamp,
            dx: step.x,
            dy: step.y,
            dtheta: step.theta,
            slip: 0.0,
        });
        localizer.add_compass(&Compass {
            stamp,
            heading: pose_at(time).theta + 0.1 * math::sin(2.4 * k as f32),
            magnetic_field: None,
        });
        if given && k == 100 {
            let covariance = nalgebra::Matrix3::identity() * 1e-4;
            localizer.set_pose(stamp, pose_at(time), &covariance);
        }
        if k % 5 != 0 || given && k < 100 {
            continue;
        }
        let points = simulate_line_points(&field, &camera, pose_at(time - latency), &mut rng);
        let estimate = localizer.process_points(stamp, &points);
        // The first images were exposed before anything was measured.
        if time - latency < 2.1 {
            continue;
        }
        judged.images += 1;
        let Some(pose) = estimate.pose.filter(|_| modes.contains(&estimate.mode)) else {
            continue;
        };
        judged.tracked += 1;
        let off = pose.difference(pose_at(time));
        let distance = math::hypot(off.x, off.y);
        let std = (estimate.covariance[(0, 0)] + estimate.covariance[(1, 1)]).sqrt();
        judged.largest = judged.largest.max(distance);
        judged.wrong += usize::from(distance > 0.02 + 3.0 * std);
    }
    judged
}

#[test]
fn images_that_are_late_by_up_to_a_second_tell_the_present_pose_from_the_first_ones_on() {
    for latency in [0.0, 0.1, 0.4, 0.9] {
        for imu in [false, true] {
            let judged = drive(latency, imu, false);
            assert!(
                judged.wrong == 0 && judged.largest < 0.12 && judged.tracked + 6 > judged.images,
                "latency {latency}, inertial unit {imu}: {} of {} wrong, up to {} m, {} images",
                judged.wrong,
                judged.tracked,
                judged.largest,
                judged.images
            );
        }
    }
}

#[test]
fn poses_that_are_never_decided_are_those_of_the_stamp_too() {
    for latency in [0.0, 0.1, 0.4] {
        let mut config = LocalizeConfig::default();
        // No candidate is ever probable enough.
        config.mode.decision_probability = 1.000_001;
        let judged = drive_with(config, latency, false, false, &[Mode::Global]);
        assert!(
            judged.largest < 0.12 && judged.tracked + 6 > judged.images,
            "latency {latency}: {} judged, up to {} m, {} images",
            judged.tracked,
            judged.largest,
            judged.images
        );
    }
}

#[test]
fn pose_that_was_told_outlives_the_images_exposed_before() {
    let judged = drive(0.4, false, true);
    assert!(
        judged.wrong == 0 && judged.largest < 0.12 && judged.tracked + 12 > judged.images,
        "{} of {} wrong, up to {} m, {} images",
        judged.wrong,
        judged.tracked,
        judged.largest,
        judged.images
    );
}
