//! On which path is the ball, and since when? Competing paths, each begun by a kick, an impact or a first sighting.
//!
//! A ray that the most probable path explains badly begins new paths; a flight that meets the ground bounces or rolls
//! on. Each path holds the probability of all rays up to now: Bayesian detection of changes (docs/methods.md 17.3).

use super::config::FlightConfig;
use super::motion::{BallMotionMode, BallMotionState, HAND_SPEED_STD, mix};
use super::path_filter::{Agreement, PathFilter, VelocityChange};
use super::ray::RobotRay;
use super::ray_rows::point_on;
use crate::math;
use crate::stamp::Stamp;

/// Probability that the path before was wrong, so that a new one begins anywhere.
const ANYWHERE_PROBABILITY: f64 = 0.1;
/// Squared normalized error of the most probable path above which a ray may be the first one after a change.
const CHANGE_NIS: f64 = 6.0;
/// Paths less probable than the best by this factor's logarithm are forgotten.
const LOG_RATIO_MIN: f64 = -12.0;
/// Standard deviations of velocities of a new path, m/s.
const SPEED_STD: f64 = 5.0;
const VERTICAL_SPEED_STD: f64 = 3.5;
/// Shares of the balls on the ground that lie still and that roll slowly, and the standard deviations of their velocities,
/// m/s.
const RESTING_SHARE: f64 = 0.5;
const RESTING_SPEED_STD: f64 = 0.1;
const SLOW_SHARE: f64 = 0.2;
const SLOW_SPEED_STD: f64 = 0.7;
/// A ball that leaves the ground goes up, m/s.
const LOFT_MEAN: f64 = 2.5;
const LOFT_STD: f64 = 2.5;
/// Standard deviation of the height of a ball that is first seen in the air, metres.
const HEIGHT_STD: f64 = 0.7;
/// Distances of a ball that is first seen in the air, metres, and the standard deviation as a share of them.
const FIRST_DISTANCES: [f64; 4] = [1.2, 2.4, 4.8, 9.6];
const FIRST_DISTANCE_SHARE: f64 = 0.35;
/// What an impact on the ground leaves of the horizontal and the vertical speed, and the standard deviation as a share.
const HORIZONTAL_KEPT: f64 = 0.75;
const VERTICAL_KEPT: f64 = 0.6;
const IMPACT_SHARE_STD: f64 = 0.2;
const IMPACT_SPEED_STD: f64 = 0.2;
/// Probability of bouncing, against rolling on, at an impact.
const BOUNCE_PROBABILITY: f64 = 0.6;
/// Probability of an impact above which it is followed.
const IMPACT_PROBABILITY_MIN: f64 = 0.02;
/// The ground and the ball's radius are known this well, metres.
const GROUND_STD: f64 = 0.02;
/// A ball on the ground does not come from a greater height without a flight: standard deviation, metres.
const DROP_STD: f64 = 0.1;

/// A path since a change.
#[derive(Debug, Clone)]
struct Path {
    filter: PathFilter,
    /// Logarithm of its probability.
    log_probability: f64,
    /// Logarithm of the probability that a flight has been above the ground up to now.
    log_above: f64,
}

/// The competing paths of one ball.
#[derive(Debug, Clone)]
pub(super) struct PathTracker {
    /// Kinds of new paths with their probabilities.
    kinds: Vec<(BallMotionMode, f64)>,
    paths: Vec<Path>,
    robots: usize,
}

/// What a ray contributes.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayEvidence {
    /// Logarithm of the probability density of the ray after all rays before it.
    pub(super) log_density: f64,
    /// How much smaller this is than expected of a ray of the most probable path.
    pub(super) surprise: f64,
}

impl PathTracker {
    /// A tracker that has seen nothing.
    pub(super) fn new(kinds: &[(BallMotionMode, f64)]) -> Self {
        PathTracker {
            kinds: kinds.to_vec(),
            paths: Vec::new(),
            robots: 0,
        }
    }

    pub(super) fn stamp(&self) -> Option<Stamp> {
        Some(self.paths.first()?.filter.stamp)
    }

