//! How much does the robot tilt from image to image? The spread of the tilt, learned from the tilts that matching finds
//! (docs/methods.md 5.8).

use crate::config::LocalizeConfig;
use crate::filter::log_variance::{LogVariance, NormalizedComponent};
use crate::matching::Match;
use crate::math;
use crate::stamp::Stamp;

/// Random walk of the tilt's log variance per square root of a second (floor, speed).
const TILT_DRIFT: f32 = 0.2;
/// Smallest standard deviation of the tilt, degrees. A smaller one would take long to notice a robot that begins to lean.
const TILT_STD_MIN_DEG: f32 = 0.03;
/// Longest time that counts between two images, seconds.
const SECONDS_MAX: f64 = 1.0;

/// Learned spread of the tilt.
#[derive(Debug, Clone)]
pub(super) struct TiltSpread {
    /// Factor of the variance of the tilt. None keeps the configured one.
    tilt: Option<LogVariance<1>>,
    last_image: Option<Stamp>,
}

impl TiltSpread {
    pub(super) fn new(config: &LocalizeConfig) -> Self {
        let std = config.matching.spread_learning_std;
        let learns_tilt = std > 0.0 && config.matching.tilt_std_deg > 0.0;
        TiltSpread {
            tilt: learns_tilt.then(|| LogVariance::new(std)),
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
