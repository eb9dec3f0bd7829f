//! The error of a difference between a measured and a stored distance: minho2016 eq. 5, with larger weights for near
//! points.

use super::config::{DISTANCE_STEPS, ScanMapConfig};

/// Steps of distance that share a weight.
const CLASS: usize = 12;
const CLASSES: usize = DISTANCE_STEPS as usize / CLASS + 1;

/// Bounds are multiples of this error. The largest error is 180 of them, so that 16 bits hold the sum over the 360
/// distances that an image has at most.
pub(super) const QUANTUM: u32 = 16;
const ERROR_MAX: f32 = 180.0 * QUANTUM as f32;

/// Errors by weight and difference in steps, scaled to integers up to `ERROR_MAX`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ErrorModel {
    /// Largest errors, by class of distance.
    weights: Vec<f32>,
    /// c² in steps.
    kernel_scale_squared: f32,
}

impl ErrorModel {
    pub(super) fn new(config: &ScanMapConfig) -> Self {
        let step = config.range_max / DISTANCE_STEPS;
        let of_class = |class: usize| {
            let range = (class * CLASS) as f32 * step;
            ERROR_MAX / (1.0 + (range / config.half_weight_range).powi(2))
        };
        ErrorModel {
            weights: (0..CLASSES).map(of_class).collect(),
            kernel_scale_squared: (config.kernel_scale / step).powi(2),
        }
    }

    /// The largest error of a measured distance.
    pub(super) fn weight(&self, steps: u8) -> f32 {
        self.weights[(usize::from(steps) / CLASS).min(CLASSES - 1)]
    }

    /// The error of a difference: 1 − c²/(c² + t²). Computing it in vector registers is faster than a table look-up.
    #[inline(always)]
    pub(super) fn error(&self, weight: f32, difference: u8) -> u32 {
        let squared = f32::from(difference) * f32::from(difference);
        round_to_u32(weight * squared / (self.kernel_scale_squared + squared))
    }

    /// A sum of errors as a share of the largest sum possible for `count` distances.
    pub(super) fn relative(sum: u32, count: usize) -> f32 {
        sum as f32 / (ERROR_MAX * count.max(1) as f32)
    }
}

/// The nearest integer to a number of 0 to 2²²: in 2²³ + x the last bit of the mantissa is 1. Vectorizes, unlike a cast.
#[inline(always)]
fn round_to_u32(number: f32) -> u32 {
    (number + 8_388_608.0).to_bits() & 0x7f_ffff
}
