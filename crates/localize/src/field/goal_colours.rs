//! What do goals of two colours say about a pose? In which half it lies, and whether a goal is where it should be.
//!
//! The goal-colour test of lima2001 4.5, in two forms: as the paper has it, point by point inside the nearest goal
//! (`relocalise::hough::settle`), and as a likelihood that weighs hypotheses and the half of a tracked pose.

use crate::field::{Field, GoalColour};
use crate::frames::{At, FieldFrame, Pose, RobotFrame};
use crate::global_search::branch_and_bound::half_turn;
use crate::sample::GoalObservation;

/// Deviation (in standard deviations, squared) beyond which a goal's colour is something else: a banner, a spectator.
const MAHALANOBIS_SQUARED_MAX: f32 = 9.0;

/// Where the goals stand, if their colours tell them apart.
#[derive(Debug, Clone)]
pub(crate) struct ColouredGoals {
    goals: Vec<(GoalColour, At<FieldFrame>)>,
    /// How far the seen middle of a goal's foot may be from the middle of its box, metres: carpet reaches into it, and
    /// half of it may be hidden.
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

    /// Negative log likelihood of goals seen from a pose.
    pub(crate) fn cost(&self, pose: Pose, sights: &[GoalObservation]) -> f32 {
        sights
            .iter()
            .map(|sight| self.observation_cost(pose, sight))
            .sum()
    }

    fn observation_cost(&self, pose: Pose, sight: &GoalObservation) -> f32 {
        let mut goals = self.goals.iter().filter(|goal| goal.0 == sight.colour);
        let Some((_, goal)) = goals.next() else {
            return 0.0;
        };
        let off = (pose * sight.at).distance_to(*goal);
        let variance = sight.std * sight.std + self.position_std * self.position_std;
        0.5 * (off * off / variance).min(MAHALANOBIS_SQUARED_MAX)
    }

    /// Log odds for a pose against its half turn.
    pub(crate) fn half_log_odds(&self, pose: Pose, sights: &[GoalObservation]) -> f32 {
        self.cost(half_turn(pose), sights) - self.cost(pose, sights)
    }
}

/// The colour that the image shows at a point of the ground, if a goal of such a colour was seen in that direction no
/// farther away.
pub(crate) fn colour_at(at: At<RobotFrame>, sights: &[GoalObservation]) -> Option<GoalColour> {
    let covers = |sight: &&GoalObservation| {
        let (bearing, range) = (sight.at.bearing(), sight.at.distance());
        let off = crate::frames::wrap_angle(at.bearing() - bearing).abs();
        off <= (0.5 * sight.width).atan2(range) && at.distance() >= range - 2.0 * sight.std
    };
    sights.iter().find(covers).map(|sight| sight.colour)
}
