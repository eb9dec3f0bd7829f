//! Which of the field's lines are they, and so where is the robot? Step 8 of lima2001 4.1, and 4.5.

use super::Hough;
use crate::field::Field;
use crate::field::goal_colours::colour_at;
use crate::frames::{At, Pose, wrap_angle};
use crate::global_search::branch_and_bound::{HeadingPrior, half_turn};
use crate::sample::GoalObservation;

/// A shift of an array over its model: where the robot is along that axis, matches counted, votes of the matched.
#[derive(Debug, Clone, Copy)]
struct Shift {
    at: f32,
    matches: usize,
    votes: i32,
}

impl Hough {
    /// Step 8 and lima2001 4.5: correlates both arrays with both model arrays. The pair (ρ_φ, ρ̂_φ) with its companion
    /// (ρ_φ+90, ρ̂_φ+90), or (ρ_φ, ρ̂_φ+90) with (ρ_φ+90, ρ̂_φ), fixes the orientation; a line of each, the reference
    /// point and with it the position; positions off the field are rejected.
    pub(super) fn find_positions(
        &self,
        phi: f32,
        seen: &[Vec<(f32, i16)>; 2],
        prior: Option<HeadingPrior>,
    ) -> Vec<(f32, Pose)> {
        use std::f32::consts::FRAC_PI_2;
        let mut found: Vec<(usize, i32, Pose)> = Vec::new();
        for quarter in 0..4_u8 {
            // The field's x axis lies `quarter` right angles on from φ in the robot's frame.
            let theta = wrap_angle(-phi - f32::from(quarter) * FRAC_PI_2);
            if prior.is_some_and(|prior| wrap_angle(theta - prior.heading).abs() > FRAC_PI_2) {
                continue;
            }
            let (along, across) = match quarter {
                0 => (apply_sign(&seen[0], 1.0), apply_sign(&seen[1], 1.0)),
                1 => (apply_sign(&seen[1], 1.0), apply_sign(&seen[0], -1.0)),
                2 => (apply_sign(&seen[0], -1.0), apply_sign(&seen[1], -1.0)),
                _ => (apply_sign(&seen[1], -1.0), apply_sign(&seen[0], 1.0)),
            };
            for x in self.correlate(&self.model[0], &along) {
                for y in self.correlate(&self.model[1], &across) {
                    if x.at.abs() > self.half_x || y.at.abs() > self.half_y {
                        continue;
                    }
                    found.push((
                        x.matches + y.matches,
                        x.votes + y.votes,
                        Pose::new(x.at, y.at, theta),
                    ));
                }
            }
        }
        found.sort_by_key(|&(matches, votes, _)| std::cmp::Reverse((matches, votes)));
        found
            .into_iter()
            .map(|(matches, votes, pose)| (matches as f32 + 1e-4 * votes as f32, pose))
            .collect()
    }

    /// Shifts the array over the model and counts the pairs that match; the best shifts.
    fn correlate(&self, model: &[f32], seen: &[(f32, i16)]) -> Vec<Shift> {
        let mut shifts: Vec<Shift> = Vec::new();
        for line in model {
            for (rho, _) in seen {
                let at = line - rho;
                let (mut matches, mut votes, mut off) = (0, 0, 0.0);
                for (rho, strength) in seen {
                    let Some(deviation) = model
                        .iter()
                        .map(|line| line - rho - at)
                        .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                    else {
                        continue;
                    };
                    if deviation.abs() < self.config.tolerance {
                        matches += 1;
                        votes += i32::from(*strength);
                        off += deviation;
                    }
                }
                shifts.push(Shift {
                    at: at + off / matches.max(1) as f32,
                    matches,
                    votes,
                });
            }
        }
        shifts.sort_by_key(|shift| std::cmp::Reverse((shift.matches, shift.votes)));
        let mut best: Vec<Shift> = Vec::new();
        for shift in shifts {
            let new =
                |other: &Shift| (other.at - shift.at).abs() > self.config.suppression_distance;
            if best.len() < self.config.correlation_peaks_max && best.iter().all(new) {
                best.push(shift);
            }
        }
        best
    }
}

/// The goal test (lima2001 4.5): looks at points inside the goal nearest to each of `candidates` (best first), and, where
/// neither colour is there, inside the other goal: near the halfway line both are as far. A goal's own colour confirms;
/// the other goal's gives the half turn; carpet green, or anything else, rejects: the next maximum. Those confirmed, in
/// their order; none if the goals look alike or are not in sight.
pub fn confirm_by_goal_colours(
    field: &Field,
    candidates: &[Pose],
    goals: &[GoalObservation],
) -> Vec<Pose> {
    let [ahead, behind] = field.config.goal.colours;
    if ahead == behind {
        return Vec::new();
    }
    let confirmed = candidates.iter().filter_map(|&pose| {
        let nearer = if pose.x >= 0.0 { 1.0 } else { -1.0 };
        [nearer, -nearer]
            .into_iter()
            .find_map(|side| confirm_pose(field, pose, side, goals))
    });
    confirmed.collect()
}

/// The pose, or its half turn, if most points inside the goal at +x (`side` 1) or -x (-1) show a goal's colour.
fn confirm_pose(field: &Field, pose: Pose, side: f32, goals: &[GoalObservation]) -> Option<Pose> {
    let goal = &field.config.goal;
    let [ahead, behind] = goal.colours;
    let (own, other) = if side > 0.0 {
        (ahead, behind)
    } else {
        (behind, ahead)
    };
    let robot_from_field = pose.inverse();
    let (mut right, mut turned, mut all) = (0, 0, 0);
    for deep in [0.25, 0.5, 0.75] {
        for wide in [-0.35, -0.2, 0.0, 0.2, 0.35] {
            let x = side * (field.length / 2.0 + deep * goal.depth);
            let seen = colour_at(robot_from_field * At::new(x, wide * goal.width), goals);
            right += usize::from(seen == Some(own));
            turned += usize::from(seen == Some(other));
            all += 1;
        }
    }
    if 2 * right > all {
        Some(pose)
    } else {
        (2 * turned > all).then(|| half_turn(pose))
    }
}

fn apply_sign(array: &[(f32, i16)], sign: f32) -> Vec<(f32, i16)> {
    array
        .iter()
        .map(|&(rho, votes)| (sign * rho, votes))
        .collect()
}
