//! Images of another time than the wheels and the inertial unit: of a driver that repeats old ones. The robot must not be sure of a pose by
//! them.

use localize::global_search::branch_and_bound::half_turn;
use localize::sample::{Imu, Odometry};
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::{Field, LocalizeConfig, Localizer, Pose, Stamp, math};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// What goes wrong from the eighth second to the eleventh.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    Frozen,
    /// Two images in turns.
    Alternating,
    /// The robot is held and its wheels spin.
    Held,
}

const BEGIN: f64 = 8.0;
const END: f64 = 11.0;

/// A drive whose velocity and turns change all the time. A robot that is held stands from the beginning of the fault on.
fn pose_at(time: f64, fault: Fault) -> Pose {
    let held = (time.min(END) - BEGIN).max(0.0);
    let time = match fault {
        Fault::Held => time - held,
        _ => time,
    };
    let time = time as f32;
    Pose::new(
        3.0 * math::sin(0.6 * time),
        2.0 * math::sin(0.9 * time),
        1.5 * math::sin(0.8 * time) + 0.3 * time,
    )
}

#[derive(Debug, Default)]
struct Judged {
    images: usize,
    /// Of a pose that is off by more than 4σ and 10 cm.
    wrong: usize,
    /// The largest of these errors over its standard deviation.
    worst: f32,
    /// Largest standard deviation of a pose during the fault, and two seconds after it.
    std: [f32; 2],
    /// Largest error two seconds after it.
    error_after: f32,
}

fn drive(fault: Fault) -> Judged {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    let mut localizer = Localizer::new(&field, LocalizeConfig::default());
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let camera = SyntheticDriveConfig::default();
    let mut judged = Judged::default();
    for k in 1..1500 {
        let time = 0.01 * f64::from(k);
        let stamp = Stamp::from_seconds(time);
        let faulty = (BEGIN..END).contains(&time);
        let real = |time: f64| pose_at(time, fault);
        let turned = (real(time).theta - real(time - 0.01).theta) / 0.01;
        localizer.add_imu(&Imu {
            stamp,
            specific_force: [0.0, 0.0, 9.806_65],
            angular_velocity: [0.0, 0.0, turned],
        });
        let step = match fault {
            Fault::Held if faulty => Pose::new(0.0, 0.0, 0.0).inverse() * Pose::new(0.01, 0.0, 0.0),
            _ => real(time - 0.01).inverse() * real(time),
        };
        localizer.add_odometry(&Odometry {
            stamp,
            dx: step.x,
            dy: step.y,
            dtheta: step.theta,
            slip: 0.0,
        });
        if k == 1 {
            let covariance = nalgebra::Matrix3::identity() * 1e-4;
            localizer.set_pose(stamp, real(time), &covariance);
        }
        if k % 4 != 0 {
            continue;
        }
        let shown = match fault {
            Fault::Frozen if faulty => BEGIN,
            Fault::Alternating if faulty => BEGIN - f64::from(k % 8) / 4.0 * 0.04,
            _ => time,
        };
        let points = simulate_line_points(&field, &camera, real(shown), &mut rng);
        let estimate = localizer.process_points(stamp, &points);
        let Some(pose) = estimate.pose else { continue };
        let off = |pose: Pose| {
            let off = pose.difference(real(time));
            math::hypot(off.x, off.y)
        };
        let distance = if estimate.half_known {
            off(pose)
        } else {
            off(pose).min(off(half_turn(pose)))
        };
        let std = (estimate.covariance[(0, 0)] + estimate.covariance[(1, 1)]).sqrt();
        judged.images += 1;
        if distance > 0.1 + 4.0 * std {
            judged.wrong += 1;
            judged.worst = judged.worst.max(distance / std);
        }
        if faulty {
            judged.std[0] = judged.std[0].max(std);
        } else if time > END + 2.0 {
            judged.std[1] = judged.std[1].max(std);
            judged.error_after = judged.error_after.max(distance);
        }
    }
    judged
}

#[test]
fn images_that_the_gyro_contradicts_make_no_sure_pose_and_good_ones_end_the_doubt() {
    for fault in [Fault::Frozen, Fault::Alternating] {
        let judged = drive(fault);
        println!("{fault:?}: {judged:?}");
        assert!(judged.wrong <= 2, "{fault:?}: {judged:?}");
        assert!(
            judged.error_after < 0.1 && judged.std[1] < 0.1,
            "{fault:?}: {judged:?}"
        );
    }
}

#[test]
fn robot_that_is_held_while_its_wheels_spin_knows_its_place() {
    let judged = drive(Fault::Held);
    println!("{judged:?}");
    assert_eq!(judged.wrong, 0, "{judged:?}");
    assert!(judged.std[0] < 0.1, "{judged:?}");
}
