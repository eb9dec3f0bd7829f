//! To which of the field's lines do the detected lines belong, and where is the robot? Step 8 of lima2001 4.1, and 4.5.

use super::{Hough, LineOffset, ScoredPose};
use crate::field::Field;
use crate::field::goal_colours::colour_at;
use crate::frames::{At, Pose, wrap_angle};
use crate::global_search::branch_and_bound::{HeadingPrior, half_turn};
use crate::sample::GoalObservation;

/// A shift of an array over its model: the robot's position along that axis (metres), matched lines and their votes.
#[derive(Debug, Clone, Copy)]
struct Shift {
    position: f32,
    matches: usize,
    votes: i32,
}

/// A pose with its matched lines and their votes.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    matches: usize,
    votes: i32,
    pose: Pose,
}

impl Hough {
    /// Step 8 and lima2001 4.5: correlates both arrays with both model arrays.
    ///
    /// The assignment (ρ_φ, ρ̂_φ) with (ρ_φ+90, ρ̂_φ+90), or (ρ_φ, ρ̂_φ+90) with (ρ_φ+90, ρ̂_φ), fixes the orientation. One
    /// line of each array fixes the position. Positions outside the carpet are rejected.
    pub(super) fn find_positions(
        &self,
        phi: f32,
        offsets: &[Vec<LineOffset>; 2],
        prior: Option<HeadingPrior>,
    ) -> Vec<ScoredPose> {
        use std::f32::consts::FRAC_PI_2;
        let mut candidates: Vec<Candidate> = Vec::new();
        for quarter in 0..4_u8 {
            // In the robot frame the field's x axis is `quarter` right angles ahead of φ.
            let theta = wrap_angle(-phi - f32::from(quarter) * FRAC_PI_2);
            if prior.is_some_and(|prior| wrap_angle(theta - prior.heading).abs() > FRAC_PI_2) {
                continue;
            }
            let (along, across) = match quarter {
                0 => (apply_sign(&offsets[0], 1.0), apply_sign(&offsets[1], 1.0)),
                1 => (apply_sign(&offsets[1], 1.0), apply_sign(&offsets[0], -1.0)),
                2 => (apply_sign(&offsets[0], -1.0), apply_sign(&offsets[1], -1.0)),
                _ => (apply_sign(&offsets[1], -1.0), apply_sign(&offsets[0], 1.0)),
            };
            for x in self.correlate(&self.model[0], &along) {
                for y in self.correlate(&self.model[1], &across) {
                    let [half_x, half_y] = self.half_extent;
                    if x.position.abs() > half_x || y.position.abs() > half_y {
                        continue;
                    }
                    candidates.push(Candidate {
                        matches: x.matches + y.matches,
                        votes: x.votes + y.votes,
                        pose: Pose::new(x.position, y.position, theta),
                    });
                }
            }
        }
        candidates.sort_by_key(|candidate| std::cmp::Reverse((candidate.matches, candidate.votes)));
        candidates
            .into_iter()
            .map(
                |Candidate {
                     matches,
                     votes,
                     pose,
                 }| ScoredPose {
                    pose,
                    score: matches as f32 + 1e-4 * votes as f32,
                },
            )
            .collect()
    }

    /// Shifts the array over the model and counts the lines that match; the best distinct shifts.
    fn correlate(&self, model: &[f32], offsets: &[LineOffset]) -> Vec<Shift> {
        let mut shifts: Vec<Shift> = Vec::new();
        for line in model {
            for LineOffset { rho, .. } in offsets {
                let position = line - rho;
                let (mut matches, mut votes, mut off) = (0, 0, 0.0);
                for LineOffset {
                    rho,
                    votes: line_votes,
                } in offsets
                {
                    let Some(deviation) = model
                        .iter()
                        .map(|line| line - rho - position)
                        .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                    else {
                        continue;
                    };
                    if deviation.abs() < self.config.tolerance {
                        matches += 1;
                        votes += i32::from(*line_votes);
                        off += deviation;
                    }
                }
                shifts.push(Shift {
                    position: position + off / matches.max(1) as f32,
                    matches,
                    votes,
                });
            }
        }
        shifts.sort_by_key(|shift| std::cmp::Reverse((shift.matches, shift.votes)));
        let mut best: Vec<Shift> = Vec::new();
        for shift in shifts {
            let differs = |other: &Shift| {
                (other.position - shift.position).abs() > self.config.suppression_distance
            };
            if best.len() < self.config.correlation_peaks_max && best.iter().all(differs) {
                best.push(shift);
            }
        }
        best
    }
}

/// The goal colour test (lima2001 4.5) of `candidates` (best first); the confirmed poses in the same order.
///
/// Points inside the goal nearest to a candidate are classified, then those inside the other goal if neither colour is
/// found, since near the halfway line both goals are equally far. The goal's own colour confirms the pose, the other
/// goal's colour gives its half turn, anything else rejects it. Empty if the goals have equal colours or no goal is
/// detected.
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

/// The pose, or its half turn, if most points inside the goal at +x (`side` 1) or -x (-1) have a goal's colour.
fn confirm_pose(field: &Field, pose: Pose, side: f32, goals: &[GoalObservation]) -> Option<Pose> {
    let goal = &field.config.goal;
    let [ahead, behind] = goal.colours;
    let (own, other) = if side > 0.0 {
        (ahead, behind)
    } else {
        (behind, ahead)
    };
    let robot_from_field = pose.inverse();
    let (mut own_count, mut other_count, mut count) = (0, 0, 0);
    for depth_share in [0.25, 0.5, 0.75] {
        for width_share in [-0.35, -0.2, 0.0, 0.2, 0.35] {
            let x = side * (field.length / 2.0 + depth_share * goal.depth);
            let inside = At::new(x, width_share * goal.width);
            let colour = colour_at(robot_from_field * inside, goals);
            own_count += usize::from(colour == Some(own));
            other_count += usize::from(colour == Some(other));
            count += 1;
        }
    }
    if 2 * own_count > count {
        Some(pose)
    } else {
        (2 * other_count > count).then(|| half_turn(pose))
    }
}

fn apply_sign(offsets: &[LineOffset], sign: f32) -> Vec<LineOffset> {
    let scaled = |offset: &LineOffset| LineOffset {
        rho: sign * offset.rho,
        ..*offset
    };
    offsets.iter().map(scaled).collect()
}
