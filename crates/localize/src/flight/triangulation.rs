//! Where do the rays of several robots meet, and whose ray does not?
//!
//! Each robot's rays share the errors of its pose, tilt and mounting, which are estimated with the ball's state. So a
//! robot whose pose is uncertain counts little, and many rays of one robot do not pretend to be independent.

use nalgebra::SMatrix;

use super::config::FlightConfig;
use super::motion_fit::{BallMotionMode, BallMotionState, FitRay, MotionFit, fit_motion, mix};
use super::ray::BallRay;
use crate::math;

/// A ray of one of several robots, field frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotRay {
    /// Number of the robot.
    pub robot: u32,
    /// The ray.
    pub ray: BallRay,
    /// Standard deviations of the robot's position, metres, and heading, radians.
    pub pose_std: [f32; 2],
}

/// The ball that several robots see.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangulatedBall {
    /// How it moves.
    pub mode: BallMotionMode,
    /// State of its centre at the newest ray's time, field frame.
    pub state: BallMotionState,
    /// Numbers of the robots whose rays agree, sorted.
    pub inliers: Vec<u32>,
    /// Numbers of the robots whose rays disagree, sorted.
    pub outliers: Vec<u32>,
}

/// Kinds of motion with their prior probabilities.
const MODES: [(BallMotionMode, f64); 3] = [
    (BallMotionMode::Ground, 0.6),
    (BallMotionMode::Flight, 0.3),
    (BallMotionMode::Held, 0.1),
];
/// Probability below which the errors of consistent rays are not accepted, as standard deviations of the χ² distribution.
const CONSISTENT_SIGMAS: f64 = 4.0;
/// Most robots whose rays are combined.
const ROBOTS_MAX: usize = 8;
/// Typical speed of a fast ball, m/s: with the error of the clocks it displaces a ray.
const SPEED_OF_CLOCK_ERRORS: f32 = 5.0;

/// Combines the rays of the last `team_window` seconds; None if fewer than two robots see the ball or all disagree.
pub fn triangulate(rays: &[RobotRay], config: &FlightConfig) -> Option<TriangulatedBall> {
    let newest = rays.iter().map(|ray| ray.ray.stamp).max()?;
    let mut rays: Vec<RobotRay> = rays
        .iter()
        .filter(|ray| ray.ray.stamp.seconds_until(newest) <= f64::from(config.team_window))
        .copied()
        .collect();
    rays.sort_by(|a, b| a.ray.stamp.cmp(&b.ray.stamp).then(a.robot.cmp(&b.robot)));
    let mut robots: Vec<u32> = rays.iter().map(|ray| ray.robot).collect();
    robots.sort_unstable();
    robots.dedup();
    robots.truncate(ROBOTS_MAX);
    if robots.len() < 2 {
        return None;
    }
    // An impact within the window fits no path: a shorter one has it behind it.
    let windows = [1.0, 0.5].map(|part| {
        let since = part * f64::from(config.team_window);
        let recent = rays
            .iter()
            .filter(|ray| ray.ray.stamp.seconds_until(newest) <= since)
            .copied();
        recent.collect::<Vec<RobotRay>>()
    });
    for rays in &windows {
        let all = fit_group(rays, &robots, config);
        if let Some(group) = all.filter(|group| is_consistent(&group.fit, rays, config)) {
            return Some(ball(&group, robots, Vec::new()));
        }
    }
    if robots.len() < 3 {
        return None;
    }
    // One robot is wrong: the one without which the others agree best.
    for rays in &windows {
        let without = robots.iter().filter_map(|&liar| {
            let others = robots.iter().copied();
            let rest: Vec<u32> = others.filter(|&robot| robot != liar).collect();
            let left: Vec<RobotRay> = rays
                .iter()
                .filter(|ray| ray.robot != liar)
                .copied()
                .collect();
            let group = fit_group(&left, &rest, config)?;
            is_consistent(&group.fit, &left, config).then_some((group, rest, liar))
        });
        let best = without.max_by(|a, b| a.0.fit.log_evidence.total_cmp(&b.0.fit.log_evidence));
        if let Some((group, rest, liar)) = best {
            return Some(ball(&group, rest, vec![liar]));
        }
    }
    None
}

/// The kinds of motion of a group of robots' rays.
struct Group {
    mode: BallMotionMode,
    /// Of the most probable kind.
    fit: MotionFit,
    /// Mean over the kinds.
    state: BallMotionState,
}

