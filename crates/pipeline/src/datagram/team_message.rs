//! What does a team message say, and is it plausible? Conversions from a cycle and to a report.

use localize::frames::{At, wrap_angle};
use localize::team::{ReportedBall, ReportedObstacle, TeamReport};
use localize::world::{BallSighting, TrackedObject};
use localize::{Pose, Stamp};

use super::message::{BallRay, ObjectState, TeamMessage};
use crate::cycle::Cycle;

/// Number of tracked robots in a message; the most probable ones are sent. Of a message with more the first ones are used.
pub(super) const MAX_OBSTACLES: usize = 16;
/// Standard deviation of a pose whose sender states none, metres and radians.
const UNSTATED_STD: f32 = 1.0;

/// A received message. `is_member`: the team lists its sender. `ours`: a time of the sender in our clock.
pub(super) fn report_from_message(
    message: &TeamMessage,
    is_member: bool,
    ours: impl Fn(i64) -> Stamp,
) -> TeamReport {
    let pose = message.pose.as_ref();
    // Without its errors a pose places the ball, but corrects nobody.
    let has_std = pose.is_some_and(|pose| !pose.std.is_empty());
    let std = |i: usize| {
        pose.and_then(|pose| pose.std.get(i))
            .copied()
            .unwrap_or(if pose.is_some() { UNSTATED_STD } else { 0.0 })
    };
    TeamReport {
        robot: message.robot,
        is_member,
        stamp: ours(message.stamp_ns),
        pose: pose.map(|pose| Pose::new(pose.x, pose.y, pose.theta)),
        pose_std: [std(0), std(1), std(2)],
        half_known: pose.is_some_and(|pose| pose.half_known),
        pose_by_markings: message.pose_by_markings && has_std,
        ball: message.ball.as_ref().and_then(|ball| {
            Some(ReportedBall {
                at: At::new(ball.x, ball.y),
                velocity: [ball.velocity_x, ball.velocity_y],
                covariance: ball.covariance[..].try_into().ok()?,
                last_seen: ours(message.ball_seen_ns),
            })
        }),
        obstacles: message
            .obstacles
            .iter()
            .take(MAX_OBSTACLES)
            .filter_map(|obstacle| {
                Some(ReportedObstacle {
                    at: At::new(obstacle.x, obstacle.y),
                    covariance: obstacle.covariance[..].try_into().ok()?,
                })
            })
            .collect(),
        ball_sighting: message.ball_ray.as_ref().map(|ray| BallSighting {
            azimuth: ray.azimuth,
            elevation: ray.elevation,
            std: [ray.azimuth_std, ray.elevation_std],
            viewpoint_height: ray.height,
            distance: None,
        }),
    }
}

/// The direction of the ball in the field frame; None while the robot is lost. One that others would refuse is not sent,
/// since they would refuse the whole message.
pub(super) fn ball_ray(cycle: &Cycle) -> Option<BallRay> {
    let (sighting, pose) = (cycle.world.ball_sighting?, cycle.estimate.pose?);
    let ray = BallRay {
        azimuth: wrap_angle(sighting.azimuth + pose.theta),
        elevation: sighting.elevation,
        azimuth_std: sighting.std[0],
        elevation_std: sighting.std[1],
        height: sighting.viewpoint_height,
    };
    ray_is_plausible(&ray).then_some(ray)
}

fn ray_is_plausible(ray: &BallRay) -> bool {
    ray.azimuth.abs() < 100.0
        && ray.elevation.abs() < 2.0
        && (1e-5..10.0).contains(&ray.azimuth_std)
        && (1e-5..10.0).contains(&ray.elevation_std)
        && (0.0..10.0).contains(&ray.height)
}

pub(super) fn object_state(object: &TrackedObject) -> Option<ObjectState> {
    let on_field = object.on_field?;
    let p = &on_field.covariance;
    Some(ObjectState {
        x: on_field.at.x,
        y: on_field.at.y,
        velocity_x: on_field.velocity[0],
        velocity_y: on_field.velocity[1],
        covariance: vec![p[(0, 0)], p[(0, 1)], p[(1, 1)]],
    })
}

/// True if all numbers fit a field.
pub(super) fn is_plausible(message: &TeamMessage) -> bool {
    let object_is_plausible = |object: &ObjectState| {
        let numbers = [object.x, object.y, object.velocity_x, object.velocity_y];
        numbers.iter().all(|value| value.abs() < 100.0)
            && object.covariance.len() == 3
            && object.covariance.iter().all(|value| value.is_finite())
    };
    let pose = message.pose.as_ref().is_none_or(|pose| {
        pose.x.abs() < 100.0
            && pose.y.abs() < 100.0
            && pose.theta.abs() < 100.0
            && [0, 3].contains(&pose.std.len())
            && pose.std.iter().all(|std| *std >= 0.0 && std.is_finite())
    });
    pose && message.ball.as_ref().is_none_or(object_is_plausible)
        && message.obstacles.iter().all(object_is_plausible)
        && message.ball_ray.as_ref().is_none_or(ray_is_plausible)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datagram::message;

    fn object(x: f32) -> ObjectState {
        ObjectState {
            x,
            covariance: vec![0.01, 0.0, 0.01],
            ..ObjectState::default()
        }
    }

    fn message() -> TeamMessage {
        TeamMessage {
            pose: Some(message::Pose {
                std: vec![0.1, 0.2, 0.3],
                half_known: true,
                ..message::Pose::default()
            }),
            ball: Some(object(2.0)),
            pose_by_markings: true,
            ..TeamMessage::default()
        }
    }

    #[test]
    fn of_more_obstacles_than_are_used_the_first_ones_are() {
        let message = TeamMessage {
            obstacles: (0..100).map(|x| object(x as f32 * 0.1)).collect(),
            ..message()
        };
        assert!(is_plausible(&message));
        let report = report_from_message(&message, true, Stamp);
        assert_eq!(report.obstacles.len(), 16);
        assert_eq!(report.obstacles[15].at.x, 1.5);
        assert!(report.ball.is_some());
        let senseless = TeamMessage {
            obstacles: (0..100).map(|x| object(x as f32 * 10.0)).collect(),
            ..message
        };
        assert!(!is_plausible(&senseless));
    }

    #[test]
    fn pose_without_standard_deviations_places_the_ball_and_corrects_nobody() {
        let mut message = message();
        let stated = report_from_message(&message, true, Stamp);
        assert!(stated.pose_by_markings && stated.pose_std == [0.1, 0.2, 0.3]);
        let std = &mut message.pose.as_mut().expect("a pose").std;
        std.truncate(2);
        assert!(!is_plausible(&message));
        message.pose.as_mut().expect("a pose").std.clear();
        assert!(is_plausible(&message));
        let report = report_from_message(&message, true, Stamp);
        assert!(report.pose.is_some() && report.ball.is_some() && report.half_known);
        assert!(!report.pose_by_markings);
        assert_eq!(report.pose_std, [1.0; 3]);
    }
}
