//! How does the localizer weigh the points of an image?

/// How the localizer weighs the points of an image.
#[derive(Debug, Clone, Copy)]
pub struct PointWeights {
    /// Kernel scale in standard deviations of a point.
    pub kernel_scale_sigmas: f32,
    /// Standard deviation of the markings, metres.
    pub map_std: f32,
    /// Exponent of the points' likelihood.
    pub likelihood_exponent: f32,
    /// Log odds that decide between two hypotheses.
    pub deciding_log_odds: f32,
}
