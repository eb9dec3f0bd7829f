//! How often does a robot that starts anywhere claim a wrong place? `cargo run --release -p localize --example cold_starts -- [SEEDS] [SECONDS]`.
//!
//! Points lie evenly along the markings in sight, a tenth is clutter, and a part of the directions may be hidden. The
//! generator shares nothing with `synthetic`, which casts rays.

use std::f32::consts::{PI, TAU};

use localize::field::marking_points;
use localize::math;
use localize::sample::{Compass, LinePoint, Odometry};
use localize::{At, Field, LocalizeConfig, Localizer, Mode, Pose, Stamp};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

/// Spacing of the markings' points, metres.
const SPACING: f32 = 0.01;
const RATE: f32 = 20.0;
const POINTS_MAX: usize = 113;
const POINT_STD: f32 = 0.04;
const CLUTTER_SHARE: f32 = 0.1;
const COMPASS_STD: f32 = 0.13;
const TURN_RATE: f32 = 0.4;
/// A claim is wrong beyond this error (metres) and three standard deviations.
const WRONG_DISTANCE: f32 = 0.3;

struct Conditions {
    sight: f32,
    speed: f32,
    /// Angle that is hidden, radians.
    hidden: f32,
    has_compass: bool,
}

#[derive(Default)]
struct Counts {
    images: usize,
    wrong: usize,
    tracked: usize,
    wrong_starts: usize,
    wrong_at_end: usize,
    time_to_track: Vec<f32>,
}

fn main() {
    let number = |k: usize, default: f32| {
        std::env::args()
            .nth(k)
            .and_then(|text| text.parse().ok())
            .unwrap_or(default)
    };
    let (seeds, seconds) = (number(1, 40.0) as u64, number(2, 4.0));
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    let base = Localizer::new(&field, LocalizeConfig::default());
    let markings: Vec<[f32; 2]> = marking_points(&field.markings, SPACING)
        .iter()
        .map(|at| [at.x, at.y])
        .collect();
    println!(
        "sight, motion, hidden, compass: images at a wrong place, starts with one, starts that end so, images tracked, median time to track"
    );
    for sight in [2.0, 3.0, 5.0] {
        for speed in [0.0, 1.0] {
            for hidden in [0.0, 2.0] {
                for has_compass in [true, false] {
                    let conditions = Conditions {
                        sight,
                        speed,
                        hidden,
                        has_compass,
                    };
                    let mut counts = Counts::default();
                    for seed in 0..seeds {
                        start(
                            &base,
                            &markings,
                            &conditions,
                            seed,
                            (seconds * RATE) as usize,
                            &mut counts,
                        );
                    }
                    print(&conditions, counts);
                }
            }
        }
    }
}

fn print(conditions: &Conditions, mut counts: Counts) {
    let share = |part: usize| 100.0 * part as f32 / counts.images.max(1) as f32;
    let (wrong, tracked) = (share(counts.wrong), share(counts.tracked));
    counts.time_to_track.sort_by(f32::total_cmp);
    let median = counts.time_to_track.get(counts.time_to_track.len() / 2);
    println!(
        "{} m, {} m/s, {:3.0}°, {:7}: {wrong:5.1} %, {:2}, {:2}, {tracked:5.1} %, {:.2} s of {}",
        conditions.sight,
        conditions.speed,
        conditions.hidden.to_degrees(),
        if conditions.has_compass {
            "compass"
        } else {
            "none"
        },
        counts.wrong_starts,
        counts.wrong_at_end,
        median.copied().unwrap_or(f32::NAN),
        counts.time_to_track.len(),
    );
}

