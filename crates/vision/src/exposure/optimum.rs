//! State of the search: its present part, the image that it judges, and the level that it found best.

use serde::{Deserialize, Serialize};

use crate::exposure::histogram::Histogram;

/// What a search does at present.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) enum SearchPhase {
    /// The light changed: first the level of the optimum is restored. `steady`: successive images that have it.
    RestoringLevel { steady: u32 },
    /// The entropy's peak is searched.
    MaximizingEntropy,
}

/// One measured image.
pub(super) struct Measurement<'a> {
    pub(super) histogram: &'a Histogram,
    /// Bits.
    pub(super) entropy: f32,
    /// Brightness of the image's centre, of 255; at least 1.
    pub(super) level: f32,
    pub(super) image_index: u64,
}

/// Centre level of the highest entropy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Optimum {
    /// Brightness of the image's centre, of 255.
    pub(super) level: f32,
    /// Entropy of the images at this level.
    pub(super) entropy: EntropyStatistics,
}

/// Mean and variance of the entropy while the setting stays, bits: it varies with the scene as the robot drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct EntropyStatistics {
    mean: f32,
    variance: f32,
    count: f32,
}

/// Measurements over which the entropy is averaged: about 10 s.
const COUNT_MAX: f32 = 100.0;
/// Standard deviations below the mean from which an entropy is taken as a loss.
const LOSS_DEVIATIONS: f32 = 3.0;

impl EntropyStatistics {
    /// Starts with one measurement.
    pub(super) fn new(entropy: f32) -> Self {
        EntropyStatistics {
            mean: entropy,
            variance: 0.0,
            count: 1.0,
        }
    }

    /// Adds a measurement.
    pub(super) fn add(&mut self, entropy: f32) {
        self.count = (self.count + 1.0).min(COUNT_MAX);
        let difference = entropy - self.mean;
        self.mean += difference / self.count;
        self.variance += (difference * (entropy - self.mean) - self.variance) / self.count;
    }

    /// True if this entropy is within the variation. `deviation_min`: smallest standard deviation, bits.
    pub(super) fn is_usual(&self, entropy: f32, deviation_min: f32) -> bool {
        let deviation = self.variance.max(0.0).sqrt().max(deviation_min);
        entropy >= self.mean - LOSS_DEVIATIONS * deviation
    }
}
