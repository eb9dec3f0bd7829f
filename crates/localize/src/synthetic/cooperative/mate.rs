//! A team-mate that drives near the blind robot, sees it, and reports what it sees.

use nalgebra::{Matrix3, Vector3};
use rand::{Rng, RngExt};

use super::settings::CooperativeExperiment;
use super::sight::{HEIGHT, LastingError, Mirror, RATE};
use crate::estimate::Estimate;
use crate::frames::{At, FieldFrame, Pose};
use crate::math;
use crate::random::standard_normal;
use crate::sample::Odometry;
use crate::stamp::Stamp;
use crate::team::{ReportedObstacle, TeamReport};
use crate::world::{WorldConfig, WorldModel};

/// Time constant of the way to the place that a robot wants, seconds.
const FOLLOW_TIME: f32 = 0.7;
/// Drift of a blind mate's position, metres per square root of a second.
const BLIND_DRIFT: f32 = 0.1;
/// Share by which a mate's wheels report too much.
const WHEEL_SCALE: f32 = 1.02;

/// A robot that keeps a place relative to the blind one.
#[derive(Debug, Clone)]
pub(super) struct Companion {
    pub(super) pose: Pose,
    distance: f32,
    bearing: f32,
    turn: f32,
    yaw_rate: f32,
}

impl Companion {
    pub(super) fn new(around: Pose, distances: [f32; 2], rng: &mut impl Rng) -> Self {
        let distance = distances[0] + (distances[1] - distances[0]) * rng.random::<f32>();
        let bearing = std::f32::consts::TAU * rng.random::<f32>();
        let (sin, cos) = math::sin_cos(bearing);
        Companion {
            pose: Pose::new(
                around.x + distance * cos,
                around.y + distance * sin,
                std::f32::consts::TAU * rng.random::<f32>(),
            ),
            distance,
            bearing,
            turn: 0.3 * standard_normal(rng),
            yaw_rate: 0.5 * standard_normal(rng),
        }
    }

    /// Moves on by an image. Returns the motion in its frame.
    pub(super) fn step(&mut self, around: Pose) -> [f32; 3] {
        self.bearing += self.turn / RATE;
        let (sin, cos) = math::sin_cos(self.bearing);
        let wanted = [
            around.x + self.distance * cos,
            around.y + self.distance * sin,
        ];
        let share = 1.0 / (RATE * FOLLOW_TIME);
        let (dx, dy) = (
            share * (wanted[0] - self.pose.x),
            share * (wanted[1] - self.pose.y),
        );
        let dtheta = self.yaw_rate / RATE;
        let (sin, cos) = math::sin_cos(self.pose.theta);
        self.pose = Pose::new(self.pose.x + dx, self.pose.y + dy, self.pose.theta + dtheta);
        [cos * dx + sin * dy, cos * dy - sin * dx, dtheta]
    }
}

/// A team-mate with its own estimate of its pose and its own world model.
pub(super) struct Mate {
    pub(super) number: u32,
    pub(super) companion: Companion,
    /// Error of its clock, seconds.
    clock_error: f32,
    /// Mean delay of its messages, seconds.
    pub(super) delay: f32,
    errors: [LastingError; 3],
    mirror: Mirror,
    world: WorldModel,
    /// Where it believes to be beyond its honest errors, metres.
    lie: [f32; 2],
    /// Drift of a blind mate, metres.
    drift: [f32; 2],
}

impl Mate {
    pub(super) fn new(
        index: usize,
        around: Pose,
        others: usize,
        trial: &CooperativeExperiment,
        rng: &mut impl Rng,
    ) -> Self {
        let (sin, cos) = math::sin_cos(std::f32::consts::TAU * rng.random::<f32>());
        let lie = if index < trial.liars { trial.lie } else { 0.0 };
        let [soonest, latest] = trial.delays;
        Mate {
            number: index as u32 + 2,
            companion: Companion::new(around, [2.0, 4.5], rng),
            clock_error: trial.clock_error * (2.0 * rng.random::<f32>() - 1.0),
            delay: soonest + (latest - soonest) * rng.random::<f32>(),
            errors: std::array::from_fn(|_| LastingError::new(rng)),
            mirror: Mirror::new(others, rng),
            world: WorldModel::new(WorldConfig::default(), HEIGHT),
            lie: [lie * cos, lie * sin],
            drift: [0.0; 2],
        }
    }

    /// What it reports of an image. `others`: the places of all other robots. `blind_for`: seconds without line points.
    pub(super) fn report(
        &mut self,
        stamp: Stamp,
        motion: [f32; 3],
        others: &[At<FieldFrame>],
        blind_for: f32,
        trial: &CooperativeExperiment,
        rng: &mut impl Rng,
    ) -> TeamReport {
        let [dx, dy, dtheta] = motion.map(|value| WHEEL_SCALE * value);
        self.world.add_odometry(&Odometry {
            stamp,
            dx,
            dy,
            dtheta,
            slip: 0.0,
        });
        let is_blind = trial.mates_blind && blind_for > 0.0;
        if is_blind {
            for drift in &mut self.drift {
                *drift += BLIND_DRIFT * (1.0 / RATE).sqrt() * standard_normal(rng);
            }
        }
        let [position_std, heading_std] = trial.pose_std.map(|std| std * trial.pose_std_factor);
        let error = self
            .errors
            .each_mut()
            .map(|error| error.step(trial.error_time, rng));
        let truth = self.companion.pose;
        let believed = Pose::new(
            truth.x + position_std * error[0] + self.lie[0] + self.drift[0],
            truth.y + position_std * error[1] + self.lie[1] + self.drift[1],
            truth.theta + heading_std * error[2],
        );
        let [position, heading] = trial.pose_std.map(|std| std * std);
        let drifted = if is_blind {
            BLIND_DRIFT * BLIND_DRIFT * blind_for
        } else {
            0.0
        };
        let variances = Vector3::new(position + drifted, position + drifted, heading);
        let covariance = Matrix3::from_diagonal(&variances);
        let estimate = Estimate::tracked(stamp, believed, covariance);
        let observation = self.mirror.see(truth, others, rng);
        let world = self
            .world
            .update(stamp, Some(&observation), &estimate, None);
        let obstacles = world.robots.iter().filter_map(|robot| {
            let on_field = robot.on_field?;
            let p = on_field.covariance;
            Some(ReportedObstacle {
                at: on_field.at,
                covariance: [p[(0, 0)], p[(0, 1)], p[(1, 1)]],
            })
        });
        TeamReport {
            robot: self.number,
            is_member: true,
            stamp: stamp + f64::from(self.clock_error),
            pose: Some(believed),
            pose_std: variances.map(f32::sqrt).into(),
            half_known: true,
            pose_by_markings: !is_blind,
            ball: None,
            obstacles: obstacles.collect(),
            ball_sighting: None,
        }
    }
}
