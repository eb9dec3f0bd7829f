//! Where do the rays of several robots meet, and whose ray does not?
//!
//! Each robot's rays share the errors of its pose, tilt and mounting, which are estimated with the ball's path. So a
//! robot whose pose is uncertain counts little, and many rays of one robot do not pretend to be independent. Rays
//! arrive late and out of order: the paths before each recent ray are kept, and a late ray is put in its place.

use super::config::FlightConfig;
use super::motion::{BallMotionMode, BallMotionState};
use super::path_tracker::PathTracker;
use super::ray::RobotRay;
use crate::math;

/// The ball that several robots see.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangulatedBall {
    /// How it most probably moves.
    pub mode: BallMotionMode,
    /// Mean over all kinds of motion: state of its centre at the newest ray's time, field frame.
    pub state: BallMotionState,
    /// Numbers of the robots whose rays agree, sorted.
    pub inliers: Vec<u32>,
    /// Numbers of the robots whose rays disagree, sorted.
    pub outliers: Vec<u32>,
}

/// Kinds of motion with their prior probabilities.
const KINDS: [(BallMotionMode, f64); 3] = [
    (BallMotionMode::Ground, 0.6),
    (BallMotionMode::Flight, 0.35),
    (BallMotionMode::Held, 0.05),
];
/// Most robots whose rays are combined.
const ROBOTS_MAX: usize = 8;
/// Most recent rays: eight robots at 30 images per second for a quarter of a second.
const RAYS_MAX: usize = 64;
/// Sum of the recent rays' surprises above which somebody may be wrong. A kick costs about 10.
const SUSPICION: f64 = 25.0;
/// The same sum above which rays that nobody can be blamed for give no ball.
const DISAGREEMENT: f64 = 60.0;
/// Probability that a robot's directions are wrong.
const FAULT_PROBABILITY: f64 = 0.01;
/// Mean squared normalized error below which a robot that was wrong is believed again (2 is expected).
const REHABILITATION_NIS: f64 = 5.0;
/// Rays that show it.
const REHABILITATION_RAYS: usize = 3;

/// Results after which it is judged again who is wrong.
const FAULT_CHECK_INTERVAL: usize = 5;

/// A recent ray with the paths before it.
#[derive(Debug, Clone)]
struct RecentRay {
    ray: RobotRay,
    before: PathTracker,
    surprise: f64,
    /// Squared normalized error of a ray of the robot that is left out.
    left_out_nis: Option<f64>,
}

/// Follows the ball by the rays of several robots, field frame.
#[derive(Debug, Clone)]
pub struct TeamFlightTracker {
    config: FlightConfig,
    paths: PathTracker,
    /// Sorted by time.
    recent: Vec<RecentRay>,
    /// Number of recent rays that `paths` contains.
    done: usize,
    /// Numbers of the robots in the order of their shared errors.
    robots: Vec<u32>,
    /// The robot whose directions are wrong.
    left_out: Option<u32>,
    /// Results since then.
    images_with_fault: usize,
}

impl TeamFlightTracker {
    /// A tracker that has seen nothing.
    pub fn new(config: FlightConfig) -> Self {
        TeamFlightTracker {
            config,
            paths: PathTracker::new(&KINDS),
            recent: Vec::new(),
            done: 0,
            robots: Vec::new(),
            left_out: None,
            images_with_fault: 0,
        }
    }

    fn reset(&mut self) {
        *self = TeamFlightTracker::new(self.config.clone());
    }

    /// Adds a ray. One that is not finite, is of a robot too many, or is older than `team_window` is ignored.
    pub fn add(&mut self, ray: &RobotRay) {
        let valid = ray.pose_std.iter().all(|std| (0.0..1e3).contains(std));
        if !(ray.ray.is_valid() && valid) {
            return;
        }
        if let Some(newest) = self.recent.last() {
            let gap = newest.ray.ray.stamp.seconds_until(ray.ray.stamp) as f32;
            if gap.abs() > self.config.gap_max.max(self.config.team_window) {
                self.reset();
            } else if gap < -self.config.team_window {
                return;
            }
        }
        if !self.robots.contains(&ray.robot) {
            if self.robots.len() == ROBOTS_MAX {
                return;
            }
            self.robots.push(ray.robot);
        }
        let key = |ray: &RobotRay| (ray.ray.stamp, ray.robot);
        let Err(place) = self
            .recent
            .binary_search_by_key(&key(ray), |recent| key(&recent.ray))
        else {
            return;
        };
        // Without the paths before it, a ray older than all others has no place.
        if place == 0 && !self.recent.is_empty() && self.paths.stamp().is_some() {
            return;
        }
        if place < self.done {
            self.paths = self.recent[place].before.clone();
            self.done = place;
        }
        self.recent.insert(
            place,
            RecentRay {
                ray: *ray,
                before: PathTracker::new(&[]),
                surprise: 0.0,
                left_out_nis: None,
            },
        );
    }

