//! Where is the ball according to the whole team? Shared measurements fused by covariance, with the outliers listed.
//!
//! A team-mate may be lost, assume the wrong half of the field, detect something else, or report an old ball. Reported
//! covariances alone are not trusted: the largest group of consistent balls is fused, and of equal groups the one that
//! includes the own ball (after lima2001 5, sharing among team-mates).

mod ball_fusion;
mod config;
mod pose_origin;
mod rays;
mod report;
mod sightings;
#[cfg(test)]
mod tests;

use nalgebra::Matrix2;

pub use ball_fusion::{BallMeasurement, TeamBall, fuse_balls};
pub use config::TeamConfig;
pub use rays::TeamBallInSpace;
pub use report::{ReportedBall, ReportedObstacle, TeamReport};

use pose_origin::PoseOrigin;
use rays::TeamRays;
use report::is_plausible;
use sightings::SightingHistory;

use crate::estimate::Estimate;
use crate::flight::FlightConfig;
use crate::frames::{At, Pose};
use crate::localizer::{SightingDirection, SightingOutcome, TeamSighting};
use crate::stamp::Stamp;
use crate::world::WorldView;

/// The team's knowledge at an image's stamp.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TeamView {
    /// The fused ball of the largest consistent group, our own included.
    pub ball: Option<TeamBall>,
    /// Team-mates with a recent report, sorted by number.
    pub teammates: Vec<Teammate>,
    /// Log odds of our half of the field from the team's ball; 0 if the half is known already.
    pub half_log_odds: f32,
    /// The ball where the rays of several robots meet. None if fewer than two robots see it.
    pub triangulated: Option<TeamBallInSpace>,
    /// True if our pose rests on our own sight of the field's markings, and on no team-mate's.
    pub pose_by_markings: bool,
    /// Sightings between us and team-mates that could correct our pose.
    pub sightings: Vec<JudgedSighting>,
}

/// A sighting between us and a team-mate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JudgedSighting {
    /// The team-mate's number.
    pub robot: u32,
    /// Who saw whom.
    pub direction: SightingDirection,
    /// What became of it.
    pub outcome: SightingOutcome,
}

/// A team-mate.
#[derive(Debug, Clone, PartialEq)]
pub struct Teammate {
    /// Its number.
    pub robot: u32,
    /// Age of its last report, seconds.
    pub age: f32,
    /// Its reported pose.
    pub pose: Option<Pose>,
    /// True if its ball agrees with the fused one. None if it reported no ball or no other robot did.
    pub ball_agrees: Option<bool>,
}

/// Receives the team's reports and fuses their balls.
#[derive(Debug, Clone)]
pub struct TeamModel {
    config: TeamConfig,
    /// The latest report of each robot, sorted by number.
    reports: Vec<TeamReport>,
    rays: TeamRays,
    history: SightingHistory,
    pose_origin: PoseOrigin,
}

impl TeamModel {
    /// A model without reports.
    pub fn new(config: TeamConfig) -> Self {
        TeamModel {
            config,
            reports: Vec::new(),
            rays: TeamRays::new(&FlightConfig::default()),
            history: SightingHistory::default(),
            pose_origin: PoseOrigin::default(),
        }
    }

    /// Combines rays to the ball with these settings.
    #[must_use]
    pub fn with_flight(mut self, config: &FlightConfig) -> Self {
        self.rays = TeamRays::new(config);
        self
    }

    /// Adds a report. Reports out of order, our own and implausible ones are ignored.
    pub fn receive(&mut self, report: &TeamReport) {
        if report.robot == self.config.number || !is_plausible(report) {
            return;
        }
        match self
            .reports
            .binary_search_by_key(&report.robot, |known| known.robot)
        {
            Ok(index) => {
                let known = &mut self.reports[index];
                // A stamp far in the past means that the sender's clock was reset.
                let back = report.stamp.seconds_until(known.stamp) as f32;
                if back < 0.0 || back > self.config.ball_age_max {
                    known.clone_from(report);
                    self.rays.add_report(report);
                    self.history.add_report(report);
                }
            }
            Err(_) if self.make_place_for(report) => {
                let index = self
                    .reports
                    .partition_point(|known| known.robot < report.robot);
                self.reports.insert(index, report.clone());
                self.rays.add_report(report);
                self.history.add_report(report);
            }
            Err(_) => {}
        }
    }

    /// True if there is a place for a report of a new number. A member of the team takes that of another number, the one with
    /// the oldest report.
    fn make_place_for(&mut self, report: &TeamReport) -> bool {
        if self.reports.len() < self.config.teammates_max {
            return true;
        }
        let others = self.reports.iter().enumerate();
        let replaceable = others.filter(|(_, known)| report.is_member && !known.is_member);
        let replaced = replaceable.min_by_key(|(_, known)| known.stamp);
        let Some((index, _)) = replaced else {
            return false;
        };
        self.reports.remove(index);
        true
    }

