//! What does a difference between a seen and a stored distance cost? minho2016 eq. 5, near points weighing more.

use super::{DISTANCE_STEPS, ScanMapConfig};

/// Steps of distance that share a weight.
const CLASS: usize = 12;
const CLASSES: usize = DISTANCE_STEPS as usize / CLASS + 1;

/// Bounds count in these parts of an error: the largest error is 180 of them, so that 16 bits hold the sum over the
/// 360 distances that a frame has at most.
pub(super) const QUANTUM: u32 = 16;
const ERROR_MAX: f32 = 180.0 * QUANTUM as f32;

/// Errors by weight and difference in steps, in parts of the largest.
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

    /// The largest error of a distance seen.
    pub(super) fn weight(&self, steps: u8) -> f32 {
        self.weights[(usize::from(steps) / CLASS).min(CLASSES - 1)]
    }

    /// The error that a difference makes: 1 − c²/(c² + t²), which vector registers compute faster than tables are read.
    #[inline(always)]
    pub(super) fn error(&self, weight: f32, difference: u8) -> u32 {
        let squared = f32::from(difference) * f32::from(difference);
        round_to_u32(weight * squared / (self.kernel_scale_squared + squared))
    }

    /// A sum of errors as a share of the largest that its distances could make.
    pub(super) fn relative(sum: u32, count: usize) -> f32 {
        sum as f32 / (ERROR_MAX * count.max(1) as f32)
    }
}

/// The nearest whole number to one of up to seven digits, without a cast's checks: in 2²³ + x the last bit counts ones.
#[inline(always)]
fn round_to_u32(number: f32) -> u32 {
    (number + 8_388_608.0).to_bits() & 0x7f_ffff
}
