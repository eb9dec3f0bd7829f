//! Where do the team's rays to the ball meet? Those of the last moments, our own included.

use crate::estimate::Estimate;
use crate::flight::{
    BallMotionMode, BallRay, FlightConfig, RobotRay, predict_landing, triangulate,
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

/// Most rays that are kept: eight robots at 30 images per second for a quarter of a second.
const RAYS_MAX: usize = 64;

/// Rays of the last moments.
#[derive(Debug, Clone, Default)]
pub(super) struct TeamRays {
    config: FlightConfig,
    rays: Vec<RobotRay>,
}

impl TeamRays {
    pub(super) fn new(config: &FlightConfig) -> Self {
        TeamRays {
            config: config.clone(),
            rays: Vec::new(),
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
        let finite = pose_std.iter().all(|std| std.is_finite() && *std >= 0.0);
        if finite {
            self.rays.push(RobotRay {
                robot,
                ray,
                pose_std,
            });
        }
    }

    /// The ball by the rays before an image.
    pub(super) fn triangulate(&mut self, stamp: Stamp) -> Option<TeamBallInSpace> {
        let window = f64::from(self.config.team_window);
        // A ray of the future is of another clock.
        self.rays
            .retain(|ray| (-window..=2.0 * window).contains(&ray.ray.stamp.seconds_until(stamp)));
        if self.rays.len() > RAYS_MAX {
            self.rays.drain(..self.rays.len() - RAYS_MAX);
        }
        let ball = triangulate(&self.rays, &self.config)?;
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
