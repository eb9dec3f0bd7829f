//! Which robots that team-mates saw may be this one, and which robots that this one saw may be team-mates?

use std::collections::VecDeque;

use nalgebra::{Matrix2, Matrix4, Vector2};

use super::config::TeamConfig;
use super::report::{ReportedObstacle, TeamReport, is_covariance};
use crate::estimate::Estimate;
use crate::frames::{At, FieldFrame, Pose, RobotFrame};
use crate::localizer::{
    CooperativeConfig, SightingDirection, SightingPair, SightingRival, TeamSighting,
};
use crate::math;
use crate::stamp::Stamp;
use crate::world::WorldView;

/// Images kept: more than `delay_max` at 60 images per second.
const IMAGES_MAX: usize = 64;
/// Reports that wait for the next image.
const WAITING_MAX: usize = 32;
/// Longest time between an image and a mate's image at which both saw each other, seconds.
const IMAGE_OFFSET_MAX: f64 = 0.05;
/// Longest time since the last detection of a robot that counts as seen, seconds.
const UNSEEN_MAX: f64 = 0.1;
/// Largest standard deviation of a robot that was seen, metres: a larger one says nothing.
const SEEN_STD_MAX: f32 = 0.5;
/// Speed that a robot whose velocity is not reported may have, m/s.
const UNKNOWN_SPEED: f32 = 1.0;
/// Time in seconds after which a mate's pose says nothing about where it is.
const MATE_AGE_MAX: f64 = 1.0;

/// A robot that this one saw.
#[derive(Debug, Clone, Copy)]
struct SeenRobot {
    at: At<RobotFrame>,
    /// Over the ground, robot axes, m/s.
    velocity: [f32; 2],
    /// m², robot frame.
    covariance: Matrix2<f32>,
}

/// What this robot saw in an image.
#[derive(Debug, Clone)]
struct OwnImage {
    stamp: Stamp,
    /// Heading on the field.
    heading: f32,
    /// m/s.
    speed: f32,
    robots: Vec<SeenRobot>,
}

/// Last images of this robot, and reports that are not used yet.
#[derive(Debug, Clone, Default)]
pub(super) struct SightingHistory {
    images: VecDeque<OwnImage>,
    waiting: Vec<TeamReport>,
}

impl SightingHistory {
    /// Adds a report of a mate that can correct others.
    pub(super) fn add_report(&mut self, report: &TeamReport) {
        if report.pose_by_markings && report.half_known && self.waiting.len() < WAITING_MAX {
            self.waiting.push(report.clone());
        }
    }

    /// Adds an image of this robot.
    pub(super) fn add_image(&mut self, stamp: Stamp, world: &WorldView, estimate: &Estimate) {
        let Some(pose) = estimate.pose else {
            self.images.clear();
            return;
        };
        let is_newer = |image: &OwnImage| image.stamp < stamp;
        if !self.images.back().is_none_or(is_newer) {
            self.images.clear();
        }
        if self.images.len() == IMAGES_MAX {
            self.images.pop_front();
        }
        let seen = world.robots.iter().filter(|robot| {
            let variance = robot.covariance[(0, 0)].max(robot.covariance[(1, 1)]);
            robot.last_seen.seconds_until(stamp) <= UNSEEN_MAX
                && variance <= SEEN_STD_MAX * SEEN_STD_MAX
        });
        self.images.push_back(OwnImage {
            stamp,
            heading: pose.theta,
            speed: estimate
                .twist
                .map_or(0.0, |twist| math::hypot(twist.x, twist.y)),
            robots: seen
                .map(|robot| SeenRobot {
                    at: robot.at,
                    velocity: robot.velocity,
                    covariance: position_block(&robot.covariance),
                })
                .collect(),
        });
    }

    /// Forgets the waiting reports: the pose needs none of them.
    pub(super) fn skip_reports(&mut self) {
        self.waiting.clear();
    }

    /// What the reports since the last call say about this robot. `mates`: the newest report of each.
    pub(super) fn take_sightings(
        &mut self,
        stamp: Stamp,
        mates: &[TeamReport],
        config: &TeamConfig,
    ) -> Vec<TeamSighting> {
        let config = &config.cooperative;
        let delay_max = f64::from(config.delay_max);
        let waiting = std::mem::take(&mut self.waiting);
        let recent = waiting.iter().filter(|report| {
            let age = report.stamp.seconds_until(stamp);
            (-delay_max..=delay_max).contains(&age)
        });
        let mut sightings = Vec::new();
        for report in recent {
            let (Some(pose), Some(image)) = (report.pose, self.image_near(report.stamp)) else {
                continue;
            };
            let others: Vec<MatePlace> = mates
                .iter()
                .filter(|mate| mate.robot != report.robot)
                .filter_map(|mate| MatePlace::at(mate, report.stamp))
                .collect();
            sightings.push(seen_by_mate(report, image, &others, config));
            if image.stamp.seconds_until(report.stamp).abs() <= IMAGE_OFFSET_MAX {
                sightings.push(seen_mate(report, pose, image, &others, config));
            }
        }
        sightings.retain(|sighting| !sighting.pairs.is_empty());
        sightings
    }

    fn image_near(&self, stamp: Stamp) -> Option<&OwnImage> {
        let offset = |image: &&OwnImage| image.stamp.0.abs_diff(stamp.0);
        self.images.iter().min_by_key(offset)
    }
}

/// Where another mate is.
struct MatePlace {
    at: At<FieldFrame>,
    covariance: Matrix2<f32>,
}

