//! Where on the field do two hypotheses predict different markings?

use super::weights::PointWeights;
use crate::field::Marking;
use crate::frames::{At, FieldFrame, Tf};
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::sample::LinePoint;

/// Length of a piece of marking, metres.
const SPACING: f32 = 0.2;
/// Error of a pose that the next match absorbs, metres.
const ABSORBED: f32 = 0.1;

/// A short piece of a marking.
#[derive(Debug, Clone, Copy)]
pub(super) struct MarkingSample {
    pub(super) at: At<FieldFrame>,
    /// Unit vector along it; zero for a spot, which looks the same from everywhere.
    tangent: [f32; 2],
    /// Metres.
    length: f32,
}

/// A piece of marking that another hypothesis does not predict.
#[derive(Debug, Clone, Copy)]
pub(super) struct DisagreeingSample {
    pub(super) sample: MarkingSample,
    /// Negative log likelihood of a point on it under the other hypothesis.
    pub(super) cost: f32,
}

impl MarkingSample {
    /// Angle under which it is seen from `distance` metres away in `direction` (unit vector), radians.
    pub(super) fn visible_angle(&self, direction: [f32; 2], distance: f32) -> f32 {
        let [tx, ty] = self.tangent;
        let across = if tx == 0.0 && ty == 0.0 {
            1.0
        } else {
            (tx * direction[1] - ty * direction[0]).abs()
        };
        self.length * across / distance
    }
}

/// Cuts all markings into short pieces.
pub(super) fn sample_markings(markings: &[Marking]) -> Vec<MarkingSample> {
    let mut samples = Vec::new();
    for marking in markings {
        match *marking {
            Marking::Line { from, to } => {
                let (dx, dy) = (to.x - from.x, to.y - from.y);
                let length = math::hypot(dx, dy);
                let count = pieces(length);
                samples.extend((0..count).map(|k| {
                    let share = (k as f32 + 0.5) / count as f32;
                    MarkingSample {
                        at: At::new(from.x + share * dx, from.y + share * dy),
                        tangent: [dx / length.max(1e-6), dy / length.max(1e-6)],
                        length: length / count as f32,
                    }
                }));
            }
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let count = pieces(radius * sweep);
                samples.extend((0..count).map(|k| {
                    let (sin, cos) = math::sin_cos(start + sweep * (k as f32 + 0.5) / count as f32);
                    MarkingSample {
                        at: At::new(centre.x + radius * cos, centre.y + radius * sin),
                        tangent: [-sin, cos],
                        length: radius * sweep / count as f32,
                    }
                }));
            }
            Marking::Spot { centre, radius } => samples.push(MarkingSample {
                at: centre,
                tangent: [0.0, 0.0],
                length: 2.0 * radius,
            }),
        }
    }
    samples
}

fn pieces(length: f32) -> usize {
    ((length / SPACING).ceil() as usize).max(1)
}

/// Cost of a point off the markings, as matching counts it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    /// Largest cost, of a point far from every marking.
    cost_max: f32,
    /// Square of the kernel scale c, m².
    squared_scale: f32,
}

impl Residual {
    /// For points as accurate as those of the present image.
    pub(super) fn new(points: &[LinePoint], weights: &PointWeights) -> Self {
        let variance = |point: &LinePoint| point.std_tangential * point.std_tangential;
        let mean = points.iter().map(variance).sum::<f32>() / points.len().max(1) as f32;
        let squared_sigmas = weights.kernel_scale_sigmas * weights.kernel_scale_sigmas;
        Residual {
            cost_max: 0.5 * squared_sigmas,
            squared_scale: squared_sigmas * (mean + weights.map_std * weights.map_std),
        }
    }

    /// Cost at a distance from the nearest marking, metres.
    fn cost(&self, distance: f32) -> f32 {
        let off = (distance - ABSORBED).max(0.0);
        let squared = off * off;
        self.cost_max * squared / (self.squared_scale + squared)
    }
}

/// Smallest cost of a piece that is kept.
const COST_MIN: f32 = 0.02;

/// The pieces of markings not `checked` that the other hypothesis, which sees them moved by `other_from_truth`, does not
/// predict.
pub(super) fn disagreeing_samples(
    samples: &[MarkingSample],
    checked: &[bool],
    distances: &DistanceField,
    other_from_truth: Tf<FieldFrame, FieldFrame>,
    residual: &Residual,
) -> Vec<DisagreeingSample> {
    let (sin, cos) = math::sin_cos(other_from_truth.theta);
    let moved = |at: At<FieldFrame>| {
        (
            other_from_truth.x + cos * at.x - sin * at.y,
            other_from_truth.y + sin * at.x + cos * at.y,
        )
    };
    let unknown = samples
        .iter()
        .enumerate()
        .filter(|(k, _)| !checked.get(*k).is_some_and(|&seen| seen));
    let disagreeing = unknown.map(|(_, &sample)| {
        let (x, y) = moved(sample.at);
        let cost = residual.cost(distances.nearest(x, y).signed_distance.abs());
        DisagreeingSample { sample, cost }
    });
    disagreeing
        .filter(|sample| sample.cost >= COST_MIN)
        .collect()
}
