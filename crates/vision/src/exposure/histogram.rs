//! Predicts the entropy at another exposure by stretching an image's histograms.

use localize::math;

use crate::image::ImageView;

/// Histograms of red, green and blue.
pub(super) struct Histogram {
    counts: [[f32; 256]; 3],
    total: f32,
}

/// Steps tried per doubling of the level: a ratio of 2^(1/12), 6 %.
const STEPS_PER_STOP: f32 = 12.0;
/// Largest predicted change, doublings; beyond, too many pixels are clipped or lost in noise.
const STOPS_MAX: f32 = 2.0;
/// The true levels of clipped pixels are unknown. They are assumed to continue above 255 with the density of these
/// levels, up to twice 255 at most.
const TAIL_LEVELS: std::ops::Range<usize> = 215..255;
const CLIPPED_LEVEL_MAX: f32 = 510.0;

impl Histogram {
    /// Counts the levels of some pixels.
    pub(super) fn from_pixels(image: &ImageView<'_>, pixels: &[[u16; 2]]) -> Self {
        let mut counts = [[0.0; 256]; 3];
        for &[u, v] in pixels {
            let rgb = image.rgb(usize::from(u), usize::from(v));
            for (counts, level) in counts.iter_mut().zip(rgb) {
                counts[usize::from(level)] += 1.0;
            }
        }
        Histogram {
            counts,
            total: pixels.len().max(1) as f32,
        }
    }

    /// Entropy of the image if all levels were multiplied by `scale`, bits (nubot2013 eq. 5).
    pub(super) fn entropy(&self, scale: f32) -> f32 {
        self.counts
            .iter()
            .map(|counts| self.channel_entropy(counts, scale))
            .sum()
    }

    fn channel_entropy(&self, counts: &[f32; 256], scale: f32) -> f32 {
        let mut stretched = [0.0f32; 256];
        let below: f32 = counts[TAIL_LEVELS].iter().sum();
        let density = below / TAIL_LEVELS.len() as f32;
        let clipped_to = (255.0 + counts[255] / density.max(1e-6)).clamp(260.0, CLIPPED_LEVEL_MAX);
        for (level, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0.0) {
            let from = level as f32;
            let to = if level == 255 { clipped_to } else { from + 1.0 };
            if scale == 1.0 {
                stretched[level] += count;
            } else {
                distribute_count(&mut stretched, from * scale, to * scale, count);
            }
        }
        stretched
            .iter()
            .filter(|count| **count > 0.0)
            .map(|count| {
                let share = count / self.total;
                -share * math::log2(share)
            })
            .sum()
    }

    /// Scale with the highest entropy; 1 if no scale gains `gain_min` bits.
    ///
    /// The entropy has one peak: searches from 1 in each direction until three steps in a row do not rise.
    pub(super) fn best_scale(&self, gain_min: f32) -> f32 {
        // Stretching fills gaps between levels, so the reference is stretched too.
        let here = self.entropy(1.0 + 1e-4);
        let mut best = (here + gain_min, 1.0);
        for sign in [-1.0f32, 1.0] {
            let mut falls = 0;
            let mut highest = here;
            for step in 1..=(STOPS_MAX * STEPS_PER_STOP) as u32 {
                if falls > 2 {
                    break;
                }
                let scale = math::exp2(sign * step as f32 / STEPS_PER_STOP);
                let entropy = self.entropy(scale);
                falls = if entropy > highest { 0 } else { falls + 1 };
                highest = highest.max(entropy);
                if entropy > best.0 {
                    best = (entropy, scale);
                }
            }
        }
        best.1
    }
}

/// Distributes a count evenly over the levels from..to; levels above 255 are clipped to it.
fn distribute_count(levels: &mut [f32; 256], from: f32, to: f32, count: f32) {
    let per_level = count / (to - from).max(1e-6);
    let inside = to.min(255.0);
    if inside < to {
        levels[255] += per_level * (to - from.max(255.0));
    }
    let mut at = from;
    while at < inside {
        let level = at as usize;
        let next = ((level + 1) as f32).min(inside);
        levels[level.min(255)] += per_level * (next - at);
        at = next;
    }
}