    /// The team's knowledge at an image's stamp, our own world model included.
    pub fn update(&mut self, stamp: Stamp, world: &WorldView, estimate: &Estimate) -> TeamView {
        let age = |report: &TeamReport| report.stamp.seconds_until(stamp) as f32;
        // A report farther in the future than any clock error is of another run.
        let (config, age_min) = (&self.config, -self.config.ball_age_max);
        self.reports
            .retain(|report| (age_min..=config.report_timeout).contains(&age(report)));
        let others: Vec<BallMeasurement> = self
            .reports
            .iter()
            .filter(|report| report.pose.is_some())
            .filter_map(|report| self.ball_measurement(report, stamp))
            .collect();
        let half_log_odds = self.half_log_odds(&others, world, estimate);
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
        let fused = fuse_balls(&all, config.number, config);
        let agrees = |robot: u32| {
            let fused = fused.as_ref().filter(|_| all.len() > 1)?;
            let has_ball = all.iter().any(|measurement| measurement.robot == robot);
            has_ball.then(|| fused.inliers.contains(&robot))
        };
        let teammates = self.reports.iter().map(|report| Teammate {
            robot: report.robot,
            age: age(report).max(0.0),
            pose: report.pose,
            ball_agrees: agrees(report.robot),
        });
        self.rays.add_own(config.number, stamp, world, estimate);
        self.history.add_image(stamp, world, estimate);
        TeamView {
            pose_by_markings: self.pose_origin.update(estimate, &config.cooperative),
            sightings: Vec::new(),
            triangulated: self.rays.triangulate(stamp),
            teammates: teammates.collect(),
            half_log_odds,
            ball: fused,
        }
    }

    /// Sightings by the reports since the last image, for the localizer to apply. Empty while the pose is certain enough.
    pub fn take_sightings(&mut self, estimate: &Estimate) -> Vec<TeamSighting> {
        let config = &self.config.cooperative;
        let is_helpful = config.enabled
            && estimate.half_known
            && estimate.pose.is_some()
            && self.pose_origin.needs_mates(estimate, config);
        if !is_helpful {
            self.history.skip_reports();
            return Vec::new();
        }
        self.history
            .take_sightings(estimate.stamp, &self.reports, &self.config)
    }

    /// Takes note of what became of the sightings.
    pub fn judge_sightings(
        &mut self,
        sightings: &[TeamSighting],
        outcomes: &[SightingOutcome],
    ) -> Vec<JudgedSighting> {
        if outcomes.contains(&SightingOutcome::Used) {
            self.pose_origin.mark_corrected();
        }
        let pairs = sightings.iter().zip(outcomes);
        pairs
            .map(|(sighting, outcome)| JudgedSighting {
                robot: sighting.robot,
                direction: sighting.direction,
                outcome: *outcome,
            })
            .collect()
    }

    /// A report's ball predicted to `stamp`, with added process noise; None if it is too old.
    fn ball_measurement(&self, report: &TeamReport, stamp: Stamp) -> Option<BallMeasurement> {
        let config = &self.config;
        let ball = report.ball?;
        let unseen = ball.last_seen.seconds_until(stamp) as f32;
        let age = (report.stamp.seconds_until(stamp) as f32).max(0.0);
        if unseen > config.ball_age_max || !report.half_known {
            return None;
        }
        let acceleration_variance =
            config.ball_acceleration_noise * config.ball_acceleration_noise * age * age * age / 3.0;
        // The reported velocity has an error, too.
        let velocity_error = config.velocity_std * age;
        let added_variance = acceleration_variance + velocity_error * velocity_error;
        let [vx, vy] = ball.velocity;
        let [xx, xy, yy] = ball.covariance;
        Some(BallMeasurement {
            robot: report.robot,
            at: At::new(ball.at.x + vx * age, ball.at.y + vy * age),
            velocity: ball.velocity,
            covariance: [xx + added_variance, xy, yy + added_variance],
        })
    }

    /// Log odds of our half of the field against the other, from our own ball and the others' fused ball.
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
        let innovation_covariance =
            own.covariance.fixed_view::<2, 2>(0, 0) + Matrix2::new(xx, xy, xy, yy);
        let Some(inverse) = innovation_covariance.try_inverse() else {
            return 0.0;
        };
        // The field is symmetric: in the other half the ball would lie at the opposite point.
        let cost = |sign: f32| {
            let off = nalgebra::Vector2::new(
                theirs.at.x - sign * own.at.x,
                theirs.at.y - sign * own.at.y,
            );
            0.5 * (off.transpose() * inverse * off).x
        };
        let (cost_here, cost_opposite) = (cost(1.0), cost(-1.0));
        // A ball at neither point is another ball.
        if cost_here.min(cost_opposite) > 0.5 * config.gate {
            return 0.0;
        }
        (cost_opposite - cost_here).clamp(-config.half_log_odds_max, config.half_log_odds_max)
    }
}
