//! A robot carried to its mirrored place: the markings look the same, only the compass can tell.

use localize::sample::{Compass, Imu, Odometry};
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::{Field, LocalizeConfig, Localizer, Pose, Stamp};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

const TURN_RATE: f64 = 0.7;
const TELEPORT: f64 = 12.0;

fn pose_at(time: f64) -> Pose {
    let heading = TURN_RATE * time;
    if time < TELEPORT {
        Pose::new(3.0, 2.0, heading as f32)
    } else {
        Pose::new(-3.0, -2.0, (heading + std::f64::consts::PI) as f32)
    }
}

/// Times after the teleport: until the half counts as unknown, and from which on the pose is right; seconds.
fn recover(imu: bool, latency: f64) -> (f64, f64) {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    let mut config = LocalizeConfig::default();
    config.filter.camera_latency = latency as f32;
    let mut localizer = Localizer::new(&field, config);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let drive = SyntheticDriveConfig::default();
    let (mut unknown, mut wrong) = (f64::INFINITY, 0.0);
    // Readings of inertial unit, wheels and compass at 90 Hz, an image with every third.
    for k in 1..(90.0 * (TELEPORT + 10.0)) as u32 {
        let (dt, time) = (1.0 / 90.0, f64::from(k) / 90.0);
        let stamp = Stamp::from_seconds(time);
        if imu {
            localizer.add_imu(&Imu {
                stamp,
                specific_force: [0.0, 0.0, 9.806_65],
                angular_velocity: [0.0, 0.0, TURN_RATE as f32],
            });
        }
        localizer.add_odometry(&Odometry {
            stamp,
            dx: 0.0,
            dy: 0.0,
            dtheta: (TURN_RATE * dt) as f32,
            slip: 0.0,
        });
        let noise = 0.1 * localize::math::sin(2.4 * f64::from(k));
        localizer.add_compass(&Compass {
            stamp,
            heading: pose_at(time).theta + noise as f32,
            magnetic_field: None,
        });
        if k % 3 != 0 {
            continue;
        }
        let points = simulate_line_points(&field, &drive, pose_at(time - latency), &mut rng);
        let estimate = localizer.process_points(stamp, &points);
        let after = time - latency - TELEPORT;
        let truth = pose_at(time);
        let right = estimate
            .pose
            .is_some_and(|pose| pose.origin().distance_to(truth.origin()) < 0.3);
        if time < TELEPORT {
            assert!(time < 2.0 || right && estimate.half_known, "{time}");
        }
        if after <= 0.0 {
            continue;
        }
        if !estimate.half_known {
            unknown = f64::min(unknown, after);
        }
        if !right {
            wrong = after;
            assert!(
                !estimate.half_known || after < 0.5,
                "sure of the wrong half at {after}"
            );
        }
    }
    (unknown, wrong)
}

#[test]
fn mirrored_place_is_noticed_at_once_and_left_within_4_seconds() {
    for imu in [false, true] {
        for latency in [0.0, 0.03] {
            let (unknown, wrong) = recover(imu, latency);
            assert!(
                unknown < 0.5 && wrong < 4.0,
                "inertial unit {imu}, latency {latency}: unknown after {unknown}, wrong until {wrong}"
            );
        }
    }
}
