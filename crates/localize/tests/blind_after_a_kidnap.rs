//! A robot is carried away, and after the first images of the new place none can be used: it may not be sure of the old place again.

use localize::sample::{Compass, Odometry};
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::{Field, LocalizeConfig, Localizer, Pose, Stamp, math};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// When the robot is carried, and the images of the new place until none is usable.
const CARRIED: f64 = 6.0;
const IMAGES_SHOWN: u32 = 3;

fn pose_at(time: f64) -> Pose {
    let t = time as f32;
    let (x, y, theta) = (1.5 * math::sin(0.5 * t), math::sin(0.8 * t), 0.6 * t);
    if time < CARRIED {
        Pose::new(x - 4.0, y + 1.5, theta)
    } else {
        Pose::new(x + 3.0, y - 2.5, theta + 2.0)
    }
}

#[test]
fn suspicion_lasts_while_images_show_nothing() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    let mut localizer = Localizer::new(&field, LocalizeConfig::default());
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let camera = SyntheticDriveConfig::default();
    let (mut shown, mut blind) = (0, 0);
    for k in 1..900 {
        let time = 0.01 * f64::from(k);
        let stamp = Stamp::from_seconds(time);
        let before = pose_at(time - 0.01);
        let is_carried = (time - 0.01 < CARRIED) != (time < CARRIED);
        let step = if is_carried {
            before.inverse() * before
        } else {
            before.inverse() * pose_at(time)
        };
        localizer.add_odometry(&Odometry {
            stamp,
            dx: step.x,
            dy: step.y,
            dtheta: step.theta,
            slip: 0.0,
        });
        localizer.add_compass(&Compass {
            stamp,
            heading: pose_at(time).theta + (0.05 * math::sin(0.37 * time * 100.0)) as f32,
            magnetic_field: None,
        });
        if k % 4 != 0 {
            continue;
        }
        let is_shown = time < CARRIED || shown < IMAGES_SHOWN;
        shown += u32::from(time >= CARRIED && is_shown);
        let points = if is_shown {
            simulate_line_points(&field, &camera, pose_at(time), &mut rng)
        } else {
            blind += 1;
            Vec::new()
        };
        let estimate = localizer.process_points(stamp, &points);
        let Some(pose) = estimate.pose else { continue };
        let off = pose.difference(pose_at(time));
        let error = math::hypot(off.x, off.y);
        let std = (estimate.covariance[(0, 0)] + estimate.covariance[(1, 1)]).sqrt();
        assert!(
            time < 1.0 || error < 0.1 + 4.0 * std,
            "{time}: {error} m off, stated {std}, {:?}",
            estimate.reason
        );
    }
    assert!(blind > 50, "{blind} images without points");
}