    /// The ball by all rays; None if fewer than two robots see it, or if they disagree and nobody can be blamed.
    pub fn ball(&mut self) -> Option<TriangulatedBall> {
        let newest = self.recent.last()?.ray.ray.stamp;
        let pending = self.done < self.recent.len();
        self.process();
        let window = f64::from(self.config.team_window);
        let old = self
            .recent
            .partition_point(|recent| recent.ray.ray.stamp.seconds_until(newest) > window);
        let old = old.max(self.recent.len().saturating_sub(RAYS_MAX));
        self.recent.drain(..old);
        self.done -= old;
        if pending {
            self.rehabilitate();
            self.images_with_fault = self.left_out.map_or(0, |_| self.images_with_fault + 1);
            let due = self.images_with_fault % FAULT_CHECK_INTERVAL == 1;
            if due || self.surprise() > SUSPICION {
                self.find_fault();
            }
        }
        let mut inliers = self.seeing();
        let outliers: Vec<u32> = inliers
            .iter()
            .copied()
            .filter(|&robot| Some(robot) == self.left_out)
            .collect();
        inliers.retain(|&robot| Some(robot) != self.left_out);
        if inliers.len() < 2 || self.surprise() > DISAGREEMENT {
            return None;
        }
        let (mode, _) = KINDS
            .map(|(mode, _)| (mode, self.paths.probability(mode)))
            .into_iter()
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(TriangulatedBall {
            mode,
            state: self.paths.state(&KINDS.map(|(mode, _)| mode))?,
            inliers,
            outliers,
        })
    }

    /// Numbers of the robots with recent rays, sorted.
    fn seeing(&self) -> Vec<u32> {
        let mut robots: Vec<u32> = self.recent.iter().map(|recent| recent.ray.robot).collect();
        robots.sort_unstable();
        robots.dedup();
        robots
    }

    fn index(&self, robot: u32) -> usize {
        let known = self.robots.iter().position(|&number| number == robot);
        known.unwrap_or(0)
    }

    /// Adds the rays that the paths do not contain yet.
    fn process(&mut self) {
        while self.done < self.recent.len() {
            let ray = self.recent[self.done].ray;
            let robot = self.index(ray.robot);
            let recent = &mut self.recent[self.done];
            recent.before = self.paths.clone();
            if Some(ray.robot) == self.left_out {
                recent.surprise = 0.0;
                recent.left_out_nis = self.paths.nis(&ray, robot, &self.config);
            } else {
                recent.surprise = self.paths.update(&ray, robot, &self.config).surprise;
                recent.left_out_nis = None;
            }
            self.done += 1;
        }
    }

    /// Sum of the recent rays' surprises.
    fn surprise(&self) -> f64 {
        self.recent.iter().map(|recent| recent.surprise).sum()
    }

    /// Believes a robot again whose rays agree with those of the others.
    fn rehabilitate(&mut self) {
        let errors = self.recent.iter().filter_map(|recent| recent.left_out_nis);
        let (count, sum) = errors.fold((0, 0.0), |(count, sum), nis| (count + 1, sum + nis));
        let agrees =
            count >= REHABILITATION_RAYS && sum < REHABILITATION_NIS * f64::from(count as u32);
        let absent = self
            .left_out
            .is_some_and(|robot| !self.seeing().contains(&robot));
        if agrees || absent {
            self.left_out = None;
        }
    }

    /// Leaves out the robot without which the rays are most probable, if there is one.
    fn find_fault(&mut self) {
        let seeing = self.seeing();
        if seeing.len() < 3 {
            return;
        }
        let all = self.log_evidence(None);
        let without = seeing.iter().map(|&robot| {
            (
                robot,
                self.log_evidence(Some(robot)) + math::ln(FAULT_PROBABILITY),
            )
        });
        let best = without.max_by(|a, b| a.1.total_cmp(&b.1));
        let fault = best.filter(|(_, log_evidence)| *log_evidence > all);
        let fault = fault.map(|(robot, _)| robot);
        if fault != self.left_out {
            self.left_out = fault;
            // The paths before this are those of wrong rays.
            self.paths = PathTracker::new(&KINDS);
            self.done = 0;
            self.process();
        }
    }

    /// Logarithm of the probability of the recent rays if a robot sees another ball than the others, or none.
    fn log_evidence(&self, faulty: Option<u32>) -> f64 {
        let (mut paths, mut other_paths) = (PathTracker::new(&KINDS), PathTracker::new(&KINDS));
        let of_ray = |recent: &RecentRay| {
            let robot = self.index(recent.ray.robot);
            let paths = if Some(recent.ray.robot) == faulty {
                &mut other_paths
            } else {
                &mut paths
            };
            paths.update(&recent.ray, robot, &self.config).log_density
        };
        self.recent.iter().map(of_ray).sum()
    }
}
