//! How far do line points really scatter? A factor of their stated variances and its growth with distance, learned from
//! the residuals of tracked images (docs/methods.md 5.8).
//!
//! A residual belongs to an inlier, normally distributed, or to an outlier, uniform near the markings. Each counts with
//! its probability of being an inlier, so that outliers close to a line do not widen the spread.

use nalgebra::{Matrix2, Vector2};

use crate::filter::log_variance::LogVariance;
use crate::math;

/// Range at which the learned factor is that of the mean, and range over which its logarithm grows by the slope, metres.
const RANGE_SCALE: f32 = 2.5;
/// Information of a point, as a share of that of an independent one: errors of neighbouring points are alike.
const INDEPENDENT_SHARE: f32 = 0.25;
/// Distance from a marking within which outliers are counted, metres.
const OUTLIER_WINDOW: f32 = 0.5;
/// Share by which an image changes the share of outliers and the mean scale.
const SMOOTHING: f32 = 0.05;
/// Random walk of the log variances per square root of a second (light, carpet, focus).
const DRIFT: f32 = 0.2;
/// Weight of the stated variances against one image's residuals, in points: at first, and once they are learned.
const STATED_WEIGHT_RANGE: (f32, f32) = (10.0, 200.0);

/// Learned spread of line points.
#[derive(Debug, Clone)]
pub(super) struct PointSpread {
    /// Log factor of the variance at `RANGE_SCALE`, and its slope. None keeps the stated variances.
    learned: Option<LogVariance<2>>,
    /// Share of outliers among the points near markings.
    outlier_share: f32,
    /// Mean of the residuals' scale, which depends on the kernel and on the outliers.
    scale_mean: f32,
}

/// Factor of the points' variances by their range.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpreadFactor {
    /// Logarithm at `RANGE_SCALE`.
    level: f32,
    /// Growth of the logarithm over `RANGE_SCALE`.
    slope: f32,
}

impl SpreadFactor {
    /// At a distance from the robot, metres.
    pub(crate) fn at(self, range: f32) -> f32 {
        math::exp(self.level + self.slope * PointSpread::abscissa(range))
    }
}

/// Distance of a point from its marking after matching.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    /// Metres.
    pub(super) distance: f32,
    /// Of the distance, m².
    pub(super) variance: f32,
    /// Distance from the robot, metres.
    pub(super) range: f32,
}

impl PointSpread {
    /// `std`: prior standard deviation of the log variances. 0 keeps the stated variances.
    pub(super) fn new(std: f32) -> Self {
        PointSpread {
            learned: (std > 0.0).then(|| LogVariance::new(std)),
            outlier_share: 0.1,
            scale_mean: 1.0,
        }
    }

    /// Position of a range on the learned line.
    fn abscissa(range: f32) -> f32 {
        (range.min(3.0 * RANGE_SCALE) - RANGE_SCALE) / RANGE_SCALE
    }

    /// The learned factor; 1 if nothing is learned.
    pub(super) fn factor(&self) -> SpreadFactor {
        self.learned.map_or_else(SpreadFactor::default, |learned| {
            let [level, slope] = learned.mean();
            SpreadFactor { level, slope }
        })
    }

    /// Expected scale of an image's residuals, and its weight in points.
    pub(super) fn expected_scale(&self) -> [f32; 2] {
        let (least, most) = STATED_WEIGHT_RANGE;
        // The variance of a log variance from n points is 2/n.
        let points = self
            .learned
            .map_or(least, |learned| 2.0 / learned.variance(0));
        [self.scale_mean, points.clamp(least, most)]
    }

    /// Takes the residuals of an image. `parameters`: how many the points determined; `scale`: that of the residuals.
    pub(super) fn update(
        &mut self,
        residuals: impl Iterator<Item = Residual>,
        parameters: f32,
        scale: f32,
        seconds: f32,
    ) {
        let Some(learned) = &mut self.learned else {
            return;
        };
        learned.forget(seconds, DRIFT);
        let odds = self.outlier_share / (1.0 - self.outlier_share);
        let (mut inliers, mut near) = (0.0, 0.0);
        let mut moments = [0.0_f32; 3];
        let mut squares = Vector2::zeros();
        for Residual {
            distance,
            variance,
            range,
        } in residuals
        {
            if distance.abs() > OUTLIER_WINDOW {
                continue;
            }
            let squared = distance * distance / variance;
            let density = (std::f32::consts::TAU * variance).sqrt() / (2.0 * OUTLIER_WINDOW);
            let probability = 1.0 / (1.0 + odds * density * math::exp(0.5 * squared.min(80.0)));
            let x = Self::abscissa(range);
            near += 1.0;
            inliers += probability;
            moments[0] += probability;
            moments[1] += probability * x;
            moments[2] += probability * x * x;
            squares += Vector2::new(1.0, x) * (probability * squared);
        }
        if inliers < 2.0 * parameters.max(3.0) {
            return;
        }
        // Residuals after a fit are smaller than errors.
        let expected = 1.0 - parameters / inliers;
        let share = 0.5 * INDEPENDENT_SHARE;
        let score = (squares / expected - Vector2::new(moments[0], moments[1])) * share;
        let information = Matrix2::new(moments[0], moments[1], moments[1], moments[2]) * share;
        learned.update_sums(score, information);
        let outliers = (1.0 - inliers / near).clamp(0.005, 0.9);
        self.outlier_share += SMOOTHING * (outliers - self.outlier_share);
        self.scale_mean += SMOOTHING * (scale.clamp(0.3, 3.0) - self.scale_mean);
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::Xoshiro256PlusPlus;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::random::standard_normal;

    #[test]
    fn spread_and_its_growth_are_learned_beside_outliers() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut spread = PointSpread::new(1.2);
        let stated = 0.04_f32;
        // Half as wide as stated near the robot, twice as wide at 5 m.
        let true_std = |range: f32| stated * (0.5 + 1.5 * range / 5.0);
        for _ in 0..60 {
            let residuals: Vec<Residual> = (0..100)
                .map(|k| {
                    let range = 0.5 + 4.5 * rng.random::<f32>();
                    let distance = if k % 5 == 0 {
                        0.5 * (2.0 * rng.random::<f32>() - 1.0)
                    } else {
                        true_std(range) * standard_normal(&mut rng)
                    };
                    Residual {
                        distance,
                        variance: stated * stated * spread.factor().at(range),
                        range,
                    }
                })
                .collect();
            spread.update(residuals.into_iter(), 0.0, 1.0, 1.0 / 30.0);
        }
        for range in [1.0, 2.5, 4.5] {
            let learned = stated * spread.factor().at(range).sqrt();
            let ratio = learned / true_std(range);
            assert!((0.8..1.25).contains(&ratio), "{range} m: {ratio}");
        }
    }
}
