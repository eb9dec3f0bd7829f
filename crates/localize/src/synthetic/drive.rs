//! What would a robot see and feel on a known drive? Line points, odometry and compass with truth, from one seed.
//!
//! Made for judging localisation alone, without images: rays from the robot meet the markings, with errors, outliers
//! and covered sectors as stated; odometry has a wrong scale. Used by the benches, `eval` and the tests.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::field::ray::intersect_ray;
use crate::frames::{At, Pose, wrap_angle};
use crate::random::standard_normal;
use crate::sample::{Compass, LinePoint, Odometry};
use crate::stamp::Stamp;

/// How a drive looks and how badly it is sensed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SyntheticDriveConfig {
    /// Frames per second.
    pub frame_rate: f32,
    /// Usual speed, m/s.
    pub speed: f32,
    /// Usual rate of turn, rad/s.
    pub yaw_rate: f32,
    /// Rays, evenly around the robot.
    pub rays: usize,
    /// Most markings met per ray.
    pub hits_per_ray: usize,
    /// Nearest distance at which markings are seen (the robot's own body covers what is nearer), metres.
    pub range_min: f32,
    /// Farthest, metres.
    pub range_max: f32,
    /// Standard deviation of a point at the robot and at 5 m, metres; linear in between and beyond.
    pub point_std: [f32; 2],
    /// Share of points that are something else, anywhere along their ray.
    pub outlier_share: f32,
    /// Share of the circle that is covered, in `covered_sectors` equal parts evenly around.
    pub occluded_share: f32,
    /// Number of covered sectors.
    pub occluded_sectors: usize,
    /// By how much odometry reports too much way and turn.
    pub odometry_scale_error: f32,
    /// Random part of each report, share of the motion.
    pub odometry_noise: f32,
    /// Noise of the compass, degrees.
    pub compass_std_deg: f32,
}

impl Default for SyntheticDriveConfig {
    fn default() -> Self {
        SyntheticDriveConfig {
            frame_rate: 30.0,
            speed: 1.5,
            yaw_rate: 0.6,
            rays: 120,
            hits_per_ray: 2,
            range_min: 0.35,
            range_max: 5.0,
            point_std: [0.03, 0.05],
            outlier_share: 0.1,
            occluded_share: 0.0,
            occluded_sectors: 2,
            odometry_scale_error: 0.03,
            odometry_noise: 0.05,
            compass_std_deg: 10.0,
        }
    }
}

/// One frame of a drive, with the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticSample {
    /// When.
    pub stamp: Stamp,
    /// Where the robot really is.
    pub true_pose: Pose,
    /// Motion since the frame before, as the wheels report it.
    pub odometry: Odometry,
    /// As the compass reports it.
    pub compass: Compass,
    /// As vision reports them.
    pub points: Vec<LinePoint>,
}

/// A robot driving about, frame by frame, without end.
#[derive(Debug, Clone)]
pub struct SyntheticDrive<R> {
    field: Field,
    config: SyntheticDriveConfig,
    rng: R,
    pose: Pose,
    /// Velocity in the field frame and rate of turn.
    velocity: [f32; 3],
    index: i64,
}

impl<R: Rng> SyntheticDrive<R> {
    /// Starts at a random pose of the field.
    pub fn new(field: &Field, config: SyntheticDriveConfig, mut rng: R) -> Self {
        let pose = random_pose(field, &mut rng);
        SyntheticDrive {
            field: field.clone(),
            config,
            rng,
            pose,
            velocity: [0.0; 3],
            index: 0,
        }
    }

    /// Carries the robot to a random pose without its wheels noticing.
    pub fn kidnap(&mut self) {
        self.pose = random_pose(&self.field, &mut self.rng);
        self.velocity = [0.0; 3];
    }

    /// What is sensed at `pose`.
    pub fn observe(&mut self, pose: Pose) -> Vec<LinePoint> {
        simulate_line_points(&self.field, &self.config, pose, &mut self.rng)
    }

    /// The configuration; may be changed while driving.
    pub fn config_mut(&mut self) -> &mut SyntheticDriveConfig {
        &mut self.config
    }

