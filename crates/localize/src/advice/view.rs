//! What does the robot see of the markings? Range, free directions and points per angle, from the present image.

use std::f32::consts::TAU;

use super::AdviceConfig;
use super::disagreement::{DisagreeingSample, MarkingSample};
use crate::frames::Pose;
use crate::math;
use crate::sample::LinePoint;

/// Sectors of the view.
const SECTORS: usize = 24;
/// Nearest marking seen, metres: the robot's own body covers the others.
const RANGE_MIN: f32 = 0.35;
/// Points that must be missing in a sector for it to count as covered.
const MISSING_MIN: f32 = 2.0;
/// Largest number of points per radian of marking.
const DENSITY_MAX: f32 = 60.0;

/// View of the present image.
#[derive(Debug, Clone)]
pub(super) struct View {
    /// Line points per radian of marking in view.
    density: f32,
    /// Directions in the robot frame in which nothing is seen, by sector.
    covered: [bool; SECTORS],
    range_max: f32,
}

impl View {
    /// Compares the points of an image with what two hypotheses predict. None if neither predicts anything.
    pub(super) fn from_image(
        points: &[LinePoint],
        samples: &[MarkingSample],
        hypotheses: [Pose; 2],
        config: &AdviceConfig,
    ) -> Option<Self> {
        let range_max = observed_range(points, config);
        let mut seen = [0.0_f32; SECTORS];
        for point in points {
            seen[sector_of(point.at.bearing())] += 1.0;
        }
        let predicted = hypotheses.map(|pose| {
            let mut angles = [0.0_f32; SECTORS];
            for sample in samples {
                if let Some((sector, angle)) = visible(sample, pose, range_max) {
                    angles[sector] += angle;
                }
            }
            angles
        });
        let total = |angles: &[f32; SECTORS]| angles.iter().sum::<f32>();
        let least = predicted.iter().map(total).fold(f32::MAX, f32::min);
        if !(least > 0.0) || points.is_empty() {
            return None;
        }
        let most = predicted.iter().map(total).fold(0.0, f32::max);
        let density = (points.len() as f32 / most).min(DENSITY_MAX);
        let covered = std::array::from_fn(|k| {
            seen[k] == 0.0
                && predicted
                    .iter()
                    .all(|angles| density * angles[k] >= MISSING_MIN)
        });
        Some(View {
            density,
            covered,
            range_max,
        })
    }

    /// Expected cost under the other hypothesis of the points seen at `pose`. The covered sectors turn with the robot.
    pub(super) fn expected_cost(&self, samples: &[DisagreeingSample], pose: Pose) -> f32 {
        let sum: f32 = samples
            .iter()
            .filter_map(|DisagreeingSample { sample, cost }| {
                let (sector, angle) = visible(sample, pose, self.range_max)?;
                (!self.covered[sector]).then_some(cost * angle)
            })
            .sum();
        self.density * sum
    }
}

/// Least range that is taken as observed, metres.
const OBSERVED_RANGE_MIN: f32 = 1.0;
/// Share of the points within the observed range: the others may be outliers.
const OBSERVED_SHARE: f32 = 0.9;

/// The range within which the present image shows markings, metres.
pub(super) fn observed_range(points: &[LinePoint], config: &AdviceConfig) -> f32 {
    let mut ranges: Vec<f32> = points.iter().map(|point| point.at.distance()).collect();
    ranges.sort_by(f32::total_cmp);
    let index = (OBSERVED_SHARE * ranges.len() as f32) as usize;
    let range = ranges.get(index.min(ranges.len().saturating_sub(1)));
    range
        .copied()
        .unwrap_or(OBSERVED_RANGE_MIN)
        .clamp(OBSERVED_RANGE_MIN.min(config.view_range), config.view_range)
}

/// The sector and the angle under which a piece of marking is seen at a pose. None if out of range.
fn visible(sample: &MarkingSample, pose: Pose, range_max: f32) -> Option<(usize, f32)> {
    let (dx, dy) = (sample.at.x - pose.x, sample.at.y - pose.y);
    let squared = dx * dx + dy * dy;
    if !(RANGE_MIN * RANGE_MIN..=range_max * range_max).contains(&squared) {
        return None;
    }
    let distance = squared.sqrt();
    let angle = sample.visible_angle([dx / distance, dy / distance], distance);
    Some((sector_of(math::atan2(dy, dx) - pose.theta), angle))
}

fn sector_of(bearing: f32) -> usize {
    let share = (bearing / TAU).rem_euclid(1.0);
    ((share * SECTORS as f32) as usize).min(SECTORS - 1)
}
