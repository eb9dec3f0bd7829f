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

/// Share of points on markings, and of wheels that agree, above which their poses can contradict another sensor.
pub(super) const FIT_FINE: f32 = 0.6;
/// Fewest turns of the compass that are judged, their tolerance (radians; readings at random agree by a third), and the share
/// of them that agrees at least. A compass turned, mirrored or in degrees is named by the search of set-ups.
const COMPASS_TURNS_MIN: usize = 10;
const COMPASS_TOLERANCE: f32 = 0.5;
const COMPASS_AGREEMENT_MIN: f32 = 0.55;

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

/// Why the compass says nothing, if so: every reading repeats one heading to the bit although the robot turns, or its turns
/// are not those of the poses.
pub(super) fn find_useless_compass(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
) -> Option<String> {
    let mut readings = measured.iter().filter_map(|keyframe| keyframe.compass);
    let first = readings.next()?;
    let repeats = readings.all(|heading| heading.to_bits() == first.to_bits());
    if repeats && turn_of_poses(explanation)? > TURN_MIN {
        return Some(format!(
            "every reading is {first:.3}, but the images show turns of the robot: the compass is dead"
        ));
    }
    if explanation.on_markings() < FIT_FINE {
        return None;
    }
    let share = agreement_of_turns(measured, explanation)?;
    (share < COMPASS_AGREEMENT_MIN).then(|| {
        format!(
            "its readings scatter: only {:.0} % of its turns are those that the images show. It is not used",
            100.0 * share
        )
    })
}

/// Share of the turns between keyframes by which the compass agrees with the poses, half turns aside. None for too few.
fn agreement_of_turns(measured: &[MeasuredKeyframe], explanation: &Explanation) -> Option<f32> {
    let headings = measured.iter().map(|keyframe| keyframe.compass);
    let poses = explanation.keyframes.iter().map(|fit| fit.pose);
    let both: Vec<Option<(f32, f32)>> = headings
        .zip(poses)
        .map(|(heading, pose)| Some((heading?, pose?.theta)))
        .collect();
    let off: Vec<f32> = both
        .array_windows()
        .filter_map(|[before, after]| {
            let (before, after) = ((*before)?, (*after)?);
            Some(angle_apart(after.0 - before.0, after.1 - before.1))
        })
        .collect();
    let agree = off.iter().filter(|off| **off < COMPASS_TOLERANCE).count();
    (off.len() >= COMPASS_TURNS_MIN).then(|| agree as f32 / off.len() as f32)
}

/// Angle between two turns, half turns aside, radians.
pub(super) fn angle_apart(turn: f32, other: f32) -> f32 {
    // Twice the angle is the same after a half turn.
    0.5 * wrap_angle(2.0 * (turn - other)).abs()
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
        .map(|angle| angle_apart(0.5 * angle, 0.5 * mean))
        .collect();
    deviations.sort_by(f32::total_cmp);
    deviations.get(3 * deviations.len() / 4).copied()
}

#[cfg(test)]
mod tests {
    use localize::Pose;
    use localize::setup_check::KeyframeFit;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Thirty keyframes of a robot that turns; `compass` gives the reading at a heading.
    fn fault(mut compass: impl FnMut(f32) -> f32) -> Option<String> {
        let headings = (0..30).map(|k| 2.5 * math::sin(0.7 * k as f32));
        let (mut measured, mut keyframes) = (Vec::new(), Vec::new());
        for (number, heading) in headings.enumerate() {
            measured.push(MeasuredKeyframe {
                compass: Some(compass(heading)),
                ..MeasuredKeyframe::default()
            });
            // Every third pose is half a turn off: the field is symmetric.
            let half = if number % 3 == 0 {
                std::f32::consts::PI
            } else {
                0.0
            };
            keyframes.push(KeyframeFit {
                pose: Some(Pose::new(0.0, 0.0, heading + half)),
                cost: 0.0,
                points: 100,
                on_markings: 1.0,
                residual: 0.02,
                wheel_step: None,
                wheels_agree: None,
                compass_agrees: None,
            });
        }
        find_useless_compass(&measured, &Explanation { keyframes })
    }

    #[test]
    fn readings_at_random_are_useless_and_noise_bias_and_iron_are_not() {
        for seed in 0..12 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut spread = |width: f32| random.random_range(-width..width);
            assert!(fault(|_| spread(3.1)).is_some_and(|text| text.contains("scatter")));
            assert_eq!(fault(|heading| heading + 0.4 + spread(0.35)), None);
            assert_eq!(fault(|heading| heading + 0.5 * math::sin(heading)), None);
        }
        assert!(fault(|_| 0.3).is_some_and(|text| text.contains("dead")));
    }
}
