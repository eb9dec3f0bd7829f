//! Recursive estimate of noise variances from innovations (docs/methods.md 8.8).
//!
//! A variance θ_j = exp(λ_j) enters the innovation covariance along one direction. Each innovation moves λ by one step
//! of Fisher scoring under the Gaussian posterior of λ so far, and sharpens that posterior by its Fisher information.
//! An innovation that other noise dominates therefore teaches nothing, however large the noise in question is.

use nalgebra::{SMatrix, SVector};

use crate::math;

/// Squared normalised innovation beyond which an innovation counts as an outlier and is clipped: 0.05 % of χ²₁.
const SQUARED_MAX: f32 = 12.0;
/// Largest change of a log variance by one innovation.
const STEP_MAX: f32 = 1.0;
/// Share of the prior variance that is common to the factors of a direction.
const COMMON_SHARE: f32 = 0.75;
/// Range of log factors: 1/20 to 8 times the configured standard deviation. Wheels that are noisier still say less than a
/// constant velocity, and nothing could teach that they have become better.
const LOG_FACTOR_RANGE: (f32, f32) = (-6.0, 4.2);

/// Gaussian estimate of the logarithms of `N` factors, each of a configured variance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LogVariance<const N: usize> {
    mean: SVector<f32, N>,
    covariance: SMatrix<f32, N, N>,
    /// Prior standard deviation of each log factor. Forgetting does not exceed it.
    prior_std: f32,
}

/// One component of a normalised innovation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NormalizedComponent {
    /// Square of (Σ⁻¹ν)_d, with Σ the innovation covariance.
    pub(crate) squared: f32,
    /// (Σ⁻¹)_dd, its expectation.
    pub(crate) information: f32,
}

impl<const N: usize> LogVariance<N> {
    /// Factors of 1, each within exp(± `prior_std`).
    pub(crate) fn new(prior_std: f32) -> Self {
        LogVariance {
            mean: SVector::zeros(),
            covariance: SMatrix::from_diagonal_element(prior_std * prior_std),
            prior_std,
        }
    }

    /// The same about another factor than 1, given by its logarithm.
    pub(crate) fn starting_at(self, log_factor: f32) -> Self {
        LogVariance {
            mean: SVector::from_element(log_factor),
            ..self
        }
    }

    /// Starts anew at a larger log factor. A smaller one changes nothing.
    pub(crate) fn raise_to(&mut self, log_factor: f32) {
        if self.mean.iter().all(|mean| *mean < log_factor) {
            *self =
                LogVariance::new(self.prior_std).starting_at(log_factor.min(LOG_FACTOR_RANGE.1));
        }
    }

    /// The same, where three quarters of the prior variance are common to all factors but the last: wheels are better or
    /// worse as a whole more often than in one term. The last one, of other noise, is within exp(± `other_std`).
    pub(crate) fn with_common_prior(prior_std: f32, other_std: f32) -> Self {
        let variance = prior_std * prior_std;
        let mut covariance: SMatrix<f32, N, N> = SMatrix::from_element(COMMON_SHARE * variance)
            + SMatrix::from_diagonal_element((1.0 - COMMON_SHARE) * variance);
        let other = N - 1;
        covariance.row_mut(other).fill(0.0);
        covariance.column_mut(other).fill(0.0);
        covariance[(other, other)] = other_std * other_std;
        LogVariance {
            covariance,
            ..LogVariance::new(prior_std)
        }
    }

    /// Factors of the variances, the medians of their distribution: the mean of a wide log-normal one is far above them.
    pub(crate) fn factors(&self) -> [f32; N] {
        std::array::from_fn(|j| math::exp(self.mean[j]))
    }

    /// Variances of the log factors.
    pub(crate) fn variance(&self, j: usize) -> f32 {
        self.covariance[(j, j)]
    }

