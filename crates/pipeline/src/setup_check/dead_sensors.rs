//! Do wheels that report no motion stand still? The poses of the line points tell.

use localize::frames::wrap_angle;
use localize::global_search::branch_and_bound::half_turn;
use localize::setup_check::Explanation;

use super::measurements::{MeasuredKeyframe, WHEEL_PATH_MIN, wheel_path};

/// A median step between the poses of a robot that moves, and the sum of its steps, metres.
const STEP_MIN: f32 = 0.05;
const PATH_MIN: f32 = 0.4;

/// Turns of the poses beyond which wheels without any turn are wrong, radians.
const TURN_MIN: f32 = 1.0;

/// Share of points on markings, and of wheels that agree, above which their poses can contradict another sensor.
pub(super) const FIT_FINE: f32 = 0.6;

/// True if there is odometry and it reports no motion.
pub(super) fn wheels_stand_still(measured: &[MeasuredKeyframe]) -> bool {
    let rows = || {
        let known = measured.iter().filter_map(|it| it.odometry.as_deref());
        known.filter(|rows| !rows.is_empty())
    };
    let path: f32 = rows().map(|rows| wheel_path(Some(rows))).sum();
    rows().next().is_some() && path < WHEEL_PATH_MIN
}

/// Turns between the poses, half turns aside, radians, where the wheels report a path and no turn at all. None if they report some.
pub(super) fn turns_without_wheels(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
) -> Option<f32> {
    let rows = measured.iter().filter_map(|it| it.odometry.as_deref());
    if rows.flatten().any(|[_, _, turn]| *turn != 0.0) || wheels_stand_still(measured) {
        return None;
    }
    let poses: Vec<_> = explanation.keyframes.iter().map(|fit| fit.pose).collect();
    let turns = poses
        .array_windows()
        .filter_map(|[before, after]| Some(angle_apart((*before)?.theta, (*after)?.theta)));
    let has_rows = measured
        .iter()
        .any(|it| it.odometry.as_ref().is_some_and(|rows| !rows.is_empty()));
    Some(turns.sum()).filter(|turn| has_rows && *turn > TURN_MIN)
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

/// Angle between two turns, half turns aside, radians.
pub(super) fn angle_apart(turn: f32, other: f32) -> f32 {
    // Twice the angle is the same after a half turn.
    0.5 * wrap_angle(2.0 * (turn - other)).abs()
}
