//! What does the correction by team-mates add to an image?

use std::hint::black_box;
use std::time::Instant;

use localize::localizer::CooperativeConfig;
use localize::synthetic::drive::SyntheticSample;
use localize::team::{ReportedObstacle, TeamConfig, TeamModel, TeamReport};
use localize::world::{TrackedObject, WorldView};
use localize::{At, Field, LocalizeConfig, Localizer, Pose};
use nalgebra::Matrix4;

/// Passes over the drive: the least time of an image counts, without what else the machine did.
const PASSES: usize = 5;
/// Images with line points before the robot is blind.
const SIGHTED: usize = 60;
/// Images without.
const BLIND: usize = 300;
/// Places of the mates on the field, metres.
const MATES: [[f32; 2]; 4] = [[-3.0, 1.0], [3.0, -2.0], [0.0, 4.0], [1.0, -4.0]];

/// Mean time that four mates add to an image without line points, milliseconds: each reports in every second image, sees
/// the robot and is seen by it. Images with and without mates alternate.
pub(super) fn added_time(field: &Field, frames: &[SyntheticSample]) -> f64 {
    let frames = &frames[..frames.len().min(SIGHTED + BLIND)];
    let base = Localizer::new(field, LocalizeConfig::default());
    let mut least = vec![[f64::INFINITY; 2]; frames.len()];
    for _ in 0..PASSES {
        let mut robots = [true, false].map(|mates| (mates, base.clone(), TeamModel::new(team())));
        for (index, (frame, least)) in frames.iter().zip(&mut least).enumerate() {
            for ((mates, localizer, team), least) in robots.iter_mut().zip(least) {
                let reports = if *mates && index >= SIGHTED {
                    reports(index, frame)
                } else {
                    Vec::new()
                };
                let world = world(frame);
                let started = Instant::now();
                localizer.add_odometry(&frame.odometry);
                localizer.add_compass(&frame.compass);
                for report in &reports {
                    team.receive(report);
                }
                let points = if index < SIGHTED {
                    &frame.points[..]
                } else {
                    &[]
                };
                let estimate = localizer.process_points(frame.stamp, points);
                let mut view = team.update(frame.stamp, &world, &estimate);
                let sightings = team.take_sightings(&estimate);
                let outcomes =
                    localizer.apply_team_sightings(&sightings, &CooperativeConfig::default());
                view.sightings = team.judge_sightings(&sightings, &outcomes);
                black_box(view);
                *least = least.min(started.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    // At first the pose needs no mates.
    let blind = least.iter().skip(SIGHTED + BLIND / 2);
    let added = blind.map(|[with, without]| with - without);
    added.sum::<f64>() / (frames.len() - SIGHTED - BLIND / 2) as f64
}

fn team() -> TeamConfig {
    TeamConfig {
        number: 100,
        ..TeamConfig::default()
    }
}

/// What every second of the mates reports: the robot, and the other mates.
fn reports(index: usize, frame: &SyntheticSample) -> Vec<TeamReport> {
    let robot = frame.true_pose.origin();
    let report = |(number, at): (usize, &[f32; 2])| {
        let others = MATES.iter().filter(|other| *other != at);
        let places = others.map(|[x, y]| At::new(*x, *y));
        TeamReport {
            robot: number as u32,
            is_member: true,
            stamp: frame.stamp,
            pose: Some(Pose::new(at[0], at[1], 0.0)),
            pose_std: [0.03, 0.03, 0.01],
            half_known: true,
            pose_by_markings: true,
            ball: None,
            obstacles: std::iter::once(robot)
                .chain(places)
                .map(|at| ReportedObstacle {
                    at,
                    covariance: [2e-3, 0.0, 2e-3],
                })
                .collect(),
            ball_sighting: None,
        }
    };
    let due = MATES.iter().enumerate();
    due.filter(|(number, _)| (number + index).is_multiple_of(2))
        .map(report)
        .collect()
}

/// The mates as the robot sees them.
fn world(frame: &SyntheticSample) -> WorldView {
    let robots = MATES.iter().map(|[x, y]| TrackedObject {
        id: 0,
        at: frame.true_pose.inverse() * At::new(*x, *y),
        velocity: [0.0; 2],
        covariance: Matrix4::from_diagonal_element(2e-3),
        on_field: None,
        probability: 0.9,
        last_seen: frame.stamp,
        team: None,
    });
    WorldView {
        robots: robots.collect(),
        ..WorldView::default()
    }
}