    /// Random walk of the log factors with `drift` per square root of a second (carpet, load, floor).
    pub(crate) fn forget(&mut self, seconds: f32, drift: f32) {
        let limit = self.prior_std * self.prior_std;
        for j in 0..N {
            let variance = &mut self.covariance[(j, j)];
            *variance = (*variance + drift * drift * seconds).min(limit.max(*variance));
        }
    }

    /// Takes an innovation. `contributions`: what each variance, with its factor, adds to the innovation covariance.
    pub(crate) fn update(&mut self, contributions: [f32; N], component: NormalizedComponent) {
        let NormalizedComponent {
            squared,
            information,
        } = component;
        if !(information > 0.0 && squared.is_finite()) {
            return;
        }
        let contributions = SVector::from(contributions);
        let squared = squared.min(SQUARED_MAX * information);
        // Score ½ c (squared − information) and information ½ c cᵀ information²: a rank-one update.
        let cross = self.covariance * contributions;
        let weight = 0.5 * information * information;
        let gain = cross / (1.0 + weight * contributions.dot(&cross));
        self.covariance -= gain * cross.transpose() * weight;
        self.step(gain * (0.5 * (squared - information)));
    }

    /// Takes many innovations at once by the sum of their scores and of their information matrices.
    pub(crate) fn update_sums(&mut self, score: SVector<f32, N>, information: SMatrix<f32, N, N>)
    where
        SMatrix<f32, N, N>: Invertible,
    {
        let sum = self.covariance.inverted().map(|prior| prior + information);
        if let Some(covariance) = sum.and_then(|sum| sum.inverted()) {
            self.covariance = (covariance + covariance.transpose()) * 0.5;
            self.step(self.covariance * score);
        }
    }

    fn step(&mut self, step: SVector<f32, N>) {
        let size = step.amax();
        let share = if size > STEP_MAX {
            STEP_MAX / size
        } else {
            1.0
        };
        self.mean += step * share;
        for value in self.mean.iter_mut() {
            *value = value.clamp(LOG_FACTOR_RANGE.0, LOG_FACTOR_RANGE.1);
        }
    }

    /// The log factors.
    pub(crate) fn mean(&self) -> [f32; N] {
        self.mean.into()
    }
}

/// A small matrix with an inverse.
pub(crate) trait Invertible: Sized {
    /// None if it is singular.
    fn inverted(&self) -> Option<Self>;
}

impl Invertible for SMatrix<f32, 2, 2> {
    fn inverted(&self) -> Option<Self> {
        self.try_inverse()
    }
}

impl Invertible for SMatrix<f32, 4, 4> {
    fn inverted(&self) -> Option<Self> {
        self.try_inverse()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand::rngs::Xoshiro256PlusPlus;

    use super::*;
    use crate::random::standard_normal;

    /// Innovations with variance `true_factor` in the learned part and 1 in the rest.
    fn learn(true_factor: f32, rest: f32, count: usize) -> LogVariance<1> {
        let mut learned = LogVariance::<1>::new(1.2);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        for _ in 0..count {
            let innovation = (true_factor + rest).sqrt() * standard_normal(&mut rng);
            let [factor] = learned.factors();
            let information = 1.0 / (factor + rest);
            let component = NormalizedComponent {
                squared: (innovation * information).powi(2),
                information,
            };
            learned.update([factor], component);
        }
        learned
    }

    #[test]
    fn variances_sixteen_times_off_are_learned_in_a_hundred_innovations() {
        for true_factor in [1.0_f32 / 16.0, 1.0, 16.0] {
            let [factor] = learn(true_factor, 0.02, 100).factors();
            assert!(
                math::ln(factor / true_factor).abs() < 0.45,
                "{factor} instead of {true_factor}"
            );
        }
    }

    #[test]
    fn a_variance_that_other_noise_hides_stays_uncertain() {
        let learned = learn(0.01, 10.0, 300);
        assert!(learned.variance(0) > 0.3, "{learned:?}");
    }
}