/// One start at the place of a seed.
fn start(
    base: &Localizer,
    markings: &[[f32; 2]],
    conditions: &Conditions,
    seed: u64,
    images: usize,
    counts: &mut Counts,
) {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut localizer = base.clone();
    let mut within = |half: f32| rng.random_range(-half..half);
    let (mut x, mut y, mut theta) = (within(8.0), within(5.0), within(PI));
    let mut goal = [within(7.0), within(5.0)];
    let hidden_from = within(PI);
    let (mut is_wrong, mut was_wrong, mut tracked_at) = (false, false, None);
    for image in 0..images {
        let stamp = Stamp::from_seconds(f64::from(image as f32 / RATE));
        let (dx, dy, turn) = match image {
            0 => (0.0, 0.0, 0.0),
            _ if conditions.speed == 0.0 => (0.0, 0.0, 0.0),
            _ => {
                let step = conditions.speed / RATE;
                if math::hypot(goal[0] - x, goal[1] - y) < 0.3 {
                    goal = [rng.random_range(-7.0..7.0), rng.random_range(-5.0..5.0)];
                }
                let distance = math::hypot(goal[0] - x, goal[1] - y);
                (
                    step * (goal[0] - x) / distance,
                    step * (goal[1] - y) / distance,
                    TURN_RATE / RATE,
                )
            }
        };
        let (sin, cos) = math::sin_cos(theta);
        let mut noisy = |value: f32| 1.01 * value + 0.0005 * normal(&mut rng);
        let odometry = Odometry {
            stamp,
            dx: noisy(cos * dx + sin * dy),
            dy: noisy(cos * dy - sin * dx),
            dtheta: noisy(turn),
            slip: 0.0,
        };
        localizer.add_odometry(&odometry);
        (x, y, theta) = (x + dx, y + dy, theta + turn);
        if conditions.has_compass {
            let heading = theta + COMPASS_STD * normal(&mut rng);
            localizer.add_compass(&Compass {
                stamp,
                heading,
                magnetic_field: None,
            });
        }
        let points = line_points(markings, [x, y, theta], conditions, hidden_from, &mut rng);
        let estimate = localizer.process_points(stamp, &points);
        counts.images += 1;
        let Some(pose) = estimate.pose else {
            is_wrong = false;
            continue;
        };
        let off = |pose: Pose| math::hypot(pose.x - x, pose.y - y);
        let half_turned = Pose::new(-pose.x, -pose.y, pose.theta);
        let error = if conditions.has_compass {
            off(pose)
        } else {
            off(pose).min(off(half_turned))
        };
        let std = (estimate.covariance[(0, 0)] + estimate.covariance[(1, 1)]).sqrt();
        is_wrong = error > WRONG_DISTANCE && error > 3.0 * std;
        was_wrong |= is_wrong;
        counts.wrong += usize::from(is_wrong);
        let tracks = estimate.mode == Mode::Tracking || !localizer.has_several_hypotheses();
        counts.tracked += usize::from(tracks);
        if tracks {
            tracked_at.get_or_insert(image as f32 / RATE);
        }
    }
    counts.wrong_starts += usize::from(was_wrong);
    counts.wrong_at_end += usize::from(is_wrong);
    counts.time_to_track.extend(tracked_at);
}

fn line_points(
    markings: &[[f32; 2]],
    [x, y, theta]: [f32; 3],
    conditions: &Conditions,
    hidden_from: f32,
    rng: &mut Xoshiro256PlusPlus,
) -> Vec<LinePoint> {
    let (sin, cos) = math::sin_cos(theta);
    let in_sight: Vec<[f32; 2]> = markings
        .iter()
        .map(|[mx, my]| {
            [
                cos * (mx - x) + sin * (my - y),
                cos * (my - y) - sin * (mx - x),
            ]
        })
        .filter(|[px, py]| {
            let angle = (math::atan2(*py, *px) - hidden_from).rem_euclid(TAU);
            math::hypot(*px, *py) < conditions.sight && angle >= conditions.hidden
        })
        .collect();
    let count = if in_sight.is_empty() { 0 } else { POINTS_MAX };
    let point = |_| {
        let at = if rng.random::<f32>() < CLUTTER_SHARE {
            let (range, angle) = (
                rng.random_range(0.5..conditions.sight),
                rng.random_range(-PI..PI),
            );
            [range * math::cos(angle), range * math::sin(angle)]
        } else {
            let [px, py] = in_sight[rng.random_range(0..in_sight.len())];
            [px + POINT_STD * normal(rng), py + POINT_STD * normal(rng)]
        };
        LinePoint {
            at: At::new(at[0], at[1]),
            std_radial: POINT_STD,
            std_tangential: POINT_STD,
        }
    };
    (0..count).map(point).collect()
}

fn normal(rng: &mut Xoshiro256PlusPlus) -> f32 {
    let uniform: f32 = (0..12).map(|_| rng.random::<f32>()).sum();
    uniform - 6.0
}
