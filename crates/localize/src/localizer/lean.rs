//! How does the robot lean in this frame? The inertial unit's word, less the part of its error that never changes.
//!
//! An accelerometer's bias of 0.1 m/s² looks like a lean of 0.6° for ever, so that it tells changes better than leans:
//! the constant part is learnt from the leans that the points show. Roll and pitch bend the frame's ground map. A joint
//! belief that feels knows its lean itself, errors common with the pose's included.

use super::Localizer;
use crate::attitude::AttitudeConfig;
use crate::estimate::Estimate;
use crate::filter::{Belief, LeanPrior};
use crate::frame::At;
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// How fast the constant part wanders, degrees per square root of a second.
const OFFSET_DRIFT_DEG: f32 = 0.05;

/// How fast the unit's proved error is learnt, per frame and axis: within about a second.
const NOISE_LEARNING: f32 = 0.02;

/// Lean of a frame before its points are seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ExpectedLean {
    /// (a, b), radians (MATH.md 2, "Tilt").
    pub(super) mean: [f32; 2],
    /// Radians, each.
    pub(super) std: f32,
}

/// The constant part of the inertial unit's error, with its variance.
#[derive(Debug, Clone)]
pub(super) struct LeanOffset {
    offset: [f32; 2],
    variance: f32,
    /// Variance of the rest of the unit's error, as it proves, rad².
    noise: f32,
}

impl LeanOffset {
    pub(super) fn new(config: &AttitudeConfig) -> Self {
        LeanOffset {
            offset: [0.0; 2],
            variance: config.lean_offset_std_deg.to_radians().powi(2),
            noise: (3.0 * config.lean_std_deg).to_radians().powi(2),
        }
    }

    /// The unit's `lean` and how robots usually stand (zero ± `usual`, radians) together.
    pub(super) fn expected(&self, lean: [f32; 2], usual: f32) -> ExpectedLean {
        let own = self.variance + self.noise;
        let usual = usual * usual;
        let share = usual / (usual + own).max(1e-12);
        ExpectedLean {
            mean: std::array::from_fn(|k| share * (lean[k] - self.offset[k])),
            std: (share * own).sqrt(),
        }
    }

    /// Learns from the lean that a frame's points showed beyond the expected one, given the variances that were left.
    pub(super) fn learn(
        &mut self,
        lean: [f32; 2],
        expected: &ExpectedLean,
        shown: [f32; 2],
        left: [f32; 2],
        seconds: f32,
        config: &AttitudeConfig,
    ) {
        let before = expected.std * expected.std;
        let drift = OFFSET_DRIFT_DEG.to_radians();
        self.variance += drift * drift * seconds;
        let mut variance = self.variance;
        for k in 0..2 {
            // What the points said by themselves: x⁺ = P⁺ (P⁻¹ x + R⁻¹ z).
            let information = 1.0 / left[k].max(1e-9) - 1.0 / before.max(1e-9);
            if information <= 1e-3 / before.max(1e-9) {
                continue;
            }
            let alone = 1.0 / information;
            let seen = expected.mean[k] + shown[k] * alone / left[k].max(1e-9);
            let off = lean[k] - seen - self.offset[k];
            // As much is believed of it as it has proved to be right.
            let proved = (off * off - alone - self.variance).clamp(0.0, 25.0 * self.noise);
            let least = config.lean_std_deg.to_radians().powi(2);
            self.noise = (self.noise + NOISE_LEARNING * (proved - self.noise)).max(least);
            let gain = self.variance / (self.variance + alone + self.noise);
            self.offset[k] += gain * off;
            variance = variance.min(self.variance * (1.0 - gain));
        }
        self.variance = variance;
    }
}

impl Localizer {
    /// Bends the points as the robot leant in their frame by the inertial unit: its lean, and what is expected of it.
    pub(super) fn bend(
        &mut self,
        exposed: Stamp,
        points: &mut [LinePoint],
    ) -> Option<([f32; 2], ExpectedLean)> {
        let (config, matching) = (&self.config.attitude, &self.config.matching);
        let usual = matching.lean_std_deg.to_radians();
        let felt = self.motion.lean_at(exposed, config);
        let Some(felt) = felt.filter(|_| config.bend && usual > 0.0) else {
            self.matcher.expect_lean(usual);
            self.lean_prior = LeanPrior::Fresh(self.matcher.lean_std());
            return None;
        };
        let known = self.belief.as_ref().and_then(Belief::lean);
        let expected = known.map_or_else(
            || self.lean.expected(felt, usual),
            |(mean, std)| ExpectedLean { mean, std },
        );
        bend(points, expected.mean, matching.viewpoint_height);
        self.matcher.expect_lean(expected.std);
        self.lean_prior = if known.is_some() {
            LeanPrior::Own
        } else {
            LeanPrior::Fresh(self.matcher.lean_std())
        };
        Some((felt, expected))
    }

    pub(super) fn learn_lean(
        &mut self,
        felt: [f32; 2],
        expected: &ExpectedLean,
        estimate: &Estimate,
        seconds: f32,
    ) {
        if let (Some(left), None) = (self.lean_left.take(), estimate.reason) {
            let config = &self.config.attitude;
            self.lean
                .learn(felt, expected, estimate.lean, left, seconds, config);
        }
    }
}

/// Where points lie on the ground if the robot leant by (a, b) when they were seen (MATH.md 2, "Tilt").
pub(super) fn bend(points: &mut [LinePoint], [a, b]: [f32; 2], height: f32) {
    for point in points {
        let At { x, y, .. } = point.at;
        let stretch = height / (height - a * x - b * y).max(0.5 * height);
        point.at = At::new((x + a * height) * stretch, (y + b * height) * stretch);
    }
}
