//! Does one set-up explain the measurements better than another one?

use super::explanation::Explanation;

/// Difference of two explanations of the same keyframes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Gain of the alternative over all keyframes: logarithm of the likelihood ratio.
    pub gain: f32,
    /// Mean gain of a keyframe over its standard error.
    pub significance: f32,
    /// Share of the keyframes that the alternative explains better, among those that it explains otherwise.
    pub better_share: f32,
}

/// A likelihood ratio of e¹⁵ leaves no doubt even among the hundred alternatives that are tried.
const GAIN_MIN: f32 = 15.0;
/// The gain must come from most keyframes: a few that another set-up explains by chance decide nothing.
const SIGNIFICANCE_MIN: f32 = 3.0;
const BETTER_SHARE_MIN: f32 = 0.55;
/// A smaller gain or loss of a keyframe is none, in log likelihood.
const GAIN_SEEN: f32 = 0.02;
/// Standard error of the mean below which keyframes count as equal, in log likelihood.
const ERROR_MIN: f32 = 0.1;

/// Compares an alternative with the configured set-up, keyframe by keyframe.
pub fn compare(configured: &Explanation, alternative: &Explanation) -> Comparison {
    let pairs = configured.keyframes.iter().zip(&alternative.keyframes);
    let gains: Vec<f32> = pairs.map(|(now, other)| now.cost - other.cost).collect();
    let count = gains.len().max(1) as f32;
    let gain = gains.iter().sum::<f32>();
    let mean = gain / count;
    let squares: f32 = gains.iter().map(|gain| (gain - mean).powi(2)).sum();
    let error = (squares / (count * (count - 1.0).max(1.0))).sqrt();
    Comparison {
        gain,
        significance: mean / error.max(ERROR_MIN),
        better_share: better_share(&gains),
    }
}

/// Keyframes that do not see what differs, such as a circle far away, say nothing.
fn better_share(gains: &[f32]) -> f32 {
    let count = |is: fn(f32) -> bool| gains.iter().filter(|gain| is(**gain)).count() as f32;
    let better = count(|gain| gain > GAIN_SEEN);
    let worse = count(|gain| gain < -GAIN_SEEN);
    better / f32::max(better + worse, 1.0)
}

impl Comparison {
    /// Does the alternative explain the measurements clearly better?
    pub fn is_better(&self) -> bool {
        self.gain >= GAIN_MIN && self.is_consistent()
    }

    /// Does the gain of the alternative come from most keyframes?
    pub fn is_consistent(&self) -> bool {
        self.significance >= SIGNIFICANCE_MIN && self.better_share >= BETTER_SHARE_MIN
    }

    /// Does the alternative explain them clearly worse?
    pub fn is_worse(&self) -> bool {
        self.gain <= -GAIN_MIN
    }
}
