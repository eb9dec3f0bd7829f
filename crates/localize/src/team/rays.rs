//! Where do the team's rays to the ball meet? Those of the last moments, our own included.

use crate::estimate::Estimate;
use crate::flight::{
    BallMotionMode, BallRay, FlightConfig, RobotRay, TeamFlightTracker, predict_landing,
};
use crate::frames::{Pose, wrap_angle};
use crate::math;
use crate::stamp::Stamp;
use crate::world::{AirborneState, BallSighting, WorldView};

use super::report::TeamReport;

/// The ball in space by the rays of several robots, field frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamBallInSpace {
    /// How it moves.
    pub mode: BallMotionMode,
    /// Position and velocity at the newest ray's time.
    pub state: AirborneState,
    /// Numbers of the robots whose rays agree, sorted.
    pub inliers: Vec<u32>,
    /// Numbers of the robots whose rays disagree, sorted.
    pub outliers: Vec<u32>,
}

/// Rays of the last moments.
#[derive(Debug, Clone)]
pub(super) struct TeamRays {
    config: FlightConfig,
    tracker: TeamFlightTracker,
    /// Rays that are not added yet: a ray of the future is of another clock.
    waiting: Vec<RobotRay>,
}

/// Most waiting rays.
const WAITING_MAX: usize = 64;

impl TeamRays {
    pub(super) fn new(config: &FlightConfig) -> Self {
        TeamRays {
            config: config.clone(),
            tracker: TeamFlightTracker::new(config.clone()),
            waiting: Vec::new(),
        }
    }

    /// Adds the ray of a team-mate that knows its pose and its half.
    pub(super) fn add_report(&mut self, report: &TeamReport) {
        let (Some(sighting), Some(pose)) = (&report.ball_sighting, report.pose) else {
            return;
        };
        if report.half_known {
            let [x, y, theta] = report.pose_std;
            self.add(
                report.robot,
                field_ray(report.stamp, sighting.azimuth, sighting, &pose),
                [math::hypot(x, y) * std::f32::consts::FRAC_1_SQRT_2, theta],
            );
        }
    }

    /// Adds our own ray.
    pub(super) fn add_own(
        &mut self,
        number: u32,
        stamp: Stamp,
        world: &WorldView,
        estimate: &Estimate,
    ) {
        let (Some(sighting), Some(pose)) = (&world.ball_sighting, estimate.pose) else {
            return;
        };
        if estimate.half_known {
            let variance = |axis: usize| estimate.covariance[(axis, axis)].max(0.0);
            let position = (0.5 * (variance(0) + variance(1))).sqrt();
            let azimuth = wrap_angle(sighting.azimuth + pose.theta);
            let ray = field_ray(stamp, azimuth, sighting, &pose);
            self.add(number, ray, [position, variance(2).sqrt()]);
        }
    }

    fn add(&mut self, robot: u32, ray: BallRay, pose_std: [f32; 2]) {
        if self.waiting.len() < WAITING_MAX {
            self.waiting.push(RobotRay {
                robot,
                ray,
                pose_std,
            });
        }
    }

    /// The ball by the rays before an image.
    pub(super) fn triangulate(&mut self, stamp: Stamp) -> Option<TeamBallInSpace> {
        let window = f64::from(self.config.team_window);
        for ray in self.waiting.drain(..) {
            let age = ray.ray.stamp.seconds_until(stamp);
            if (-window..=2.0 * window).contains(&age) {
                self.tracker.add(&ray);
            }
        }
        let ball = self.tracker.ball()?;
        // The last ball is no news.
        if ball.state.stamp.seconds_until(stamp) > window {
            return None;
        }
        let landing = (ball.mode == BallMotionMode::Flight)
            .then(|| predict_landing(&ball.state, &self.config))
            .flatten();
        Some(TeamBallInSpace {
            mode: ball.mode,
            state: AirborneState::new(&ball.state, landing),
            inliers: ball.inliers,
            outliers: ball.outliers,
        })
    }
}

fn field_ray(stamp: Stamp, azimuth: f32, sighting: &BallSighting, pose: &Pose) -> BallRay {
    let [azimuth_std, elevation_std] = sighting.std;
    BallRay {
        stamp,
        origin: [pose.x, pose.y, sighting.viewpoint_height],
        azimuth,
        elevation: sighting.elevation,
        azimuth_std,
        elevation_std,
        distance: sighting.distance,
    }
}
