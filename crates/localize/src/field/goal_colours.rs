//! Likelihood of a pose by goals of two colours (docs/methods.md 9.3).
//!
//! lima2001 4.5 tests the goal colours point by point inside the nearest goal (`global_search::hough`). Here the observed
//! goals weight hypotheses and the field half of a tracked pose.

use crate::field::{Field, GoalColour};
use crate::frames::{At, FieldFrame, Pose, RobotFrame};
use crate::global_search::branch_and_bound::half_turn;
use crate::math;
use crate::sample::GoalObservation;

/// Limit of the squared deviation of a goal, in standard deviations. Beyond it the colour is that of another object.
const MAHALANOBIS_SQUARED_MAX: f32 = 9.0;

/// Positions of the goals. Empty if both have the same colour.
#[derive(Debug, Clone)]
pub(crate) struct ColouredGoals {
    goals: Vec<(GoalColour, At<FieldFrame>)>,
    /// Standard deviation of the visible middle of a goal from the middle of its box, metres: the carpet extends into it,
    /// and half of it may be occluded.
    position_std: f32,
}

impl ColouredGoals {
    pub(crate) fn new(field: &Field) -> Self {
        let goal = &field.config.goal;
        let middle = (field.length + goal.depth) / 2.0;
        let [positive_x, negative_x] = goal.colours;
        let goals = if positive_x == negative_x {
            Vec::new()
        } else {
            vec![
                (positive_x, At::new(middle, 0.0)),
                (negative_x, At::new(-middle, 0.0)),
            ]
        };
        ColouredGoals {
            goals,
            position_std: math::hypot(goal.width / 4.0, goal.depth / 2.0),
        }
    }

    /// Negative log likelihood of the observed goals at a pose.
    pub(crate) fn cost(&self, pose: Pose, observed: &[GoalObservation]) -> f32 {
        observed
            .iter()
            .map(|goal| self.observation_cost(pose, goal))
            .sum()
    }

    fn observation_cost(&self, pose: Pose, observation: &GoalObservation) -> f32 {
        let mut goals = self
            .goals
            .iter()
            .filter(|(colour, _)| *colour == observation.colour);
        let Some((_, goal)) = goals.next() else {
            return 0.0;
        };
        let distance = (pose * observation.at).distance_to(*goal);
        let variance = observation.std * observation.std + self.position_std * self.position_std;
        0.5 * (distance * distance / variance).min(MAHALANOBIS_SQUARED_MAX)
    }

    /// Log odds of a pose against its half turn.
    pub(crate) fn half_log_odds(&self, pose: Pose, observed: &[GoalObservation]) -> f32 {
        self.cost(half_turn(pose), observed) - self.cost(pose, observed)
    }
}

/// Colour of an observed goal that covers a ground point: same direction, and not behind it.
pub(crate) fn colour_at(at: At<RobotFrame>, observed: &[GoalObservation]) -> Option<GoalColour> {
    let covers = |goal: &&GoalObservation| {
        let (bearing, range) = (goal.at.bearing(), goal.at.distance());
        let deviation = crate::frames::wrap_angle(at.bearing() - bearing).abs();
        deviation <= math::atan2(0.5 * goal.width, range) && at.distance() >= range - 2.0 * goal.std
    };
    observed.iter().find(covers).map(|goal| goal.colour)
}