fn ball(group: &Group, inliers: Vec<u32>, outliers: Vec<u32>) -> TriangulatedBall {
    TriangulatedBall {
        mode: group.mode,
        state: group.state,
        inliers,
        outliers,
    }
}

/// The most probable kind of motion for a group of robots, and the state by all kinds. None if one robot is without rays.
fn fit_group(rays: &[RobotRay], robots: &[u32], config: &FlightConfig) -> Option<Group> {
    let sees = |robot: &u32| rays.iter().any(|ray| ray.robot == *robot);
    if !robots.iter().all(sees) {
        return None;
    }
    let start = meeting_point(rays)?;
    let [x, y, z] = start;
    let rays = fit_rays(rays, robots, start, config);
    let fits: Vec<(f64, BallMotionMode, MotionFit)> = MODES
        .into_iter()
        .filter_map(|(mode, probability)| {
            let fit = fit_motion(&rays, None, mode, Some([x, y, z, 0.0, 0.0, 0.0]), config)?;
            Some((fit.log_evidence + math::ln(probability), mode, fit))
        })
        .collect();
    let &(_, mode, fit) = fits.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let states = fits
        .iter()
        .map(|(log_probability, _, fit)| (*log_probability, fit.state));
    let state = mix(states)?;
    Some(Group { mode, fit, state })
}

/// The rays with the shared errors of their robots, for a ball about `start`.
fn fit_rays(
    rays: &[RobotRay],
    robots: &[u32],
    start: [f64; 3],
    config: &FlightConfig,
) -> Vec<FitRay> {
    let bias = config.bearing_bias_std_deg.to_radians();
    rays.iter()
        .filter_map(|ray| {
            let robot = robots.iter().position(|&number| number == ray.robot)?;
            let distance = {
                let [x, y, z] = ray.ray.origin;
                let level = math::hypot(start[0] as f32 - x, start[1] as f32 - y);
                math::hypot(level, start[2] as f32 - z).max(0.5)
            };
            let [position, heading] = ray.pose_std;
            // Along the ray an error of the position changes the elevation by its sine.
            let foreshortened = math::sin(ray.ray.elevation) * position / distance;
            let aside = position / distance;
            let clock = SPEED_OF_CLOCK_ERRORS * config.clock_std / distance;
            let sum = |parts: &[f32]| parts.iter().map(|part| part * part).sum::<f32>().sqrt();
            Some(FitRay {
                ray: ray.ray,
                robot,
                bias_std: [
                    sum(&[bias, heading, aside, clock]),
                    sum(&[bias, foreshortened, clock]),
                ],
            })
        })
        .collect()
}

/// The point nearest to all rays, regardless of time: a place to begin with.
fn meeting_point(rays: &[RobotRay]) -> Option<[f64; 3]> {
    let mut normal = SMatrix::<f64, 3, 3>::identity() * 1e-3;
    let mut right = SMatrix::<f64, 3, 1>::zeros();
    for RobotRay { ray, .. } in rays {
        let (sin, cos) = math::sin_cos(f64::from(ray.azimuth));
        let (up, level) = math::sin_cos(f64::from(ray.elevation));
        let towards = SMatrix::<f64, 3, 1>::new(level * cos, level * sin, up);
        let across = SMatrix::<f64, 3, 3>::identity() - towards * towards.transpose();
        let [x, y, z] = ray.origin.map(f64::from);
        normal += across;
        right += across * SMatrix::<f64, 3, 1>::new(x, y, z);
    }
    let point = normal.cholesky()?.solve(&right);
    Some([point.x, point.y, point.z])
}

/// True if the errors are as large as stated: χ² with two degrees of freedom per ray.
fn is_consistent(fit: &MotionFit, rays: &[RobotRay], config: &FlightConfig) -> bool {
    let freedom = 2.0 * rays.len() as f64;
    let outliers = rays.len() - fit.inliers;
    // Outliers count by their number alone.
    let limit = f64::from(config.outlier_sigmas);
    let allowed = freedom + CONSISTENT_SIGMAS * (2.0 * freedom).sqrt();
    fit.chi_squared + fit.shared_errors <= allowed + outliers as f64 * limit * limit
        && 8 * outliers <= rays.len()
        // The newest rays disagree after a kick.
        && fit.new_outliers <= 1
}
