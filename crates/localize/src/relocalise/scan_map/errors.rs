//! What does a difference between a seen and a stored distance cost? minho2016 eq. 5, near points weighing more.

use super::{STEPS, ScanMapConfig};

/// Steps of distance that share a weight.
const CLASS: usize = 12;
const CLASSES: usize = STEPS as usize / CLASS + 1;

/// Bounds count in these parts of an error: the largest error is 180 of them, so that 16 bits hold the sum over the
/// 360 distances that a frame has at most.
pub(super) const QUANTUM: u32 = 16;
const LARGEST: f32 = 180.0 * QUANTUM as f32;

/// Errors by weight and difference in steps, in parts of the largest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Errors(Vec<[u16; 256]>);

impl Errors {
    pub(super) fn new(config: &ScanMapConfig) -> Self {
        let step = config.range / STEPS;
        let of_class = |class: usize| {
            let range = (class * CLASS) as f32 * step;
            let weight = 1.0 / (1.0 + (range / config.half_weight).powi(2));
            std::array::from_fn(|difference| {
                let t = difference as f32 * step;
                let c = config.reach;
                (LARGEST * weight * (1.0 - c * c / (c * c + t * t))) as u16
            })
        };
        Errors((0..CLASSES).map(of_class).collect())
    }

    /// By difference, of a distance seen.
    pub(super) fn of(&self, steps: u8) -> &[u16; 256] {
        &self.0[(usize::from(steps) / CLASS).min(CLASSES - 1)]
    }

    /// A sum of errors as a share of the largest that its distances could make.
    pub(super) fn mean(sum: u32, count: usize) -> f32 {
        sum as f32 / (LARGEST * count.max(1) as f32)
    }
}
