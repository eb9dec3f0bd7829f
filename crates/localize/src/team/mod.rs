//! Where is the ball, says everyone? The team's sightings merged by covariance, and who is in the wrong.
//!
//! A team-mate may be lost, stand in the wrong half, take something else for the ball, or speak of a past one. Nobody
//! is believed for what he claims of himself: the largest group whose balls agree is, and of equal groups the one we
//! are in (after lima2001 5, sharing among team-mates).

mod ball_fusion;
mod config;
#[cfg(test)]
mod tests;

use nalgebra::Matrix2;

pub use ball_fusion::{BallMeasurement, FusedBall, fuse_balls};
pub use config::TeamConfig;

use crate::estimate::Estimate;
use crate::frames::{At, FieldFrame, Pose};
use crate::stamp::Stamp;
use crate::world::WorldView;

/// What a team-mate says of itself and of what it sees, at one moment of our own clock.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamReport {
    /// Its number in the team.
    pub robot: u32,
    /// When what it says was so, by our clock.
    pub stamp: Stamp,
    /// Where it stands; none while it is lost.
    pub pose: Option<Pose>,
    /// Standard deviations of x, y (metres) and θ (radians).
    pub pose_std: [f32; 3],
    /// Does it know its half of the field?
    pub half_known: bool,
    /// The ball that it sees.
    pub ball: Option<ReportedBall>,
    /// Robots that it sees, metres.
    pub obstacles: Vec<At<FieldFrame>>,
}

/// A ball on the field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReportedBall {
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance of the position: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// When it was last seen, by the clock of the report.
    pub last_seen: Stamp,
}

/// What the team knows at a frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TeamView {
    /// The ball that most agree on; our own in it.
    pub ball: Option<TeamBall>,
    /// Team-mates that were heard of lately, by number.
    pub teammates: Vec<Teammate>,
    /// Log odds by which the team's ball spoke for our half of the field in this frame; 0 where it was not asked.
    pub half_log_odds: f32,
}

/// The ball by common knowledge.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamBall {
    /// Metres.
    pub at: At<FieldFrame>,
    /// m/s.
    pub velocity: [f32; 2],
    /// Covariance of the position: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Who sees it there; ourselves as our own number.
    pub inliers: Vec<u32>,
    /// Who sees it elsewhere.
    pub outliers: Vec<u32>,
}

/// A team-mate.
#[derive(Debug, Clone, PartialEq)]
pub struct Teammate {
    /// Its number.
    pub robot: u32,
    /// How old its last word is, seconds.
    pub age: f32,
    /// Where it stood then.
    pub pose: Option<Pose>,
    /// Does its ball agree with the others'? None where it saw none or nobody else did.
    pub agrees: Option<bool>,
}

/// Hears the team and merges what it says.
#[derive(Debug, Clone)]
pub struct TeamModel {
    config: TeamConfig,
    /// The latest of each, by number.
    reports: Vec<TeamReport>,
}

impl TeamModel {
    /// Has heard nobody yet.
    pub fn new(config: TeamConfig) -> Self {
        TeamModel {
            config,
            reports: Vec::new(),
        }
    }

    /// Takes a report; older ones than the last of that robot, our own echo and what is no number are left out.
    pub fn receive(&mut self, report: &TeamReport) {
        if report.robot == self.config.number || !is_plausible(report) {
            return;
        }
        match self
            .reports
            .binary_search_by_key(&report.robot, |known| known.robot)
        {
            Ok(found) => {
                let known = &mut self.reports[found];
                // A clock that was set back a long way speaks of now all the same.
                let back = report.stamp.seconds_until(known.stamp) as f32;
                if back < 0.0 || back > self.config.ball_age_max {
                    known.clone_from(report);
                }
            }
            Err(place) if self.reports.len() < self.config.teammates_max => {
                self.reports.insert(place, report.clone());
            }
            Err(_) => {}
        }
    }