impl MatePlace {
    /// None without a pose, or if it is too old.
    fn at(report: &TeamReport, stamp: Stamp) -> Option<Self> {
        let pose = report.pose?;
        let age = report.stamp.seconds_until(stamp).abs();
        let moved = UNKNOWN_SPEED * age as f32;
        let [x, y] = mate_variance(report).map(|variance| variance + moved * moved);
        (age <= MATE_AGE_MAX).then(|| MatePlace {
            at: pose.origin(),
            covariance: Matrix2::new(x, 0.0, 0.0, y),
        })
    }
}

/// The robots that a mate saw, any of which may be this one.
fn seen_by_mate(
    report: &TeamReport,
    image: &OwnImage,
    others: &[MatePlace],
    config: &CooperativeConfig,
) -> TeamSighting {
    let noise = added_variance(image.speed, config);
    let is_seen = |obstacle: &&ReportedObstacle| {
        let [xx, _, yy] = obstacle.covariance;
        is_covariance(obstacle.covariance) && xx.max(yy) <= SEEN_STD_MAX * SEEN_STD_MAX
    };
    let is_other = |obstacle: &ReportedObstacle| {
        others.iter().any(|mate| {
            let covariance = matrix_of(obstacle.covariance) + mate.covariance;
            let offset = Vector2::new(obstacle.at.x - mate.at.x, obstacle.at.y - mate.at.y);
            covariance
                .try_inverse()
                .is_some_and(|inverse| offset.dot(&(inverse * offset)) <= config.gate)
        })
    };
    let pairs: Vec<SightingPair> = report
        .obstacles
        .iter()
        .filter(is_seen)
        .filter(|obstacle| !is_other(obstacle))
        .map(|obstacle| {
            let [xx, xy, yy] = obstacle.covariance;
            SightingPair {
                from_robot: At::new(0.0, 0.0),
                on_field: obstacle.at,
                covariance: [xx + noise, xy, yy + noise],
            }
        })
        .collect();
    let seconds = image.stamp.seconds_until(report.stamp) as f32;
    let rivals = pairs.iter().enumerate().flat_map(|(index, pair)| {
        image.robots.iter().map(move |robot| {
            let own = robot.on_field_axes(image.heading);
            SightingRival {
                pair: index,
                explanation: SightingPair {
                    from_robot: robot.at_after(seconds),
                    on_field: pair.on_field,
                    covariance: add(pair.covariance, &own),
                },
            }
        })
    });
    TeamSighting {
        robot: report.robot,
        direction: SightingDirection::ByMate,
        stamp: report.stamp,
        mate_variance: mate_variance(report),
        rivals: rivals.collect(),
        pairs,
    }
}

/// The robots that this one saw, any of which may be the mate.
fn seen_mate(
    report: &TeamReport,
    pose: Pose,
    image: &OwnImage,
    others: &[MatePlace],
    config: &CooperativeConfig,
) -> TeamSighting {
    let seconds = image.stamp.seconds_until(report.stamp) as f32;
    let [x, y] = mate_variance(report);
    let mut pairs = Vec::new();
    let mut rivals = Vec::new();
    for (index, robot) in image.robots.iter().enumerate() {
        let from_robot = robot.at_after(seconds);
        let own = robot.on_field_axes(image.heading);
        let noise = added_variance(math::hypot(robot.velocity[0], robot.velocity[1]), config);
        let explanation = |on_field: At<FieldFrame>, covariance: [f32; 3]| SightingPair {
            from_robot,
            on_field,
            covariance,
        };
        pairs.push(explanation(
            pose.origin(),
            add([x + noise, 0.0, y + noise], &own),
        ));
        // What the mate saw is not the mate, and neither are the others of the team.
        let places = report
            .obstacles
            .iter()
            .map(|obstacle| (obstacle.at, obstacle.covariance))
            .chain(others.iter().map(|mate| {
                let p = &mate.covariance;
                (mate.at, [p[(0, 0)], p[(0, 1)], p[(1, 1)]])
            }));
        rivals.extend(places.map(|(at, covariance)| SightingRival {
            pair: index,
            explanation: explanation(at, add(covariance, &own)),
        }));
    }
    TeamSighting {
        robot: report.robot,
        direction: SightingDirection::OfMate,
        stamp: image.stamp,
        mate_variance: mate_variance(report),
        pairs,
        rivals,
    }
}

impl SeenRobot {
    fn at_after(&self, seconds: f32) -> At<RobotFrame> {
        At::new(
            self.at.x + seconds * self.velocity[0],
            self.at.y + seconds * self.velocity[1],
        )
    }

    /// Covariance in the field's axes.
    fn on_field_axes(&self, heading: f32) -> Matrix2<f32> {
        let (sin, cos) = math::sin_cos(heading);
        let rotation = Matrix2::new(cos, -sin, sin, cos);
        rotation * self.covariance * rotation.transpose()
    }
}

/// Variance of what no covariance contains: calibration, and the clocks at the speed of the robot that was seen, m².
fn added_variance(speed: f32, config: &CooperativeConfig) -> f32 {
    let by_clock = speed * config.clock_std;
    config.position_std_min * config.position_std_min + by_clock * by_clock
}

/// Variances of a mate's position, m².
fn mate_variance(report: &TeamReport) -> [f32; 2] {
    let [x, y, _] = report.pose_std;
    [x * x, y * y]
}

fn matrix_of([xx, xy, yy]: [f32; 3]) -> Matrix2<f32> {
    Matrix2::new(xx, xy, xy, yy)
}

fn add([xx, xy, yy]: [f32; 3], other: &Matrix2<f32>) -> [f32; 3] {
    [xx + other[(0, 0)], xy + other[(0, 1)], yy + other[(1, 1)]]
}

fn position_block(covariance: &Matrix4<f32>) -> Matrix2<f32> {
    covariance.fixed_view::<2, 2>(0, 0).into_owned()
}
