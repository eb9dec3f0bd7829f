//! Would a camera turned by any angle, or other wheels, explain the steps between keyframes better?

use std::f32::consts::FRAC_PI_4;

use localize::frames::wrap_angle;
use localize::math;
use localize::setup_check::Explanation;
use nalgebra::Matrix3;

use super::assess::{Improvement, Trial};
use super::change::Change;
use super::measurements::MeasuredKeyframe;
use super::origin_offset::OriginOffset;
use super::variant::SetupVariant;
use localize::wheel_steps::{
    MatrixFit, MeasuredStep, angle_between, factor_between, matrix_between, matrix_gain,
};

/// A smaller turn of the camera is no mistake, radians.
const TURN_MIN: f32 = 2.0 * std::f32::consts::PI / 180.0;
/// Standard deviations that a turn must have.
const TURN_SIGMAS: f32 = 3.0;
/// Turns so close to a quarter are left to the mounts, radians.
const QUARTER_REACH: f32 = 0.035;
/// Log likelihood that each number of a wheels' matrix must gain: half the logarithm of some forty steps.
const NUMBER_COST: f32 = 2.0;
/// Fits of the wheels with the number of their numbers: one factor, or nine elements of a matrix.
const WHEEL_FITS: [(FitWheels, f32); 2] = [(factor_between, 1.0), (matrix_between, 9.0)];
/// Gain by the spread of the steps that leaves no doubt, and the smallest change of an element that is a mistake then.
const MATRIX_GAIN_MIN: f32 = 15.0;
const MATRIX_MIN: f32 = 0.06;
/// Determinant of the part for translations below which a matrix leaves the wheels out.
const DETERMINANT_MIN: f32 = 0.05;
/// Corrections of a matrix: steps of wrong wheels join with an error.
const MATRIX_PASSES: usize = 3;

type FitWheels = fn(&[MeasuredStep]) -> Option<MatrixFit>;

/// Angle between the direction of a motion at a row's start and that of its chord: half of the row's turn, radians, in the
/// mean over the path. Tables mean either by a row's motion, and a robot that spins one way shows the difference.
fn turn_within_rows(measured: &[MeasuredKeyframe]) -> f32 {
    let rows = measured
        .iter()
        .filter_map(|keyframe| keyframe.odometry.as_ref());
    let (mut sum, mut path) = (0.0_f32, 0.0_f32);
    for [dx, dy, turn] in rows.flatten() {
        let length = math::hypot(*dx, *dy);
        sum += 0.5 * turn * length;
        path += length;
    }
    if path > 0.0 { (sum / path).abs() } else { 0.0 }
}

impl Trial<'_> {
    /// The camera turned by the angle between wheels and poses. `wide`: starts at odd multiples of 45 degrees, too.
    pub(super) fn search_turn(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
        wide: bool,
    ) -> Vec<(Change, Improvement)> {
        let turn_min = TURN_MIN + turn_within_rows(self.measured);
        // Wheels of unequal radius turn the chord of a step, too: they are fitted along with the camera's turn.
        let turn_and_least = |found: &Explanation| {
            let fit = found.wheels_fit()?;
            Some((fit.turn, TURN_SIGMAS * fit.turn_std))
        };
        let known = turn_and_least(now).map(|(angle, least)| (-angle, least));
        let mut turns: Vec<(f32, f32)> = known.into_iter().collect();
        if wide {
            for start in [1.0, 3.0, 5.0, 7.0].map(|odd| wrap_angle(odd * FRAC_PI_4)) {
                let turned = Change::CameraTurn(start).apply(variant);
                let explained = self.explain(&turned, self.measured);
                let found = explained.as_ref().and_then(turn_and_least);
                turns.extend(found.map(|(angle, least)| (wrap_angle(start - angle), least)));
            }
        }
        let turns = turns
            .into_iter()
            .filter(|(turn, least)| turn.abs() > least.max(turn_min));
        let mut changes: Vec<Change> = Vec::new();
        for (turn, _) in turns {
            let quarter = (turn / (2.0 * FRAC_PI_4)).round() * 2.0 * FRAC_PI_4;
            let is_mount = quarter.abs() > 0.1 && (turn - quarter).abs() < QUARTER_REACH;
            let is_known = changes.iter().any(|known| {
                matches!(known, Change::CameraTurn(other) if wrap_angle(turn - other).abs() < TURN_MIN)
            });
            if !is_mount && !is_known {
                changes.push(Change::CameraTurn(turn));
            }
        }
        self.evaluate(variant, now, changes)
    }

    /// The wheels' path in axes that do not turn with the robot, whose heading there at the first keyframe the steps tell.
    pub(super) fn search_fixed_axes(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Vec<(Change, Improvement)> {
        let along_first = Change::OdometryFixedAxes(0.0).apply(variant);
        let explained = self.explain(&along_first, self.measured);
        let angle = explained.and_then(|found| angle_between(&found.steps()));
        let changes = angle.map(|(angle, _)| Change::OdometryFixedAxes(-angle));
        self.evaluate(variant, now, changes.into_iter().collect())
    }

    /// The wheels corrected by a factor or by a matrix, whichever gains more. The gain is reduced by the cost of its numbers.
    pub(super) fn search_wheels(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<(Change, Improvement)> {
        let fits = WHEEL_FITS.iter().filter_map(|(fit, numbers)| {
            self.fit_wheels(variant, now, *fit, NUMBER_COST * numbers)
        });
        fits.max_by(|a, b| a.1.comparison.gain.total_cmp(&b.1.comparison.gain))
    }

    /// The wheels corrected by a fit whose numbers cost `cost`. Wheels that are wrong by less than what a step between keyframes may
    /// err gain by the spread of the steps.
    fn fit_wheels(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
        fit: FitWheels,
        cost: f32,
    ) -> Option<(Change, Improvement)> {
        let mut total = MatrixFit {
            matrix: Matrix3::identity(),
            std: 0.0,
        };
        let mut explanation = now.clone();
        for _ in 0..MATRIX_PASSES {
            let found = fit(&explanation.steps())?;
            // What is left of the first error is small: the last fit tells the uncertainty.
            total = MatrixFit {
                matrix: found.matrix * total.matrix,
                std: found.std * total.matrix.abs().max(),
            };
            let after = Change::WheelMatrix(total).apply(variant);
            explanation = self.explain(&after, self.measured)?;
        }
        // Wheels that are left out agree with any motion.
        if total.matrix.fixed_view::<2, 2>(0, 0).determinant().abs() < DETERMINANT_MIN {
            return None;
        }
        let mut wrong = total.matrix - Matrix3::identity();
        // An offset may be that of the map's origin.
        (wrong[(0, 2)], wrong[(1, 2)]) = (0.0, 0.0);
        let is_wrong = wrong.abs().max() > MATRIX_MIN;
        if !is_wrong && OriginOffset::find(now).is_some() {
            // Wheels of other radii or directions are wrong in other elements, too: poses about another point are the likelier mistake.
            return None;
        }
        let found = self.evaluate(variant, now, vec![Change::WheelMatrix(total)]);
        let (change, mut improvement) = found.into_iter().next()?;
        improvement.comparison.gain -= cost;
        if is_wrong {
            let gain = matrix_gain(&now.steps(), &total.matrix) - cost;
            improvement.comparison.gain = improvement.comparison.gain.max(gain);
            improvement.by_steps = gain > MATRIX_GAIN_MIN;
        }
        Some((change, improvement))
    }
}