    /// Forgets everything.
    pub(super) fn reset(&mut self) {
        self.paths.clear();
        self.robots = 0;
    }

    /// Adds a ray, not older than those before; `robot`: index of the robot that saw it.
    pub(super) fn update(
        &mut self,
        ray: &RobotRay,
        robot: usize,
        config: &FlightConfig,
    ) -> RayEvidence {
        self.robots = self.robots.max(robot + 1);
        let parents = std::mem::take(&mut self.paths);
        let mut paths = Vec::with_capacity(parents.len() + 4);
        let mut best: Option<Agreement> = None;
        let seconds = parents.first().map_or(0.0, |parent| {
            parent.filter.stamp.seconds_until(ray.ray.stamp)
        });
        // The configured probability is that between two images at 30 per second.
        let changes = (f64::from(config.change_probability) * 30.0 * seconds).min(0.5);
        for (place, parent) in parents.iter().enumerate() {
            let mut filter = parent.filter.clone();
            filter.include_robots(self.robots);
            filter.predict(ray.ray.stamp, config);
            let log_above = log_above_ground(&filter, config).min(parent.log_above);
            let log_stays = log_above - parent.log_above;
            let impact = 1.0 - math::exp(log_stays);
            if seconds > 0.0 && impact > IMPACT_PROBABILITY_MIN {
                let log_probability = parent.log_probability + math::ln(impact);
                self.add_impacts(&mut paths, parent, log_probability, ray, robot, config);
            }
            let agreement = filter.update(ray, robot, config);
            if place == 0 {
                best = Some(agreement);
            }
            paths.push(Path {
                filter,
                log_probability: parent.log_probability
                    + log_stays
                    + math::ln(1.0 - changes)
                    + agreement.log_density,
                log_above,
            });
        }
        match (best, parents.first()) {
            (Some(agreement), Some(parent)) => {
                if seconds > 0.0 && agreement.nis > CHANGE_NIS {
                    let log_probability = parent.log_probability + math::ln(changes);
                    self.add_changes(&mut paths, parent, log_probability, ray, robot, config);
                    if agreement.is_outlier {
                        let anywhere = log_probability + math::ln(ANYWHERE_PROBABILITY);
                        self.add_first(&mut paths, anywhere, ray, robot, config);
                    }
                }
            }
            _ => self.add_first(&mut paths, 0.0, ray, robot, config),
        }
        self.keep_probable(paths, best, config)
    }

    /// Paths after a kick or an impact against something between the last ray and this one.
    fn add_changes(
        &self,
        paths: &mut Vec<Path>,
        parent: &Path,
        log_probability: f64,
        ray: &RobotRay,
        robot: usize,
        config: &FlightConfig,
    ) {
        for &(mode, probability) in &self.kinds {
            let from_ground = parent.filter.mode == BallMotionMode::Ground;
            let mut before = parent.filter.clone();
            before.include_robots(self.robots);
            let mut log_drop = 0.0;
            if mode == BallMotionMode::Ground && !from_ground {
                log_drop = -0.5 * before.touch_ground(DROP_STD, config);
            }
            let log_probability =
                log_probability + math::ln((1.0 - ANYWHERE_PROBABILITY) * probability) + log_drop;
            for (share, added, variances) in new_velocities(mode, from_ground) {
                let change = VelocityChange {
                    kept: [0.0; 3],
                    added,
                    variances,
                };
                let filter =
                    PathFilter::after_change(&before, ray.ray.stamp, mode, &change, config);
                let log_probability = log_probability + math::ln(share);
                push(paths, filter, log_probability, ray, robot, config);
            }
        }
    }

