//! How far do rays see beyond their slope? Their footprints are wider than a pixel, and neighbouring ones overlap.

/// Rays between entries of the table of overlapping footprints.
const REACH_STRIDE: usize = 256;
/// Largest footprint that counts there, in slope, relative to 1 + |slope|.
const REACH_MAX: f32 = 0.05;

/// The slopes that footprints reach, by slope.
#[derive(Debug, Clone, Default)]
pub(super) struct SlopeReach {
    /// Every `REACH_STRIDE`th slope of all rays in increasing order, and the last one.
    slopes: Vec<f32>,
    /// Highest slope in the footprint of any ray up to the next entry.
    up: Vec<f32>,
    /// Lowest slope in the footprint of any ray from this entry on.
    down: Vec<f32>,
}

impl SlopeReach {
    pub(super) fn new(slopes: &[f32], spacing: &[f32]) -> Self {
        // Where two parts of the mirror meet, neighbouring pixels look far apart; these few do not count.
        let mut sorted: Vec<(f32, f32)> = (slopes.iter().zip(spacing))
            .map(|(&slope, &spacing)| (slope, spacing.min(REACH_MAX * (1.0 + slope.abs()))))
            .collect();
        sorted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut reach = SlopeReach::default();
        for rays in sorted.chunks(REACH_STRIDE) {
            let mut spacings: Vec<f32> = rays.iter().map(|ray| ray.1).collect();
            let typical = (spacings.len() - 1) * 15 / 16;
            let (_, spacing, _) = spacings.select_nth_unstable_by(typical, f32::total_cmp);
            reach.slopes.push(rays[0].0);
            reach.up.push(rays[rays.len() - 1].0 + *spacing / 2.0);
            reach.down.push(rays[0].0 - *spacing / 2.0);
        }
        let mut highest = f32::NEG_INFINITY;
        for up in &mut reach.up {
            highest = highest.max(*up);
            *up = highest;
        }
        let mut lowest = f32::INFINITY;
        for down in reach.down.iter_mut().rev() {
            lowest = lowest.min(*down);
            *down = lowest;
        }
        reach.slopes.extend(sorted.last().map(|ray| ray.0));
        reach
    }

    /// Distance from a slope to the lowest one whose footprint reaches up to it.
    pub(super) fn below(&self, slope: f32) -> f32 {
        let first = self.up.partition_point(|&up| up < slope);
        (slope - self.slopes.get(first).copied().unwrap_or(slope)).max(0.0)
    }

    /// Distance from a slope to the highest one whose footprint reaches down to it.
    pub(super) fn above(&self, slope: f32) -> f32 {
        let end = self.down.partition_point(|&down| down <= slope);
        (self.slopes.get(end).copied().unwrap_or(f32::INFINITY) - slope).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_footprint_that_meets_a_slope_is_within_reach() {
        // Footprints widen towards the steep rays.
        let slopes: Vec<f32> = (1..40_000u16).map(|ray| -5e-5 * f32::from(ray)).collect();
        let spacing: Vec<f32> = slopes.iter().map(|slope| 0.03 * slope.powi(2)).collect();
        let reach = SlopeReach::new(&slopes, &spacing);
        for limit in [-1.5f32, -0.4, -0.15, -0.07] {
            let (low, high) = (limit - reach.below(limit), limit + reach.above(limit));
            for (slope, spacing) in slopes.iter().zip(&spacing) {
                let meets = (slope - limit).abs() <= spacing / 2.0;
                assert!(
                    !meets || (low <= *slope && *slope <= high),
                    "{slope} {limit}"
                );
            }
            // The reach is of the footprints' size, not of the whole image.
            assert!(
                high - low < 0.2 * limit.abs() + 0.06,
                "{low} {limit} {high}"
            );
        }
    }
}
