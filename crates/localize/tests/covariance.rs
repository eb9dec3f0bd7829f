//! Whatever a robot sees, its covariance is one: finite, positive definite, and no larger than that of an unknown place.

use localize::field::FieldConfig;
use localize::sample::{LinePoint, Odometry};
use localize::{At, Field, LocalizeConfig, Localizer, Pose, Stamp, math};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Lines of a field of 9 x 6 m: from, to.
type Lines = &'static [[f32; 4]];

const PARALLEL: Lines = &[
    [-5.0, -3.0, 5.0, -3.0],
    [-5.0, -1.0, 5.0, -1.0],
    [-5.0, 2.0, 5.0, 2.0],
];
const CORNER: Lines = &[[-4.5, -3.0, 4.5, -3.0], [-4.5, -3.0, -4.5, 3.0]];
const ODD: Lines = &[
    [-4.5, -3.0, 4.5, -3.0],
    [-4.5, 3.0, 4.5, 3.0],
    [-4.5, -3.0, -4.5, 3.0],
    [4.5, -3.0, 4.5, 3.0],
    [1.0, -3.0, 2.0, 3.0],
    [-4.5, 1.0, -2.0, 1.0],
    [-2.0, 1.0, -2.0, -1.0],
];

struct World {
    lines: Lines,
    rng: ChaCha8Rng,
}

impl World {
    fn uniform(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * (self.rng.next_u32() as f32 / u32::MAX as f32)
    }

    fn normal(&mut self, std: f32) -> f32 {
        let sum: f32 = (0..12).map(|_| self.uniform(-0.5, 0.5)).sum();
        std * sum
    }

    /// Points of the lines' centres within the range, evenly along them, robot frame.
    fn points(&mut self, pose: Pose, range: f32, count: usize) -> Vec<LinePoint> {
        let lengths: Vec<f32> = self
            .lines
            .iter()
            .map(|[x, y, to_x, to_y]| math::hypot(to_x - x, to_y - y))
            .collect();
        let total: f32 = lengths.iter().sum();
        let mut points = Vec::new();
        for _ in 0..40 * count {
            let mut along = self.uniform(0.0, total);
            let mut line = 0;
            while line + 1 < lengths.len() && along > lengths[line] {
                along -= lengths[line];
                line += 1;
            }
            let [x, y, to_x, to_y] = self.lines[line];
            let share = (along / lengths[line]).min(1.0);
            let seen = pose.inverse() * At::new(x + share * (to_x - x), y + share * (to_y - y));
            if seen.distance() < range && points.len() < count {
                points.push(LinePoint {
                    at: At::new(seen.x + self.normal(0.02), seen.y + self.normal(0.02)),
                    std_radial: 0.03,
                    std_tangential: 0.03,
                });
            }
        }
        points
    }
}

/// Drives of 20 s or a minute at random speeds, from a lost pose on.
fn check(name: &str, lines: Lines, range: f32) {
    let config = FieldConfig {
        extra_lines: lines.to_vec(),
        ..FieldConfig::without_markings([9.0, 6.0], 0.05, 1.0)
    };
    let field = Field::new(config).expect("a field");
    for seed in [0, 1, 42] {
        let rate = if seed % 2 == 0 { 3.0 } else { 10.0 };
        let mut world = World {
            lines,
            rng: ChaCha8Rng::seed_from_u64(seed),
        };
        let mut localizer = Localizer::new(&field, LocalizeConfig::default());
        let mut pose = Pose::new(
            world.uniform(-2.0, 2.0),
            world.uniform(-1.5, 1.5),
            world.uniform(-3.0, 3.0),
        );
        let mut velocity = [0.0_f32; 3];
        for image in 0..180 {
            let stamp = Stamp::from_seconds(1.0 + f64::from(image) / rate);
            for (velocity, std) in velocity.iter_mut().zip([0.12, 0.12, 0.15]) {
                *velocity = 0.95 * *velocity + world.normal(std);
            }
            let home = if math::hypot(pose.x, pose.y) > 2.0 {
                0.3
            } else {
                0.0
            };
            let (sin, cos) = math::sin_cos(pose.theta);
            let [forward, left, turn] = velocity;
            let step = [
                forward - home * (cos * pose.x + sin * pose.y),
                left - home * (cos * pose.y - sin * pose.x),
                turn,
            ]
            .map(|v| v / rate as f32);
            pose = pose * localize::frames::Tf::new(step[0], step[1], step[2]);
            let [dx, dy, dtheta] = step.map(|part| part * (1.0 + world.normal(0.03)));
            localizer.add_odometry(&Odometry {
                stamp,
                dx,
                dy,
                dtheta,
                slip: 0.0,
            });
            let estimate = localizer.process_points(stamp, &world.points(pose, range, 60));
            let covariance = estimate.covariance;
            let case = format!(
                "{name}, {range} m, seed {seed}, image {image}: {:?}",
                estimate.mode
            );
            assert!(
                covariance.iter().all(|value| value.is_finite()),
                "{case}: {covariance}"
            );
            assert!(
                covariance.map(f64::from).cholesky().is_some(),
                "{case}: {covariance}"
            );
            let largest = covariance[(0, 0)].max(covariance[(1, 1)]);
            assert!(largest < 45.0 * 45.0, "{case}: {covariance}");
        }
    }
}

#[test]
fn covariance_is_one_on_sparse_fields_too() {
    for range in [1.5, 2.0, 6.0] {
        check("parallel lines", PARALLEL, range);
        check("a corner", CORNER, range);
        check("odd lines", ODD, range);
    }
}
