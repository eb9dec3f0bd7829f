//! By which angle is a compass turned, or does it count in degrees? And which other angle would fit as well?

use std::f32::consts::TAU;

use localize::frames::wrap_angle;
use localize::math;
use localize::setup_check::{Explanation, Keyframe};

use super::assess::{Improvement, Trial};
use super::change::Change;
use super::measurements::MeasuredKeyframe;
use super::variant::SetupVariant;
use crate::setup::Setup;

/// A compass that is turned by a multiple of 90 degrees is mounted so. Its iron turns it further by up to this, degrees.
const IRON_MAX_DEG: f32 = 15.0;
/// Steps of another angle, degrees: the bias of a compass is of this size.
const STEP_DEG: f32 = 5.0;
/// Fewest readings of which a mean deviation is told.
const READINGS_MIN: usize = 8;
/// A deviation is constant if its mean exceeds so many standard deviations of a reading.
const CONSTANT_SPREADS: f32 = 2.0;

impl Trial<'_> {
    /// Turns, and turns of a compass that counts clockwise.
    pub(super) fn compass_quarter_turns() -> impl Iterator<Item = Change> {
        let turned = [90, 180, 270].map(Change::CompassTurn);
        turned
            .into_iter()
            .chain([0, 90, 180, 270].map(Change::CompassMirrored))
    }

    /// Could the headings be in degrees? Such ones all within a turn of radians say that the robot stood within six degrees of
    /// zero: any of its poses would agree with them.
    pub(super) fn headings_can_be_degrees(&self) -> bool {
        let mut headings = self.measured.iter().filter_map(|keyframe| keyframe.compass);
        headings.any(|heading| heading.abs() > TAU)
    }

    /// The same change by the angle that the poses tell, if it is clearly no quarter turn.
    pub(super) fn refine_compass_turn(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
        found: Improvement,
    ) -> Improvement {
        let Change::CompassTurn(degrees) = found.change else {
            return found;
        };
        let residual = residual_deg(self.setup, &found, self.measured);
        if residual.abs() <= IRON_MAX_DEG {
            return found;
        }
        let turn = f32::from(degrees) + (residual / STEP_DEG).round() * STEP_DEG;
        let change = Change::CompassTurn(turn.rem_euclid(360.0) as u16);
        let refined = self.evaluate(variant, now, vec![change]);
        refined
            .into_iter()
            .next()
            .map_or(found, |(_, refined)| refined)
    }
}

/// Mean angle from the readings, as changed, to the headings of the poses, degrees.
fn residual_deg(setup: &Setup, found: &Improvement, measured: &[MeasuredKeyframe]) -> f32 {
    let keyframes = found.after.apply(setup, measured);
    let pairs = keyframes.iter().zip(&found.explanation.keyframes);
    let agreeing = pairs.filter(|(_, fit)| fit.compass_agrees == Some(true));
    let angles = agreeing.filter_map(|(keyframe, fit)| Some(fit.pose?.theta - keyframe.compass?));
    mean_angle(angles).to_degrees()
}

/// Constant angle from readings that agree with the poses to the poses' headings, degrees: half of a quarter turn and more still agrees,
/// since poses with a compass that steel turns have to. None below what iron explains, or if it varies as beside steel.
pub(super) fn constant_deviation_deg(
    configured: &Explanation,
    keyframes: &[Keyframe],
) -> Option<f32> {
    let pairs = keyframes.iter().zip(&configured.keyframes);
    let angles: Vec<f32> = pairs
        .filter_map(|(keyframe, fit)| Some(fit.pose?.theta - keyframe.compass?))
        .collect();
    let mean = mean_angle(angles.iter().copied());
    let squares = angles.iter().map(|angle| wrap_angle(angle - mean).powi(2));
    let spread = (squares.sum::<f32>() / angles.len().max(1) as f32).sqrt();
    let is_constant = angles.len() >= READINGS_MIN && mean.abs() > CONSTANT_SPREADS * spread;
    (is_constant && mean.abs().to_degrees() > IRON_MAX_DEG).then(|| mean.to_degrees())
}

fn mean_angle(angles: impl Iterator<Item = f32>) -> f32 {
    let (sin, cos) = angles.fold((0.0, 0.0), |(sin, cos), angle| {
        (sin + math::sin(angle), cos + math::cos(angle))
    });
    math::atan2(sin, cos)
}
