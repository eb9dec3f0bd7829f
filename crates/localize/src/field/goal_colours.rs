//! Goals of two colours resolve the half of the field and test a pose.
//!
//! The goal colour test of lima2001 4.5, in two forms. The paper's form classifies points inside the nearest goal
//! (`global_search::hough::confirm_by_goal_colours`). The second form is a likelihood for hypotheses and for the half of
//! a tracked pose.

use crate::field::{Field, GoalColour};
use crate::frames::{At, FieldFrame, Pose, RobotFrame};
use crate::global_search::branch_and_bound::half_turn;
use crate::sample::GoalObservation;

/// Squared Mahalanobis distance at which the cost is cut off: beyond it the colour is a banner or a spectator.
const MAHALANOBIS_SQUARED_MAX: f32 = 9.0;

/// Positions of the goals, if their colours differ.
#[derive(Debug, Clone)]
pub(crate) struct ColouredGoals {
    goals: Vec<(GoalColour, At<FieldFrame>)>,
    /// Standard deviation of the detected middle of a goal's base from the middle of its box, metres: the carpet extends
    /// into the goal, and half of it may be occluded.
    position_std: f32,
}

impl ColouredGoals {
    pub(crate) fn new(field: &Field) -> Self {
        let goal = &field.config.goal;
        let middle = (field.length + goal.depth) / 2.0;
        let [ahead, behind] = goal.colours;
        let goals = if ahead == behind {
            Vec::new()
        } else {
            vec![
                (ahead, At::new(middle, 0.0)),
                (behind, At::new(-middle, 0.0)),
            ]
        };
        ColouredGoals {
            goals,
            position_std: (goal.width / 4.0).hypot(goal.depth / 2.0),
        }
    }

    /// Negative log likelihood of detected goals at a pose.
    pub(crate) fn cost(&self, pose: Pose, observations: &[GoalObservation]) -> f32 {
        observations
            .iter()
            .map(|observation| self.observation_cost(pose, observation))
            .sum()
    }

    fn observation_cost(&self, pose: Pose, observation: &GoalObservation) -> f32 {
        let mut goals = self
            .goals
            .iter()
            .filter(|goal| goal.0 == observation.colour);
        let Some((_, goal)) = goals.next() else {
            return 0.0;
        };
        let off = (pose * observation.at).distance_to(*goal);
        let variance = observation.std * observation.std + self.position_std * self.position_std;
        0.5 * (off * off / variance).min(MAHALANOBIS_SQUARED_MAX)
    }

    /// Log odds of a pose against its half turn.
    pub(crate) fn half_log_odds(&self, pose: Pose, observations: &[GoalObservation]) -> f32 {
        self.cost(half_turn(pose), observations) - self.cost(pose, observations)
    }
}

/// The image's goal colour at a ground point: that of a goal detected in this direction and not farther away.
pub(crate) fn colour_at(
    at: At<RobotFrame>,
    observations: &[GoalObservation],
) -> Option<GoalColour> {
    let covers = |observation: &&GoalObservation| {
        let (bearing, range) = (observation.at.bearing(), observation.at.distance());
        let off = crate::frames::wrap_angle(at.bearing() - bearing).abs();
        off <= (0.5 * observation.width).atan2(range)
            && at.distance() >= range - 2.0 * observation.std
    };
    observations
        .iter()
        .find(covers)
        .map(|observation| observation.colour)
}
