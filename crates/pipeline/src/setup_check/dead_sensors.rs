//! Do sensors that report no motion stand still? The poses of the line points tell.

use localize::frames::wrap_angle;
use localize::global_search::branch_and_bound::half_turn;
use localize::math;
use localize::setup_check::Explanation;

use super::measurements::{MeasuredKeyframe, WHEEL_PATH_MIN, wheel_path};

/// A median step between the poses of a robot that moves, and the sum of its steps, metres.
const STEP_MIN: f32 = 0.05;
const PATH_MIN: f32 = 0.4;
/// Least deviation of a quarter of the poses from their mean heading, radians, if the robot turns.
const TURN_MIN: f32 = 0.12;

/// True if there is odometry and it reports no motion.
pub(super) fn wheels_stand_still(measured: &[MeasuredKeyframe]) -> bool {
    let rows = || {
        let known = measured.iter().filter_map(|it| it.odometry.as_deref());
        known.filter(|rows| !rows.is_empty())
    };
    let path: f32 = rows().map(|rows| wheel_path(Some(rows))).sum();
    rows().next().is_some() && path < WHEEL_PATH_MIN
}

/// Path between the poses by their median step, half turns aside, metres. None if the robot stands.
pub(super) fn path_of_poses(explanation: &Explanation) -> Option<f32> {
    let pairs = explanation
        .keyframes
        .iter()
        .zip(explanation.keyframes.iter().skip(1));
    let mut steps: Vec<f32> = pairs
        .filter_map(|(before, after)| {
            let (from, to) = (before.pose?, after.pose?);
            let to = [to, half_turn(to)].map(|to| from.origin().distance_to(to.origin()));
            Some(to[0].min(to[1]))
        })
        .collect();
    steps.sort_by(f32::total_cmp);
    let median = *steps.get(steps.len() / 2)?;
    let path = median * steps.len() as f32;
    (median > STEP_MIN && path > PATH_MIN).then_some(path)
}

/// The heading that every reading of the compass repeats to the bit, radians, although the robot turns.
pub(super) fn dead_compass(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
) -> Option<f32> {
    let mut readings = measured.iter().filter_map(|keyframe| keyframe.compass);
    let first = readings.next()?;
    let repeats = readings.all(|heading| heading.to_bits() == first.to_bits());
    (repeats && turn_of_poses(explanation)? > TURN_MIN).then_some(first)
}

/// Deviation from the mean heading that a quarter of the poses exceed, half turns aside, radians.
fn turn_of_poses(explanation: &Explanation) -> Option<f32> {
    // Twice the heading is the same after a half turn.
    let poses = explanation.keyframes.iter().filter_map(|fit| fit.pose);
    let doubled: Vec<f32> = poses.map(|pose| 2.0 * pose.theta).collect();
    let sum = |of: fn(f32) -> f32| doubled.iter().map(|angle| of(*angle)).sum::<f32>();
    let mean = math::atan2(sum(math::sin), sum(math::cos));
    let mut deviations: Vec<f32> = doubled
        .iter()
        .map(|angle| 0.5 * wrap_angle(angle - mean).abs())
        .collect();
    deviations.sort_by(f32::total_cmp);
    deviations.get(3 * deviations.len() / 4).copied()
}