    /// Paths of a flight that met the ground between the last ray and this one.
    fn add_impacts(
        &self,
        paths: &mut Vec<Path>,
        parent: &Path,
        log_probability: f64,
        ray: &RobotRay,
        robot: usize,
        config: &FlightConfig,
    ) {
        let mut contact = parent.filter.clone();
        contact.include_robots(self.robots);
        let nanoseconds = ray.ray.stamp.0 - contact.stamp.0;
        contact.predict(Stamp(contact.stamp.0 + nanoseconds / 2), config);
        // The moment of the contact is unknown.
        let seconds = 1e-9 * nanoseconds as f64;
        let moment_std = contact.velocity()[2].abs() * seconds / 12_f64.sqrt();
        contact.touch_ground(math::hypot(GROUND_STD, moment_std), config);
        let [vx, vy, vz] = contact.squared_velocity();
        let share = IMPACT_SHARE_STD * IMPACT_SHARE_STD;
        let least = IMPACT_SPEED_STD * IMPACT_SPEED_STD;
        let level = share * (vx + vy) + least;
        for (mode, probability, up, up_variance) in [
            (
                BallMotionMode::Flight,
                BOUNCE_PROBABILITY,
                -VERTICAL_KEPT,
                share * vz + least,
            ),
            (BallMotionMode::Ground, 1.0 - BOUNCE_PROBABILITY, 0.0, 0.0),
        ] {
            let change = VelocityChange {
                kept: [HORIZONTAL_KEPT, HORIZONTAL_KEPT, up],
                added: [0.0; 3],
                variances: [level, level, up_variance],
            };
            let filter = PathFilter::after_change(&contact, ray.ray.stamp, mode, &change, config);
            let log_probability = log_probability + math::ln(probability);
            push(paths, filter, log_probability, ray, robot, config);
        }
    }

    /// Paths of a ball of which nothing is known.
    fn add_first(
        &self,
        paths: &mut Vec<Path>,
        log_probability: f64,
        ray: &RobotRay,
        robot: usize,
        config: &FlightConfig,
    ) {
        let stamp = ray.ray.stamp;
        let radius = f64::from(config.ball_radius);
        for &(mode, probability) in &self.kinds {
            let mut push_first = |at: [f64; 3], std: [f64; 2], share: f64| {
                let [level, up] = std.map(|std| std * std);
                for (part, _, [vx, vy, vz]) in new_velocities(mode, false) {
                    let mean = [at[0], at[1], at[2].max(radius), 0.0, 0.0, 0.0];
                    let variances = [level, level, up, vx, vy, vz];
                    let filter = PathFilter::new(mode, stamp, mean, variances, self.robots);
                    let log_probability = log_probability + math::ln(probability * share * part);
                    push(paths, filter, log_probability, ray, robot, config);
                }
            };
            if mode == BallMotionMode::Ground {
                let down = -math::sin(f64::from(ray.ray.elevation));
                let drop = f64::from(ray.ray.origin[2]) - radius;
                let distance = (drop / down.max(1e-3)).clamp(0.3, 20.0);
                let [x, y, _] = point_on(ray, distance);
                // As wide as for a ball in the air, so that only the ray decides between them.
                let std = FIRST_DISTANCE_SHARE * distance
                    + ray.ray.distance.map_or(0.0, |d| f64::from(d[1]));
                push_first([x, y, radius], [std, 0.0], 1.0);
            } else if let Some([measured, std]) = ray.ray.distance {
                let (measured, std) = (f64::from(measured), f64::from(std));
                let at = point_on(ray, measured);
                push_first(at, [std + FIRST_DISTANCE_SHARE * measured, HEIGHT_STD], 1.0);
            } else {
                for distance in FIRST_DISTANCES {
                    let std = FIRST_DISTANCE_SHARE * distance;
                    let share = 1.0 / FIRST_DISTANCES.len() as f64;
                    push_first(point_on(ray, distance), [std, HEIGHT_STD], share);
                }
            }
        }
    }

