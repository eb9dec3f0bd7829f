//! Do wheels that report no motion stand still? The poses of the line points tell.

use localize::global_search::branch_and_bound::half_turn;
use localize::setup_check::Explanation;

use super::measurements::{MeasuredKeyframe, WHEEL_PATH_MIN, wheel_path};

/// A median step between the poses of a robot that moves, and the sum of its steps, metres.
const STEP_MIN: f32 = 0.05;
const PATH_MIN: f32 = 0.4;

/// Number of the odometry's rows, if there are any and they report no motion.
pub(super) fn rows_without_motion(measured: &[MeasuredKeyframe]) -> Option<usize> {
    let rows: Vec<[f32; 3]> = measured
        .iter()
        .filter_map(|keyframe| keyframe.odometry.as_deref())
        .flatten()
        .copied()
        .collect();
    (!rows.is_empty() && wheel_path(Some(&rows)) < WHEEL_PATH_MIN).then_some(rows.len())
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
