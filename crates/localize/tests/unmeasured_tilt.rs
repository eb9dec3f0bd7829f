//! A robot that rocks beside an inertial unit that measures its turns alone: the images tell the tilt.

use localize::robot::DEFAULT_VIEWPOINT_HEIGHT;
use localize::sample::{Imu, Odometry};
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::tilt::map_from_ground;
use localize::{At, Field, LocalizeConfig, Localizer, Pose, Stamp, math};
use nalgebra::Matrix3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

const SPEED: f64 = 1.2;
const TURN_RATE: f64 = 0.6;
/// Readings of the inertial unit and the wheels, per second.
const RATE: u32 = 90;

/// On a circle of 2 m about the field's centre.
fn pose_at(time: f64) -> Pose {
    let (heading, radius) = (TURN_RATE * time, SPEED / TURN_RATE);
    let (sin, cos) = math::sin_cos(heading as f32);
    Pose::new(radius as f32 * sin, -radius as f32 * cos, heading as f32)
}

/// Degrees, about 2 Hz.
fn tilt_at(time: f64, amplitude_deg: f64) -> [f32; 2] {
    let wave = |rate: f64, phase: f64| (amplitude_deg * math::sin(rate * time + phase)) as f32;
    [wave(12.7, 0.0), wave(11.3, 1.0)].map(f32::to_radians)
}

/// Largest and median position error after two seconds, metres, and the share of poses beyond four standard deviations, of a robot
/// that rocks from `onset` on, seconds.
fn drive(images_every: u32, amplitude_deg: f64, onset: f64) -> [f32; 3] {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    let mut localizer = Localizer::new(&field, LocalizeConfig::default());
    let known = Matrix3::from_diagonal_element(1e-4);
    localizer.set_pose(Stamp::from_seconds(0.0), pose_at(0.0), &known);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let config = SyntheticDriveConfig::default();
    let (mut errors, mut beyond) = (Vec::new(), 0.0);
    for k in 1..20 * RATE {
        let time = f64::from(k) / f64::from(RATE);
        let stamp = Stamp::from_seconds(time);
        // Level, with the acceleration towards the circle's centre.
        localizer.add_imu(&Imu {
            stamp,
            specific_force: [0.0, (SPEED * TURN_RATE) as f32, 9.81],
            angular_velocity: [0.0, 0.0, TURN_RATE as f32],
        });
        localizer.add_odometry(&Odometry {
            stamp,
            dx: (SPEED / f64::from(RATE)) as f32,
            dy: 0.0,
            dtheta: (TURN_RATE / f64::from(RATE)) as f32,
            slip: 0.0,
        });
        if !k.is_multiple_of(images_every) {
            continue;
        }
        let truth = pose_at(time);
        let mut points = simulate_line_points(&field, &config, truth, &mut rng);
        let tilt = tilt_at(time, if time < onset { 0.0 } else { amplitude_deg });
        points.retain_mut(|point| {
            let ground = [point.at.x, point.at.y];
            let seen = map_from_ground(ground, tilt, DEFAULT_VIEWPOINT_HEIGHT);
            seen.is_some_and(|[x, y]| {
                point.at = At::new(x, y);
                x * x + y * y < 64.0
            })
        });
        let estimate = localizer.process_points(stamp, &points);
        if time < 2.0 {
            continue;
        }
        let pose = estimate.pose.expect("tracked");
        let [x, y, _] = pose.difference(truth).into();
        let variances = [0, 1].map(|i| estimate.covariance[(i, i)]);
        let is_beyond = [x, y].iter().zip(variances).any(|(e, v)| e * e > 16.0 * v);
        beyond += f32::from(u8::from(is_beyond));
        errors.push(math::hypot(x, y));
    }
    errors.sort_by(f32::total_cmp);
    let count = errors.len();
    [errors[count - 1], errors[count / 2], beyond / count as f32]
}

#[test]
fn rocking_that_the_inertial_unit_does_not_report_hardly_moves_the_pose() {
    for images_every in [3, 9] {
        for onset in [0.0, 8.0] {
            for amplitude_deg in [0.3, 0.6, 1.0, 1.5, 2.0] {
                let [largest, median, beyond] = drive(images_every, amplitude_deg, onset);
                assert!(
                    largest < 0.03 && median < 0.01 && beyond == 0.0,
                    "images every {images_every}, {amplitude_deg} degrees from {onset} s: {largest} m, {median} m, {beyond}"
                );
            }
        }
    }
}