    /// Keeps the most probable paths, with probabilities that sum to 1.
    fn keep_probable(
        &mut self,
        mut paths: Vec<Path>,
        best: Option<Agreement>,
        config: &FlightConfig,
    ) -> RayEvidence {
        // A stable sort: equal seeds give equal bits.
        paths.sort_by(|a, b| b.log_probability.total_cmp(&a.log_probability));
        let largest = paths.first().map_or(0.0, |path| path.log_probability);
        let sum: f64 = paths
            .iter()
            .map(|path| math::exp(path.log_probability - largest))
            .sum();
        let log_density = largest + math::ln(sum);
        paths.retain(|path| path.log_probability - largest > LOG_RATIO_MIN);
        paths.truncate(config.hypotheses_max);
        let kept: f64 = paths
            .iter()
            .map(|path| math::exp(path.log_probability - largest))
            .sum();
        for path in &mut paths {
            path.log_probability -= largest + math::ln(kept);
        }
        self.paths = paths;
        RayEvidence {
            log_density,
            surprise: best.map_or(0.0, |best| best.log_peak - 1.0 - log_density),
        }
    }

    /// Squared normalized error of a ray of this time or later by the most probable path, which is not changed.
    pub(super) fn nis(&self, ray: &RobotRay, robot: usize, config: &FlightConfig) -> Option<f64> {
        let mut filter = self.paths.first()?.filter.clone();
        filter.include_robots(robot + 1);
        filter.predict(ray.ray.stamp, config);
        Some(filter.update(ray, robot, config).nis)
    }

    /// Probability of a kind of motion.
    pub(super) fn probability(&self, mode: BallMotionMode) -> f64 {
        let of_mode = self.paths.iter().filter(|path| path.filter.mode == mode);
        of_mode.map(|path| math::exp(path.log_probability)).sum()
    }

    /// Mean and covariance over all paths of some kinds, weighted by their probabilities.
    pub(super) fn state(&self, modes: &[BallMotionMode]) -> Option<BallMotionState> {
        let of_modes = self
            .paths
            .iter()
            .filter(|path| modes.contains(&path.filter.mode));
        mix(of_modes.map(|path| (path.log_probability, path.filter.state())))
    }
}

/// Adds a path after the update by its first ray.
fn push(
    paths: &mut Vec<Path>,
    mut filter: PathFilter,
    log_probability: f64,
    ray: &RobotRay,
    robot: usize,
    config: &FlightConfig,
) {
    let agreement = filter.update(ray, robot, config);
    if !agreement.is_outlier {
        let log_above = log_above_ground(&filter, config);
        paths.push(Path {
            log_probability: log_probability + agreement.log_density + log_above,
            log_above,
            filter,
        });
    }
}

/// Share, mean and variances of the velocities of new paths.
fn new_velocities(mode: BallMotionMode, from_ground: bool) -> Vec<(f64, [f64; 3], [f64; 3])> {
    let level = SPEED_STD * SPEED_STD;
    match mode {
        BallMotionMode::Ground => {
            let resting = RESTING_SPEED_STD * RESTING_SPEED_STD;
            let slow = SLOW_SPEED_STD * SLOW_SPEED_STD;
            let fast_share = 1.0 - RESTING_SHARE - SLOW_SHARE;
            vec![
                (RESTING_SHARE, [0.0; 3], [resting, resting, 0.0]),
                (SLOW_SHARE, [0.0; 3], [slow, slow, 0.0]),
                (fast_share, [0.0; 3], [level, level, 0.0]),
            ]
        }
        BallMotionMode::Held => vec![(1.0, [0.0; 3], [HAND_SPEED_STD * HAND_SPEED_STD; 3])],
        BallMotionMode::Flight => {
            let (up, std) = if from_ground {
                (LOFT_MEAN, LOFT_STD)
            } else {
                (0.0, VERTICAL_SPEED_STD)
            };
            vec![(1.0, [0.0, 0.0, up], [level, level, std * std])]
        }
    }
}

/// Logarithm of the probability that a flying ball is above the ground.
fn log_above_ground(filter: &PathFilter, config: &FlightConfig) -> f64 {
    if filter.mode == BallMotionMode::Ground {
        return 0.0;
    }
    let above = filter.position()[2] - f64::from(config.ball_radius) + GROUND_STD;
    let sigmas = above / math::hypot(filter.height_std(), GROUND_STD);
    // The logistic function approximates that of the normal distribution to 1 %.
    -math::ln(1.0 + math::exp((-1.702 * sigmas).min(700.0)))
}
