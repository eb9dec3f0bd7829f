//! What is the direction of the lines? The robot's heading from histograms of its line points (minho2016 V.B).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math;
use crate::sample::LinePoint;

/// Settings of the histograms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HeadingHistogramConfig {
    /// Largest change of heading since the last image, degrees (minho2016 V.B: 40).
    pub search_range_deg: f32,
    /// Step of the rotation, degrees.
    pub step_deg: f32,
    /// Width of a bin, metres: about a line's width.
    pub bin_width: f32,
    /// Points beyond this range are not counted, metres.
    pub range_max: f32,
}

impl Default for HeadingHistogramConfig {
    fn default() -> Self {
        HeadingHistogramConfig {
            search_range_deg: 40.0,
            step_deg: 1.0,
            bin_width: 0.12,
            range_max: 6.0,
        }
    }
}

/// The heading within `search_range_deg` of `last` (radians) at which the histograms along x and y have the highest
/// peaks; None without points.
///
/// Lines are parallel to both axes, so that four headings 90° apart fit equally. The result is the one near `last`.
pub fn histogram_heading(
    points: &[LinePoint],
    last: f32,
    config: &HeadingHistogramConfig,
) -> Option<f32> {
    if points.is_empty() {
        return None;
    }
    let half = (config.search_range_deg / config.step_deg).round() as i32;
    let heading = |step: i32| last + (step as f32 * config.step_deg).to_radians();
    let peaks: Vec<f32> = (-half..=half)
        .map(|step| histogram_peak(points, heading(step), config))
        .collect();
    let best = (0..peaks.len())
        .rev()
        .max_by(|&a, &b| peaks[a].total_cmp(&peaks[b]))?;
    // The mean of the best step and its neighbours, weighted by their squared height above the lowest peak.
    let floor = peaks.iter().copied().fold(f32::MAX, f32::min);
    let (mut sum, mut weight) = (0.0, 0.0);
    let neighbours = best.saturating_sub(2)..(best + 3).min(peaks.len());
    for (k, peak) in neighbours.clone().zip(&peaks[neighbours]) {
        let prominence = (peak - floor).powi(2);
        sum += prominence * (k as f32 - half as f32);
        weight += prominence;
    }
    let step = if weight > 0.0 {
        sum / weight
    } else {
        best as f32 - half as f32
    };
    Some(crate::frames::wrap_angle(
        last + (step * config.step_deg).to_radians(),
    ))
}

/// Sum of the highest bins of the histograms along x and y, with the points rotated by `heading` (radians).
pub fn histogram_peak(points: &[LinePoint], heading: f32, config: &HeadingHistogramConfig) -> f32 {
    let bins = (2.0 * config.range_max / config.bin_width) as usize + 2;
    let mut along = vec![0.0_f32; bins];
    let mut across = vec![0.0_f32; bins];
    let (sin, cos) = math::sin_cos(heading);
    for point in points {
        let (x, y) = (point.at.x, point.at.y);
        if math::hypot(x, y) >= config.range_max {
            continue;
        }
        for (histogram, value) in [
            (&mut along, cos * x - sin * y),
            (&mut across, sin * x + cos * y),
        ] {
            // Each point is split between two bins, so that a line on their border is not halved.
            let place = (value + config.range_max) / config.bin_width;
            let bin = place as usize;
            let part = place - bin as f32;
            histogram[bin] += 1.0 - part;
            histogram[bin + 1] += part;
        }
    }
    let highest = |histogram: &[f32]| {
        histogram
            .windows(2)
            .map(|pair| pair[0] + pair[1])
            .fold(0.0, f32::max)
    };
    highest(&along) + highest(&across)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;
    use crate::frames::wrap_angle;
    use crate::synthetic::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn histogram_heading_is_within_three_degrees_in_nine_of_ten_views() {
        let field = league_18x12("centres");
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut right = 0;
        for k in 0..100 {
            let pose = random_pose(&field, &mut rng);
            let points =
                simulate_line_points(&field, &SyntheticDriveConfig::default(), pose, &mut rng);
            let last = pose.theta + (k as f32 - 50.0) * 0.01;
            let found = histogram_heading(&points, last, &HeadingHistogramConfig::default());
            let off = wrap_angle(found.expect("points") - pose.theta).abs();
            right += usize::from(off < 3.0_f32.to_radians());
        }
        assert!(right >= 90, "{right} of 100");
    }
}
