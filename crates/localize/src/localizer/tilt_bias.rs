//! How does the robot lean in this frame? The inertial unit's word, less the part of its error that never changes.
//!
//! An accelerometer's bias of 0.1 m/s² looks like a lean of 0.6° for ever, so that it tells changes better than leans:
//! the constant part is learnt from the leans that the points show. Roll and pitch bend the frame's ground map. A joint
//! belief that feels knows its lean itself, errors common with the pose's included.

use super::Localizer;
use crate::estimate::Estimate;
use crate::filter::{PoseFilter, TiltPrior};
use crate::frames::At;
use crate::sample::LinePoint;
use crate::sensors::attitude::AttitudeConfig;
use crate::stamp::Stamp;
use crate::tilt::ground_from_map;

/// How fast the constant part wanders, degrees per square root of a second.
const TILT_BIAS_DRIFT_DEG: f32 = 0.05;

/// How fast the unit's proved error is learnt, per frame and axis: within about a second.
const NOISE_ADAPTATION_RATE: f32 = 0.02;

/// Lean of a frame before its points are seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TiltEstimate {
    /// (a, b), radians (MATH.md 2, "Tilt").
    pub(super) mean: [f32; 2],
    /// Radians, each.
    pub(super) std: f32,
}

/// The constant part of the inertial unit's error, with its variance.
#[derive(Debug, Clone)]
pub(super) struct TiltBias {
    mean: [f32; 2],
    variance: f32,
    /// Variance of the rest of the unit's error, as it proves, rad².
    noise_variance: f32,
}

impl TiltBias {
    pub(super) fn new(config: &AttitudeConfig) -> Self {
        TiltBias {
            mean: [0.0; 2],
            variance: config.tilt_bias_std_deg.to_radians().powi(2),
            noise_variance: (3.0 * config.tilt_std_deg).to_radians().powi(2),
        }
    }

    /// The unit's `lean` and how robots usually stand (zero ± `usual`, radians) together.
    pub(super) fn correct_tilt(&self, lean: [f32; 2], usual: f32) -> TiltEstimate {
        let own = self.variance + self.noise_variance;
        let usual = usual * usual;
        let share = usual / (usual + own).max(1e-12);
        TiltEstimate {
            mean: std::array::from_fn(|k| share * (lean[k] - self.mean[k])),
            std: (share * own).sqrt(),
        }
    }

    /// Learns from the lean that a frame's points showed beyond the expected one, given the variances that were left.
    pub(super) fn update(
        &mut self,
        lean: [f32; 2],
        expected: &TiltEstimate,
        shown: [f32; 2],
        left: [f32; 2],
        seconds: f32,
        config: &AttitudeConfig,
    ) {
        let before = expected.std * expected.std;
        let drift = TILT_BIAS_DRIFT_DEG.to_radians();
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
            let off = lean[k] - seen - self.mean[k];
            // As much is believed of it as it has proved to be right.
            let proved = (off * off - alone - self.variance).clamp(0.0, 25.0 * self.noise_variance);
            let least = config.tilt_std_deg.to_radians().powi(2);
            self.noise_variance = (self.noise_variance
                + NOISE_ADAPTATION_RATE * (proved - self.noise_variance))
                .max(least);
            let gain = self.variance / (self.variance + alone + self.noise_variance);
            self.mean[k] += gain * off;
            variance = variance.min(self.variance * (1.0 - gain));
        }
        self.variance = variance;
    }
}

impl Localizer {
    /// Bends the points as the robot leant in their frame by the inertial unit: its lean, and what is expected of it.
    pub(super) fn compensate_tilt(
        &mut self,
        exposed: Stamp,
        points: &mut [LinePoint],
    ) -> Option<([f32; 2], TiltEstimate)> {
        let (config, matching) = (&self.config.attitude, &self.config.matching);
        let usual = matching.tilt_std_deg.to_radians();
        let felt = self.motion_inputs.tilt_at(exposed, config);
        let Some(felt) = felt.filter(|_| config.tilt_compensation && usual > 0.0) else {
            self.matcher.set_tilt_std(usual);
            self.tilt_prior = TiltPrior::Independent(self.matcher.tilt_std());
            return None;
        };
        let known = self.filter.as_ref().and_then(PoseFilter::tilt);
        let expected = known.map_or_else(
            || self.tilt_bias.correct_tilt(felt, usual),
            |(mean, std)| TiltEstimate { mean, std },
        );
        compensate_points(points, expected.mean, matching.viewpoint_height);
        self.matcher.set_tilt_std(expected.std);
        self.tilt_prior = if known.is_some() {
            TiltPrior::FromState
        } else {
            TiltPrior::Independent(self.matcher.tilt_std())
        };
        Some((felt, expected))
    }

    pub(super) fn update_tilt_bias(
        &mut self,
        felt: [f32; 2],
        expected: &TiltEstimate,
        estimate: &Estimate,
        seconds: f32,
    ) {
        if let (Some(left), None) = (self.tilt_variances.take(), estimate.reason) {
            let config = &self.config.attitude;
            self.tilt_bias
                .update(felt, expected, estimate.tilt, left, seconds, config);
        }
    }
}

/// Moves points of the upright map to their ground points for tilt (a, b) (docs/methods.md 3.3).
pub(super) fn compensate_points(points: &mut [LinePoint], [a, b]: [f32; 2], height: f32) {
    for point in points {
        let At { x, y, .. } = point.at;
        let [x, y] = ground_from_map([x, y], [a, b], height);
        point.at = At::new(x, y);
    }
}
