//! Which pose of each keyframe fits wheels and compass best? The cheapest chain of hypotheses (Viterbi).

use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::Hypothesis;

use super::keyframe::{Keyframe, WheelMotion};

/// Standard deviations of wheels and matched poses together: metres, share of the path.
const STEP_STD: (f32, f32) = (0.06, 0.08);
/// Standard deviations of turns: radians, share of the turns, radians per metre.
const TURN_STD: (f32, f32, f32) = (0.04, 0.08, 0.02);
/// Standard deviation of a compass, radians.
const COMPASS_STD: f32 = 0.2;
/// Squared deviation at which wheels or compass count as contradicting: their cost grows no further.
const CONTRADICTION: f32 = 25.0;

/// Pose hypotheses of one keyframe with their costs (negative log likelihood of its points).
#[derive(Debug, Clone, Default)]
pub(super) struct KeyframeHypotheses {
    /// Best first, half turns included.
    pub(super) hypotheses: Vec<(f32, Hypothesis)>,
}

/// The selected hypothesis of one keyframe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SelectedHypothesis {
    /// Index into the keyframe's hypotheses. None if it has none.
    pub(super) hypothesis: Option<usize>,
    /// Squared deviation of the motion since the previous keyframe, limited. None without wheels.
    pub(super) wheels: Option<f32>,
    /// Squared deviation of the compass, limited. None without a compass.
    pub(super) compass: Option<f32>,
}

impl SelectedHypothesis {
    /// Do the wheels agree? None without wheels.
    pub(super) fn wheels_agree(&self) -> Option<bool> {
        self.wheels.map(|squared| squared < CONTRADICTION)
    }

    /// Does the compass agree? None without a compass.
    pub(super) fn compass_agrees(&self) -> Option<bool> {
        self.compass.map(|squared| squared < CONTRADICTION)
    }
}

/// Squared deviation of two poses from the wheels' motion, limited.
fn wheel_deviation(from: Pose, to: Pose, motion: &WheelMotion) -> f32 {
    let error = (from * motion.step).difference(to);
    let position = STEP_STD.0.powi(2) + (STEP_STD.1 * motion.path).powi(2);
    let turn = TURN_STD.0.powi(2)
        + (TURN_STD.1 * motion.turned).powi(2)
        + (TURN_STD.2 * motion.path).powi(2);
    // A heading error displaces the end of a long path too.
    let position = position + turn * 0.25 * motion.path.powi(2);
    let squared = (error[0].powi(2) + error[1].powi(2)) / position + error[2].powi(2) / turn;
    squared.min(CONTRADICTION)
}

fn compass_deviation(pose: Pose, heading: f32) -> f32 {
    (wrap_angle(pose.theta - heading) / COMPASS_STD)
        .powi(2)
        .min(CONTRADICTION)
}

/// Selects one hypothesis of each keyframe so that points, wheels and compass together cost least.
pub(super) fn select_chain(
    keyframes: &[Keyframe],
    hypotheses: &[KeyframeHypotheses],
) -> Vec<SelectedHypothesis> {
    let mut best: Vec<Vec<(f32, Option<usize>)>> = Vec::new();
    for (k, (keyframe, own)) in keyframes.iter().zip(hypotheses).enumerate() {
        let previous = k
            .checked_sub(1)
            .map(|last| (&hypotheses[last], &best[last]));
        let costs = own.hypotheses.iter().map(|(points, hypothesis)| {
            let compass = keyframe.compass.map_or(0.0, |heading| {
                0.5 * compass_deviation(hypothesis.pose, heading)
            });
            let start = previous.map(|(before, totals)| {
                cheapest_step(before, totals, keyframe.motion.as_ref(), hypothesis.pose)
            });
            let (before, from) = start.unwrap_or((0.0, None));
            (before + points + compass, from)
        });
        best.push(costs.collect());
    }
    trace_back(keyframes, hypotheses, &best)
}

/// Cost and index of the cheapest hypothesis before `pose`. Without wheels or hypotheses there is no step.
fn cheapest_step(
    before: &KeyframeHypotheses,
    totals: &[(f32, Option<usize>)],
    motion: Option<&WheelMotion>,
    pose: Pose,
) -> (f32, Option<usize>) {
    let step = |from: Pose| motion.map_or(0.0, |motion| 0.5 * wheel_deviation(from, pose, motion));
    let costs = before.hypotheses.iter().zip(totals).enumerate();
    costs
        .map(|(index, ((_, hypothesis), (total, _)))| (total + step(hypothesis.pose), Some(index)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((0.0, None))
}

fn trace_back(
    keyframes: &[Keyframe],
    hypotheses: &[KeyframeHypotheses],
    best: &[Vec<(f32, Option<usize>)>],
) -> Vec<SelectedHypothesis> {
    let mut links = vec![None; keyframes.len()];
    let mut next: Option<Option<usize>> = None;
    for k in (0..keyframes.len()).rev() {
        let cheapest = || {
            let costs = best[k].iter().enumerate();
            costs
                .min_by(|a, b| a.1.0.total_cmp(&b.1.0))
                .map(|(index, _)| index)
        };
        let selected = next.flatten().or_else(cheapest);
        links[k] = selected;
        next = selected.map(|index| best[k][index].1);
    }
    let pose = |k: usize| -> Option<Pose> {
        let index = links[k]?;
        Some(hypotheses[k].hypotheses[index].1.pose)
    };
    (0..keyframes.len())
        .map(|k| {
            let before = k.checked_sub(1).and_then(pose);
            let wheels = keyframes[k].motion.zip(before).zip(pose(k));
            SelectedHypothesis {
                hypothesis: links[k],
                wheels: wheels.map(|((motion, from), to)| wheel_deviation(from, to, &motion)),
                compass: keyframes[k]
                    .compass
                    .zip(pose(k))
                    .map(|(heading, pose)| compass_deviation(pose, heading)),
            }
        })
        .collect()
}
