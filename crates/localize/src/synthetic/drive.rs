//! Synthetic drives: line points, odometry and compass with ground truth, reproducible by a seed.
//!
//! For evaluating localization without images. Rays from the robot are intersected with the markings, with configured
//! errors, outliers and occluded sectors; odometry has a scale error. Used by the benches, `eval` and the tests.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::field::ray::intersect_ray;
use crate::frames::{At, Pose, wrap_angle};
use crate::math;
use crate::random::standard_normal;
use crate::sample::{Compass, LinePoint, Odometry};
use crate::stamp::Stamp;

/// Settings of a drive and of its sensor errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SyntheticDriveConfig {
    /// Frames per second.
    pub frame_rate: f32,
    /// Standard deviation of each velocity component, m/s.
    pub speed: f32,
    /// Standard deviation of the yaw rate, rad/s.
    pub yaw_rate: f32,
    /// Rays, evenly around the robot.
    pub rays: usize,
    /// Largest number of markings hit per ray.
    pub hits_per_ray: usize,
    /// Smallest range of markings, metres: nearer ones are occluded by the robot's own body.
    pub range_min: f32,
    /// Largest range of markings, metres.
    pub range_max: f32,
    /// Standard deviation of a point at ranges 0 and 5 m, metres; linear in the range.
    pub point_std: [f32; 2],
    /// Share of outliers, uniform along their ray.
    pub outlier_share: f32,
    /// Share of all directions that is occluded, in `occluded_sectors` equal sectors evenly around the robot.
    pub occluded_share: f32,
    /// Number of occluded sectors.
    pub occluded_sectors: usize,
    /// Relative error by which odometry reports too long distances and too large angles.
    pub odometry_scale_error: f32,
    /// Standard deviation of each increment, share of the motion.
    pub odometry_noise: f32,
    /// Standard deviation of the compass, degrees.
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

/// One image's samples of a drive, with the ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticSample {
    /// Stamp of all samples.
    pub stamp: Stamp,
    /// Ground truth.
    pub true_pose: Pose,
    /// Motion since the previous sample, as reported by the wheels.
    pub odometry: Odometry,
    /// Heading with noise.
    pub compass: Compass,
    /// Line points as vision reports them (robot frame).
    pub points: Vec<LinePoint>,
}

/// An endless random drive; iterates over its samples.
#[derive(Debug, Clone)]
pub struct SyntheticDrive<R> {
    field: Field,
    config: SyntheticDriveConfig,
    rng: R,
    pose: Pose,
    /// Velocity in the field frame (m/s) and yaw rate (rad/s).
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

    /// Moves the robot to a random pose, unnoticed by odometry.
    pub fn kidnap(&mut self) {
        self.pose = random_pose(&self.field, &mut self.rng);
        self.velocity = [0.0; 3];
    }

    /// Line points measured at `pose`.
    pub fn observe(&mut self, pose: Pose) -> Vec<LinePoint> {
        simulate_line_points(&self.field, &self.config, pose, &mut self.rng)
    }

    fn step(&mut self) -> [f32; 3] {
        let dt = 1.0 / self.config.frame_rate;
        // A Gauss-Markov process of the velocity with a correlation time of 1 s, reflected near the edge.
        let decay = math::exp(-dt);
        let excitation = (1.0 - decay * decay).sqrt();
        let (half_x, half_y) = (self.field.length / 2.0, self.field.width / 2.0);
        let stds = [self.config.speed, self.config.speed, self.config.yaw_rate];
        for (value, std) in self.velocity.iter_mut().zip(stds) {
            *value = decay * *value + excitation * std * standard_normal(&mut self.rng);
        }
        for (k, at, half) in [(0, self.pose.x, half_x), (1, self.pose.y, half_y)] {
            if at.abs() > half - 0.5 && self.velocity[k] * at > 0.0 {
                self.velocity[k] = -self.velocity[k];
            }
        }
        let [vx, vy, yaw_rate] = self.velocity;
        let next = Pose::new(
            self.pose.x + vx * dt,
            self.pose.y + vy * dt,
            self.pose.theta + yaw_rate * dt,
        );
        // In the robot frame at the start, as odometry reports it.
        let (sin, cos) = math::sin_cos(self.pose.theta);
        let motion = [
            (cos * vx + sin * vy) * dt,
            (cos * vy - sin * vx) * dt,
            yaw_rate * dt,
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

/// A uniformly distributed pose on the field.
pub fn random_pose(field: &Field, rng: &mut impl Rng) -> Pose {
    let mut within = |half: f32| (rng.random::<f32>() * 2.0 - 1.0) * half;
    let (x, y) = (within(field.length / 2.0), within(field.width / 2.0));
    Pose::new(x, y, within(std::f32::consts::PI))
}

/// Line points measured at `pose` (robot frame).
pub fn simulate_line_points(
    field: &Field,
    config: &SyntheticDriveConfig,
    pose: Pose,
    rng: &mut impl Rng,
) -> Vec<LinePoint> {
    let mut points = Vec::with_capacity(config.rays * config.hits_per_ray);
    let mut hits = Vec::new();
    for ray in 0..config.rays {
        let turn_share = ray as f32 / config.rays as f32;
        let sector = (turn_share * config.occluded_sectors.max(1) as f32).fract();
        if sector < config.occluded_share {
            continue;
        }
        let bearing = turn_share * std::f32::consts::TAU;
        let (sin, cos) = math::sin_cos(pose.theta + bearing);
        intersect_ray(&field.markings, [pose.x, pose.y], [cos, sin], &mut hits);
        hits.retain(|&range| range > config.range_min && range < config.range_max);
        hits.sort_by(f32::total_cmp);
        for &range in hits.iter().take(config.hits_per_ray) {
            let std =
                config.point_std[0] + (config.point_std[1] - config.point_std[0]) * range / 5.0;
            let (along, across) = if rng.random::<f32>() < config.outlier_share {
                let span = config.range_max - config.range_min;
                (config.range_min + span * rng.random::<f32>(), 0.0)
            } else {
                (
                    range + std * standard_normal(rng),
                    std * standard_normal(rng),
                )
            };
            let (sin, cos) = math::sin_cos(bearing);
            points.push(LinePoint {
                at: At::new(along * cos - across * sin, along * sin + across * cos),
                std_radial: std,
                std_tangential: std,
            });
        }
    }
    points
}