    /// What the team knows at a frame, our own world in it.
    pub fn update(&mut self, stamp: Stamp, world: &WorldView, estimate: &Estimate) -> TeamView {
        let age = |report: &TeamReport| report.stamp.seconds_until(stamp) as f32;
        // What comes from further ahead than clocks err is of another run.
        let (config, ahead) = (&self.config, -self.config.ball_age_max);
        self.reports
            .retain(|report| (ahead..=config.report_timeout).contains(&age(report)));
        let others: Vec<BallMeasurement> = self
            .reports
            .iter()
            .filter(|report| report.pose.is_some())
            .filter_map(|report| self.ball_measurement(report, stamp))
            .collect();
        let half_evidence = self.half_log_odds(&others, world, estimate);
        let own = world.ball.and_then(|ball| {
            let on_field = ball.on_field?;
            let p = on_field.covariance;
            Some(BallMeasurement {
                robot: config.number,
                at: on_field.at,
                velocity: on_field.velocity,
                covariance: [p[(0, 0)], p[(0, 1)], p[(1, 1)]],
            })
        });
        let mut all: Vec<BallMeasurement> = own
            .filter(|_| estimate.half_known || others.is_empty())
            .into_iter()
            .collect();
        all.extend(&others);
        let merged = fuse_balls(&all, config.number, config);
        let agrees = |robot: u32| {
            let merged = merged.as_ref().filter(|_| all.len() > 1)?;
            let knows = all.iter().any(|witness| witness.robot == robot);
            knows.then(|| merged.inliers.contains(&robot))
        };
        let mates = self.reports.iter().map(|report| Teammate {
            robot: report.robot,
            age: age(report).max(0.0),
            pose: report.pose,
            agrees: agrees(report.robot),
        });
        TeamView {
            teammates: mates.collect(),
            half_log_odds: half_evidence,
            ball: merged.map(|merged| TeamBall {
                at: merged.at,
                velocity: merged.velocity,
                covariance: merged.covariance,
                inliers: merged.inliers,
                outliers: merged.outliers,
            }),
        }
    }

    /// A report's ball as it is now, vaguer for its age; none if it is too old.
    fn ball_measurement(&self, report: &TeamReport, stamp: Stamp) -> Option<BallMeasurement> {
        let config = &self.config;
        let ball = report.ball?;
        let unseen = ball.last_seen.seconds_until(stamp) as f32;
        let age = (report.stamp.seconds_until(stamp) as f32).max(0.0);
        if unseen > config.ball_age_max || !report.half_known {
            return None;
        }
        let wander =
            config.ball_acceleration_noise * config.ball_acceleration_noise * age * age * age / 3.0;
        // Its velocity is not known exactly either.
        let drift = config.velocity_std * age;
        let blur = wander + drift * drift;
        let [vx, vy] = ball.velocity;
        let [xx, xy, yy] = ball.covariance;
        Some(BallMeasurement {
            robot: report.robot,
            at: At::new(ball.at.x + vx * age, ball.at.y + vy * age),
            velocity: ball.velocity,
            covariance: [xx + blur, xy, yy + blur],
        })
    }

    /// Log odds that our half is right rather than the other, by where the others see the ball that we see.
    fn half_log_odds(
        &self,
        others: &[BallMeasurement],
        world: &WorldView,
        estimate: &Estimate,
    ) -> f32 {
        let config = &self.config;
        if estimate.half_known {
            return 0.0;
        }
        let own = world.ball.and_then(|ball| ball.on_field);
        let (Some(own), Some(theirs)) = (own, fuse_balls(others, config.number, config)) else {
            return 0.0;
        };
        let [xx, xy, yy] = theirs.covariance;
        let spread = own.covariance.fixed_view::<2, 2>(0, 0) + Matrix2::new(xx, xy, xy, yy);
        let Some(inverse) = spread.try_inverse() else {
            return 0.0;
        };
        // The field looks the same from the other half: the ball would lie at the opposite point.
        let unlikeliness = |sign: f32| {
            let off = nalgebra::Vector2::new(
                theirs.at.x - sign * own.at.x,
                theirs.at.y - sign * own.at.y,
            );
            // Someone may see another ball: no sight is worth more than that doubt.
            0.5 * (off.transpose() * inverse * off).x
        };
        let (here, there) = (unlikeliness(1.0), unlikeliness(-1.0));
        // A ball that is in neither place says nothing.
        if here.min(there) > 0.5 * config.gate {
            return 0.0;
        }
        (there - here).clamp(-config.half_log_odds_max, config.half_log_odds_max)
    }
}

/// Numbers that can be of a field.
fn is_plausible(report: &TeamReport) -> bool {
    let place = |x: f32, y: f32| x.abs() < 100.0 && y.abs() < 100.0;
    let pose = report
        .pose
        .is_none_or(|pose| place(pose.x, pose.y) && pose.theta.is_finite());
    let ball = report.ball.is_none_or(|ball| {
        let [xx, xy, yy] = ball.covariance;
        place(ball.at.x, ball.at.y)
            && ball.velocity.iter().all(|speed| speed.abs() < 100.0)
            && xx >= 0.0
            && yy >= 0.0
            && xx * yy - xy * xy >= 0.0
            && xx + yy < 1e4
    });
    pose && ball && report.obstacles.iter().all(|at| place(at.x, at.y))
}
