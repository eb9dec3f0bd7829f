//! How do localization and the world model receive detections? As observations of the types that localize defines.

use localize::field::GoalColour;
use localize::map_correction::MapCorrection;
use localize::sample::GoalObservation;
use localize::world::{ObjectObservation, WorldObservation};
use vision::objects::goals::GoalKind;
use vision::process::Detections;

/// Converts the detected ball and robots of an image to observations on the corrected ground map.
pub fn object_observations(
    detections: &Detections,
    map: Option<&MapCorrection>,
) -> WorldObservation {
    let correct = |observation: ObjectObservation| match map {
        None => observation,
        Some(map) => {
            let added = map.point_covariance(observation.at);
            ObjectObservation {
                at: map.correct_point(observation.at),
                covariance: std::array::from_fn(|k| observation.covariance[k] + added[k]),
                ..observation
            }
        }
    };
    let ball = detections.ball.map(|ball| ObjectObservation {
        at: ball.at,
        covariance: ball.covariance,
        score: ball.score,
        airborne: !ball.on_ground,
        team: None,
        distance: ball.distance,
    });
    let robots = detections.robots.iter().map(|robot| ObjectObservation {
        at: robot.at,
        covariance: robot.covariance,
        score: robot.score,
        airborne: false,
        team: robot.marker,
        distance: None,
    });
    WorldObservation {
        ball: ball.map(correct),
        robots: robots.map(correct).collect(),
    }
}

/// The coloured goals, which tell the halves of the field apart, as localization takes them.
pub(crate) fn goal_observations(detections: &Detections) -> Vec<GoalObservation> {
    detections
        .goals
        .iter()
        .filter_map(|goal| {
            let colour = match goal.kind {
                GoalKind::Blue => GoalColour::Blue,
                GoalKind::Yellow => GoalColour::Yellow,
                GoalKind::Post => return None,
            };
            let [var_xx, _, var_yy] = goal.covariance;
            Some(GoalObservation {
                colour,
                at: goal.at,
                std: (var_xx + var_yy).sqrt(),
                width: goal.width,
            })
        })
        .collect()
}

/// Moves goals to the corrected ground map.
pub fn correct_goals(
    goals: Vec<GoalObservation>,
    map: Option<&MapCorrection>,
) -> Vec<GoalObservation> {
    let Some(map) = map else { return goals };
    goals
        .into_iter()
        .map(|goal| {
            let [xx, _, yy] = map.point_covariance(goal.at);
            GoalObservation {
                at: map.correct_point(goal.at),
                std: (goal.std * goal.std + xx + yy).sqrt(),
                ..goal
            }
        })
        .collect()
}
