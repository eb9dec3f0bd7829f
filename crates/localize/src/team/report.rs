//! What does a team-mate report, and is it plausible?

use crate::frames::{At, FieldFrame, Pose};
use crate::stamp::Stamp;
use crate::world::BallSighting;

/// A team-mate's state and detections at one time of our own clock.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamReport {
    /// Its number in the team.
    pub robot: u32,
    /// True if the team lists the number: it takes the place of one that is not listed.
    pub is_member: bool,
    /// Time of the reported state, by our clock.
    pub stamp: Stamp,
    /// Its pose; None while it is lost.
    pub pose: Option<Pose>,
    /// Standard deviations of x, y (metres) and θ (radians).
    pub pose_std: [f32; 3],
    /// True if it has resolved its half of the field.
    pub half_known: bool,
    /// Its ball.
    pub ball: Option<ReportedBall>,
    /// True if its pose rests on its own sight of the field's markings, and on no team-mate's: it may correct others.
    pub pose_by_markings: bool,
    /// Robots that it tracks.
    pub obstacles: Vec<ReportedObstacle>,
    /// Direction in which it saw the ball at `stamp`, field frame: its azimuth includes its heading.
    pub ball_sighting: Option<BallSighting>,
}

/// A robot that a team-mate tracks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReportedObstacle {
    /// Metres.
    pub at: At<FieldFrame>,
    /// Covariance of the position, that of the team-mate's pose included: xx, xy, yy, m².
    pub covariance: [f32; 3],
}

/// A team-mate's ball on the field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReportedBall {
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance of the position: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Time of the last detection, by the clock of the report.
    pub last_seen: Stamp,
}

/// True if positions, velocities and covariances are finite and of a field's size.
pub(super) fn is_plausible(report: &TeamReport) -> bool {
    let is_near = |x: f32, y: f32| x.abs() < 100.0 && y.abs() < 100.0;
    let pose = report
        .pose
        .is_none_or(|pose| is_near(pose.x, pose.y) && pose.theta.is_finite());
    let ball = report.ball.is_none_or(|ball| {
        is_near(ball.at.x, ball.at.y)
            && ball.velocity.iter().all(|speed| speed.abs() < 100.0)
            && is_covariance(ball.covariance)
    });
    let obstacles = report
        .obstacles
        .iter()
        .all(|obstacle| is_near(obstacle.at.x, obstacle.at.y));
    let pose_std = report.pose_std.iter().all(|std| (0.0..1e3).contains(std));
    let sighting = report.ball_sighting.is_none_or(|sighting| {
        let [azimuth, elevation] = sighting.std;
        sighting.azimuth.abs() < 100.0
            && sighting.elevation.abs() < 2.0
            && (1e-5..10.0).contains(&azimuth)
            && (1e-5..10.0).contains(&elevation)
            && (0.0..10.0).contains(&sighting.viewpoint_height)
    });
    pose && pose_std && ball && sighting && obstacles
}

/// True if finite, not negative and below that of a field.
pub(super) fn is_covariance([xx, xy, yy]: [f32; 3]) -> bool {
    xx >= 0.0 && yy >= 0.0 && xx * yy - xy * xy >= 0.0 && xx + yy < 1e4
}
