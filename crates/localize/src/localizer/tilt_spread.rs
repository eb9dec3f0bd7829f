//! How much does the robot tilt from image to image? The spread of the tilt, learned from the tilts that matching finds
//! (docs/methods.md 5.8).

use crate::config::LocalizeConfig;
use crate::filter::log_variance::{LogVariance, NormalizedComponent};
use crate::matching::{Match, PosePrior, RigidDifference};
use crate::math;
use crate::stamp::Stamp;

/// Random walk of the tilt's log variance per square root of a second (floor, speed).
const TILT_DRIFT: f32 = 0.2;
/// Smallest standard deviation of the tilt, degrees. A smaller one would take long to notice a robot that begins to lean.
const TILT_STD_MIN_DEG: f32 = 0.03;
/// Tilt that an inertial unit does not measure (vibration, a unit without rates about x and y, or one that is late): standard deviation
/// of an image's, degrees, that counts as a factor of 1; log factor at the start, 0.14°, and its standard deviation. Narrower at the
/// start, the first images of a robot that rocks would teach biases of the gyro. It does not fall below 0.05°, where a robot that begins
/// to rock would not be noticed.
const UNMEASURED_STD_DEG: f32 = 1.0;
const UNMEASURED_LOG_FACTOR: f32 = -4.0;
const UNMEASURED_LOG_STD: f32 = 1.5;
/// Longest time that counts between two images, seconds.
const SECONDS_MAX: f64 = 1.0;

/// Learned spread of the tilt.
#[derive(Debug, Clone)]
pub(super) struct TiltSpread {
    /// Factor of the variance of the tilt. None keeps the configured one.
    tilt: Option<LogVariance<1>>,
    /// Factor of the variance that an inertial unit does not measure. None: it measures all.
    unmeasured: Option<LogVariance<1>>,
    last_image: Option<Stamp>,
}

impl TiltSpread {
    pub(super) fn new(config: &LocalizeConfig) -> Self {
        let std = config.matching.spread_learning_std;
        let learns_tilt = std > 0.0 && config.matching.tilt_std_deg > 0.0;
        TiltSpread {
            tilt: learns_tilt.then(|| LogVariance::new(std)),
            unmeasured: learns_tilt
                .then(|| LogVariance::new(UNMEASURED_LOG_STD).starting_at(UNMEASURED_LOG_FACTOR)),
            last_image: None,
        }
    }

    /// Time since the previous image that taught, seconds.
    pub(super) fn advance_to(&mut self, stamp: Stamp) -> f32 {
        self.last_image.replace(stamp).map_or(0.0, |last| {
            last.seconds_until(stamp).clamp(0.0, SECONDS_MAX) as f32
        })
    }

    /// Standard deviation of an image's tilt, radians. `configured`: before images tell.
    pub(super) fn tilt_std(&self, configured: f32) -> f32 {
        self.tilt.map_or(configured, |tilt| {
            let [log_factor] = tilt.mean();
            let least = TILT_STD_MIN_DEG.to_radians().min(configured);
            (configured * math::exp(0.5 * log_factor)).max(least)
        })
    }

    /// Standard deviation of an image's tilt that the inertial unit does not measure, radians.
    pub(super) fn unmeasured_std(&self) -> f32 {
        self.unmeasured.map_or(0.0, |unmeasured| {
            let [log_factor] = unmeasured.mean();
            UNMEASURED_STD_DEG.to_radians() * math::exp(0.5 * log_factor)
        })
    }

    /// Takes a match under the prior of the filter's state and [`TiltSpread::unmeasured_std`].
    pub(super) fn update_unmeasured(&mut self, matched: &Match, prior: &PosePrior, seconds: f32) {
        let std = self.unmeasured_std();
        let Some(unmeasured) = &mut self.unmeasured else {
            return;
        };
        unmeasured.forget(seconds, TILT_DRIFT);
        let difference = RigidDifference::between(prior.pose, matched.pose);
        // S⁻¹(ŷ − y) = Σ⁻¹ν and Σ⁻¹, as in docs/methods.md 8.8.
        let normalized = prior.information * difference.with_tilt(matched.tilt);
        let covariance = difference.covariance(&matched.pose_tilt_covariance);
        let information = prior.information - prior.information * covariance * prior.information;
        for k in 3..5 {
            let component = NormalizedComponent {
                squared: normalized[k] * normalized[k],
                information: information[(k, k)],
            };
            unmeasured.update([std * std], component);
        }
    }

    /// An image showed a tilt (radians) that the inertial unit does not report.
    pub(super) fn widen_unmeasured(&mut self, [a, b]: [f32; 2]) {
        if let Some(unmeasured) = &mut self.unmeasured {
            let variance = 0.5 * (a * a + b * b);
            unmeasured.raise_to(math::ln(variance / UNMEASURED_STD_DEG.to_radians().powi(2)));
        }
    }

    /// Takes the tilt that matching found under a prior of zero with `std` radians.
    pub(super) fn update_tilt(&mut self, matched: &Match, std: f32, seconds: f32) {
        let Some(tilt) = &mut self.tilt else {
            return;
        };
        tilt.forget(seconds, TILT_DRIFT);
        let prior = std * std;
        for k in 0..2 {
            let posterior = matched.pose_tilt_covariance[(3 + k, 3 + k)];
            // Σ⁻¹ν and Σ⁻¹ follow from the posterior under the prior.
            let component = NormalizedComponent {
                squared: (matched.tilt[k] / prior).powi(2),
                information: (1.0 - posterior / prior) / prior,
            };
            tilt.update([prior], component);
        }
    }
}