    fn step(&mut self) -> [f32; 3] {
        let dt = 1.0 / self.config.frame_rate;
        // A first-order random walk of the velocity with a second's memory, drawn to the middle near the edge.
        let keep = (-dt).exp();
        let kick = (1.0 - keep * keep).sqrt();
        let (half_x, half_y) = (self.field.length / 2.0, self.field.width / 2.0);
        let spread = [self.config.speed, self.config.speed, self.config.yaw_rate];
        for (value, spread) in self.velocity.iter_mut().zip(spread) {
            *value = keep * *value + kick * spread * standard_normal(&mut self.rng);
        }
        for (k, at, half) in [(0, self.pose.x, half_x), (1, self.pose.y, half_y)] {
            if at.abs() > half - 0.5 && self.velocity[k] * at > 0.0 {
                self.velocity[k] = -self.velocity[k];
            }
        }
        let [vx, vy, turn] = self.velocity;
        let next = Pose::new(
            self.pose.x + vx * dt,
            self.pose.y + vy * dt,
            self.pose.theta + turn * dt,
        );
        // In the robot frame at the start, as odometry is told.
        let (sin, cos) = self.pose.theta.sin_cos();
        let motion = [
            (cos * vx + sin * vy) * dt,
            (cos * vy - sin * vx) * dt,
            turn * dt,
        ];
        self.pose = next;
        motion
    }
}

impl<R: Rng> Iterator for SyntheticDrive<R> {
    type Item = SyntheticSample;

    fn next(&mut self) -> Option<SyntheticSample> {
        let motion = self.step();
        let config = &self.config;
        let stamp = Stamp::from_seconds(self.index as f64 / f64::from(config.frame_rate));
        self.index += 1;
        let [dx, dy, dtheta] = motion.map(|value| {
            value
                * (1.0
                    + config.odometry_scale_error
                    + config.odometry_noise * standard_normal(&mut self.rng))
        });
        let heading =
            self.pose.theta + config.compass_std_deg.to_radians() * standard_normal(&mut self.rng);
        let points = simulate_line_points(&self.field, config, self.pose, &mut self.rng);
        Some(SyntheticSample {
            stamp,
            true_pose: self.pose,
            odometry: Odometry {
                stamp,
                dx,
                dy,
                dtheta,
                slip: 0.0,
            },
            compass: Compass {
                stamp,
                heading: wrap_angle(heading),
                magnetic_field: None,
            },
            points,
        })
    }
}

/// A pose on the field, uniformly, any heading.
pub fn random_pose(field: &Field, rng: &mut impl Rng) -> Pose {
    let mut within = |half: f32| (rng.random::<f32>() * 2.0 - 1.0) * half;
    let (x, y) = (within(field.length / 2.0), within(field.width / 2.0));
    Pose::new(x, y, within(std::f32::consts::PI))
}

/// Line points that a robot at `pose` reports.
pub fn simulate_line_points(
    field: &Field,
    config: &SyntheticDriveConfig,
    pose: Pose,
    rng: &mut impl Rng,
) -> Vec<LinePoint> {
    let mut points = Vec::with_capacity(config.rays * config.hits_per_ray);
    let mut hits = Vec::new();
    for ray in 0..config.rays {
        let around = ray as f32 / config.rays as f32;
        let sector = (around * config.occluded_sectors.max(1) as f32).fract();
        if sector < config.occluded_share {
            continue;
        }
        let bearing = around * std::f32::consts::TAU;
        let (sin, cos) = (pose.theta + bearing).sin_cos();
        intersect_ray(&field.markings, [pose.x, pose.y], [cos, sin], &mut hits);
        hits.retain(|&range| range > config.range_min && range < config.range_max);
        hits.sort_by(f32::total_cmp);
        for &range in hits.iter().take(config.hits_per_ray) {
            let std =
                config.point_std[0] + (config.point_std[1] - config.point_std[0]) * range / 5.0;
            let (along, across) = if rng.random::<f32>() < config.outlier_share {
                let free = config.range_max - config.range_min;
                (config.range_min + free * rng.random::<f32>(), 0.0)
            } else {
                (
                    range + std * standard_normal(rng),
                    std * standard_normal(rng),
                )
            };
            let (sin, cos) = bearing.sin_cos();
            points.push(LinePoint {
                at: At::new(along * cos - across * sin, along * sin + across * cos),
                std_radial: std,
                std_tangential: std,
            });
        }
    }
    points
}
