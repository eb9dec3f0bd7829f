//! Does the compass say anything? One that is dead, freezes, falls silent or scatters is named. A compass turned, mirrored or in
//! degrees is named by the search of set-ups.

use std::ops::Range;

use localize::math;
use localize::setup_check::{Explanation, KeyframeFit};

use super::dead_sensors::{FIT_FINE, angle_apart};
use super::measurements::MeasuredKeyframe;

/// Least deviation of a quarter of the poses from their mean heading, radians, if the robot turns.
const TURN_MIN: f32 = 0.12;
/// Fewest readings that are judged.
const READINGS_MIN: usize = 10;
/// Two turns agree within this, radians (readings at random agree by a third), and the share of them that agrees at least.
const TURN_TOLERANCE: f32 = 0.5;
const TURNS_AGREEMENT_MIN: f32 = 0.55;
/// Probability at which keyframes without a reading are no chance.
const SILENCE_CHANCE: f32 = 1e-6;
/// Noise from one reading to the next over the stated standard deviation, which includes slow errors, too.
const NOISE_RATIO: f32 = 2.0;
/// What is wrong with the compass.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CompassFault {
    pub(super) text: String,
    /// Keyframes whose reading says nothing.
    pub(super) ignored: Range<usize>,
    /// No reading of the table is worth anything.
    pub(super) is_useless: bool,
}

impl CompassFault {
    /// The keyframes without the readings that say nothing. None if all readings count.
    pub(super) fn without_ignored(
        &self,
        measured: &[MeasuredKeyframe],
    ) -> Option<Vec<MeasuredKeyframe>> {
        let mut without = measured.to_vec();
        let ignored = &mut without[self.ignored.clone()];
        ignored
            .iter_mut()
            .for_each(|keyframe| keyframe.compass = None);
        (!self.ignored.is_empty()).then_some(without)
    }
}

/// The compass's fault, if it has one. `noise`: measured and stated standard deviation of its readings, radians.
pub(super) fn find_compass_fault(
    measured: &[MeasuredKeyframe],
    explanation: &Explanation,
    noise: Option<[f32; 2]>,
) -> Option<CompassFault> {
    frozen(measured, explanation)
        .or_else(|| scattering(measured, explanation))
        .or_else(|| silent(measured))
        .or_else(|| noisy(noise?))
}

/// Readings that repeat one heading to the bit although the robot turns.
fn frozen(measured: &[MeasuredKeyframe], explanation: &Explanation) -> Option<CompassFault> {
    let readings: Vec<(usize, f32)> = measured
        .iter()
        .enumerate()
        .filter_map(|(index, keyframe)| Some((index, keyframe.compass?)))
        .collect();
    let runs = readings.chunk_by(|a, b| a.1.to_bits() == b.1.to_bits());
    let longest = runs.max_by_key(|run| run.len())?;
    let ((first, heading), (last, _)) = (*longest.first()?, *longest.last()?);
    if turn_of_poses(explanation.keyframes.get(first..=last)?)? <= TURN_MIN {
        return None;
    }
    let is_useless = longest.len() == readings.len();
    if is_useless {
        return Some(CompassFault {
            text: format!(
                "every reading is {heading:.3}, but the images show turns of the robot: the compass is dead"
            ),
            ignored: 0..measured.len(),
            is_useless,
        });
    }
    (longest.len() >= READINGS_MIN).then(|| CompassFault {
        text: format!(
            "every reading from {:.1} to {:.1} s is {heading:.3}, but the images show turns of the robot: the compass freezes",
            measured[first].stamp.seconds(),
            measured[last].stamp.seconds()
        ),
        ignored: first..last + 1,
        is_useless,
    })
}

/// Readings whose turns are not those of the poses.
fn scattering(measured: &[MeasuredKeyframe], explanation: &Explanation) -> Option<CompassFault> {
    if explanation.on_markings() < FIT_FINE {
        return None;
    }
    let share = agreement_of_turns(measured, explanation)?;
    (share < TURNS_AGREEMENT_MIN).then(|| CompassFault {
        text: format!(
            "its readings scatter: only {:.0} % of its turns are those that the images show. It is not used",
            100.0 * share
        ),
        ignored: 0..measured.len(),
        is_useless: true,
    })
}

