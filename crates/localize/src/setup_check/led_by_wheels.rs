//! Where do the wheels lead from a keyframe? A pose that a search of single images misses.
//!
//! An image of few lines, or of a floor that looks alike in many places, fits more poses than a search lists. Where the wheels contradict
//! the chosen poses, those to which they lead from either side are tried, too (docs/methods.md 16.1).

use crate::frames::Pose;

use super::chain::{KeyframeHypotheses, SelectedHypothesis, select_chain};
use super::keyframe::Keyframe;
use super::tables::FieldTables;

/// Choices of a chain: each may move the place where wheels and poses contradict one another.
const ROUNDS: usize = 4;

/// The cheapest chain through the hypotheses, to which those that the wheels lead to are added.
pub(super) fn select_led_chain(
    tables: &mut FieldTables,
    keyframes: &[Keyframe],
    hypotheses: &mut [KeyframeHypotheses],
) -> Vec<SelectedHypothesis> {
    let mut links = select_chain(keyframes, hypotheses);
    for _ in 0..ROUNDS {
        if !add_led(tables, keyframes, hypotheses, &links) {
            break;
        }
        links = select_chain(keyframes, hypotheses);
    }
    links
}

/// Adds the poses to which the wheels lead from both sides of each contradiction, up to the next one. False if none is new.
fn add_led(
    tables: &mut FieldTables,
    keyframes: &[Keyframe],
    hypotheses: &mut [KeyframeHypotheses],
    links: &[SelectedHypothesis],
) -> bool {
    let chosen: Vec<Option<Pose>> = links
        .iter()
        .zip(hypotheses.iter())
        .map(|(link, own)| Some(own.hypotheses[link.hypothesis?].1.pose))
        .collect();
    let contradicts = |k: usize| links[k].wheels_agree() == Some(false);
    let mut added = false;
    for start in (1..keyframes.len()).filter(|k| contradicts(*k)) {
        let end = (start + 1..keyframes.len()).find(|k| contradicts(*k));
        let mut pose = chosen[start - 1];
        for k in start..end.unwrap_or(keyframes.len()) {
            let motion = keyframes[k].motion.as_ref();
            let Some(led) = pose.zip(motion).map(|(pose, motion)| pose * motion.step) else {
                break;
            };
            pose = Some(tables.add_near(&keyframes[k], led, &mut hypotheses[k], &mut added));
        }
        let before = (1..start).rev().find(|k| contradicts(*k)).unwrap_or(0);
        let mut pose = chosen[start];
        for k in (before..start).rev() {
            let motion = keyframes[k + 1].motion.as_ref();
            let Some(led) = pose
                .zip(motion)
                .map(|(pose, motion)| pose * motion.step.inverse())
            else {
                break;
            };
            pose = Some(tables.add_near(&keyframes[k], led, &mut hypotheses[k], &mut added));
        }
    }
    added
}