/// More successive keyframes without a reading than chance explains by their share among the others.
fn silent(measured: &[MeasuredKeyframe]) -> Option<CompassFault> {
    let runs = measured.chunk_by(|a, b| a.compass.is_none() && b.compass.is_none());
    let longest = runs
        .filter(|run| run[0].compass.is_none())
        .max_by_key(|run| run.len())?;
    let read = measured
        .iter()
        .filter(|keyframe| keyframe.compass.is_some());
    let read = read.count() as f32;
    // A single reading is a heading that was given.
    if read < 2.0 {
        return None;
    }
    let others = (measured.len() - longest.len()) as f32;
    // Laplace's rule: all of a few keyframes do not make a reading certain.
    let share = (read + 1.0) / (others + 2.0);
    let chance = math::powf(1.0 - share, longest.len() as f32);
    let [from, to] = [longest.first()?, longest.last()?].map(|each| each.stamp.seconds());
    (chance < SILENCE_CHANCE).then(|| CompassFault {
        text: format!("no reading from {from:.1} to {to:.1} s: the compass falls silent"),
        ignored: 0..0,
        is_useless: false,
    })
}

/// Readings that scatter far more than stated.
fn noisy([noise, stated]: [f32; 2]) -> Option<CompassFault> {
    (noise > NOISE_RATIO * stated).then(|| CompassFault {
        text: format!(
            "its readings scatter by {:.0} degrees from one to the next, beyond the turns of the wheels (expected at most {:.0}, \
             as [localize.compass] std_deg says): look for a motor or a cable near it",
            noise.to_degrees(),
            stated.to_degrees()
        ),
        ignored: 0..0,
        is_useless: false,
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
    let agree = off.iter().filter(|off| **off < TURN_TOLERANCE).count();
    (off.len() >= READINGS_MIN).then(|| agree as f32 / off.len() as f32)
}

/// Deviation from the mean heading that a quarter of the poses exceed, half turns aside, radians.
fn turn_of_poses(fits: &[KeyframeFit]) -> Option<f32> {
    // Twice the heading is the same after a half turn.
    let poses = fits.iter().filter_map(|fit| fit.pose);
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
    use localize::{Pose, Stamp};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Thirty keyframes of a robot that turns; `compass` gives the reading of a keyframe at a heading.
    fn fault(mut compass: impl FnMut(usize, f32) -> Option<f32>) -> Option<CompassFault> {
        let headings = (0..30).map(|k| 2.5 * math::sin(0.7 * k as f32));
        let (mut measured, mut keyframes) = (Vec::new(), Vec::new());
        for (number, heading) in headings.enumerate() {
            measured.push(MeasuredKeyframe {
                stamp: Stamp::from_seconds(number as f64),
                compass: compass(number, heading),
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
                by_matrix: None,
                wheels_agree: None,
                compass_agrees: None,
            });
        }
        find_compass_fault(&measured, &Explanation { keyframes }, None)
    }

    #[test]
    fn readings_at_random_are_useless_and_noise_bias_and_iron_are_not() {
        for seed in 0..12 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut spread = |width: f32| random.random_range(-width..width);
            let found = fault(|_, _| Some(spread(3.1))).expect("a fault");
            assert!(found.is_useless && found.text.contains("scatter"));
            assert_eq!(fault(|_, heading| Some(heading + 0.4 + spread(0.35))), None);
            let iron = |_, heading: f32| Some(heading + 0.5 * math::sin(heading));
            assert_eq!(fault(iron), None);
        }
    }

    #[test]
    fn dead_frozen_and_silent_compasses_are_named_and_slow_ones_are_not() {
        let dead = fault(|_, _| Some(0.3)).expect("a fault");
        assert!(dead.is_useless && dead.text.contains("dead"));
        let frozen = fault(|number, heading| Some(if number < 12 { heading } else { 0.3 }));
        let frozen = frozen.expect("a fault");
        assert!(!frozen.is_useless && frozen.text.contains("from 12.0 to 29.0 s is 0.300"));
        assert_eq!(frozen.ignored, 12..30);
        let silent = fault(|number, heading| (number < 12).then_some(heading));
        let silent = silent.expect("a fault").text;
        assert!(
            silent.contains("no reading from 12.0 to 29.0 s"),
            "{silent}"
        );
        // Fewer readings than images.
        assert_eq!(
            fault(|number, heading| (number % 4 == 0).then_some(heading)),
            None
        );
        // A reading that is repeated until the next one.
        let mut held = 0.0;
        let slow = fault(|number, heading| {
            held = if number % 2 == 0 { heading } else { held };
            Some(held)
        });
        assert!(slow.is_none_or(|fault| !fault.text.contains("freezes")));
        for given in 0..2 {
            assert_eq!(
                fault(|number, heading| (number < given).then_some(heading)),
                None
            );
        }
    }

    #[test]
    fn noise_far_above_the_stated_one_is_a_fault() {
        assert!(noisy([0.7, 0.17]).is_some_and(|fault| fault.text.contains("by 40 degrees")));
        assert_eq!(noisy([0.2, 0.17]), None);
    }
}
