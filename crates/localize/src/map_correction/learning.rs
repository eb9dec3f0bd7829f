//! Learning: each tracked image moves the map's unknowns by what pose and tilt cannot explain.

use super::block::{BLOCK_IMAGES, Block};
use super::config::MapCorrectionConfig;
use super::posterior::Posterior;
use super::state::{MapCorrection, TrackedImage};
use super::sums::{MapEvidence, PoseMatrix, PoseVector, TermMatrix, TermVector};
use super::term::TERMS_MAX;
use crate::frames::{Pose, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::matching::{MatchConfig, PARAMETERS};
use crate::math;
use crate::stamp::Stamp;

/// Information of pose and tilt that is assumed where an image alone decides: 10 m, π and 10°.
const FREE_POSE_INFORMATION: [f64; 3] = [1e-2, 1e-2, 1e-1];
pub(super) const FREE_TILT_INFORMATION: f64 = 32.0;

/// Points that carry the information of an image; more are too close together to be independent.
pub(super) const INDEPENDENT_POINTS: f32 = 120.0;

/// Distance from the map as given beyond which an estimate is discarded, in standard deviations of a new map.
const PLAUSIBLE_SIGMAS: f64 = 8.0;

/// Largest mean information of an image, relative to what is known already. The first images, whose derivatives hold roughly, so
/// count less than those after them.
const RELATIVE_INFORMATION_MAX: f64 = 0.1;

/// Squared distance of the estimate from the given map, in its own standard deviations, from which the map counts as wrong (99.9 %
/// of χ² with nine degrees of freedom). Until then the given map is in use. From then on the estimate is.
const WRONG_CHI_SQUARED: f64 = 28.0;

/// Share by which an image changes the learned variance of the residuals.
const NOISE_RATE: f64 = 0.1;

impl MapCorrection {
    /// Learns from a tracked image. Returns the change of (x, y, θ, a, b) that follows for its pose.
    pub fn observe(
        &mut self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<[f32; PARAMETERS]> {
        if image.points.len() != self.points.len() {
            return None;
        }
        self.drift_to(image.stamp);
        let moved = self.is_independent(image.matched.pose);
        let (stated, widened) = self.accumulate(image, distances, matching, moved);
        self.update_sensitivity(image, &widened);
        self.last_pose = Some(image.matched.pose);
        if !moved || image.prior_information.is_none() {
            return None;
        }
        let mut prior = PoseMatrix::zeros();
        for (k, information) in FREE_POSE_INFORMATION.into_iter().enumerate() {
            prior[(k, k)] = information;
        }
        for k in 3..PARAMETERS {
            prior[(k, k)] = FREE_TILT_INFORMATION;
        }
        let evidence = stated.eliminate_pose(&prior, &PoseVector::zeros())?;
        let share = self.information_share(image, self.used_pose);
        // Such an image is used again.
        let relative = share / self.noise * (self.covariance * evidence.information).trace();
        let cap = RELATIVE_INFORMATION_MAX * self.basis.terms().len() as f64 / relative.max(1e-9);
        self.used_pose = (cap >= 1.0).then_some(image.matched.pose);
        self.update(&evidence, share * cap.min(1.0), f64::from(stated.weight))?;
        let step = self.follow_estimate()?;
        let shift = self.sensitivity * step;
        let mut pose = image.matched.pose;
        pose = Pose::new(
            pose.x + shift[0] as f32,
            pose.y + shift[1] as f32,
            pose.theta + shift[2] as f32,
        );
        self.last_pose = Some(pose);
        Some(std::array::from_fn(|k| shift[k] as f32))
    }

    /// Share of an image's information that counts after one at the pose `used`.
    pub(super) fn information_share(&self, image: &TrackedImage, used: Option<Pose>) -> f64 {
        let repetition = match used {
            Some(used) => image.repetition.sequence_factor(used, image.matched.pose),
            None => image.repetition.image_factor(),
        };
        f64::from(
            self.config.information_share
                * (INDEPENDENT_POINTS / image.points.len().max(1) as f32).min(1.0)
                / repetition,
        )
    }

    /// Takes the estimate into use if the given map is wrong. Returns the change.
    fn follow_estimate(&mut self) -> Option<TermVector> {
        let by_images = self.coefficients - self.applied;
        let terms = self.basis.terms().len();
        if !self.is_in_use()
            && is_expected(&by_images, &self.covariance, terms)
            && !self.origin_by_wheels.is_contradicted()
        {
            return None;
        }
        let step = self.best_step();
        self.applied += step;
        self.origin_by_wheels.shift(&step);
        self.update_variances();
        Some(step)
    }

    /// Random walk of the unknowns since the last image.
    pub(super) fn drift_to(&mut self, stamp: Stamp) {
        let seconds = self
            .stamp
            .replace(stamp)
            .map_or(0.0, |last| last.seconds_until(stamp).clamp(0.0, 1.0));
        let share = seconds / f64::from(self.config.drift_time);
        self.covariance += self.prior * share;
        self.block.covariance += self.prior * share;
        for k in 0..TERMS_MAX {
            // Never less certain than a new map. Row and column shrink together: a smaller variance beside the same
            // covariances is that of no distribution.
            let share = self.prior[(k, k)] / self.covariance[(k, k)];
            if share < 1.0 {
                self.covariance.row_mut(k).scale_mut(share.sqrt());
                self.covariance.column_mut(k).scale_mut(share.sqrt());
            }
        }
    }

    /// Did the robot move far enough that the points' errors differ from those of the last image used?
    fn is_independent(&self, pose: Pose) -> bool {
        self.used_pose
            .is_none_or(|used| is_moved(used, pose, &self.config))
    }

    /// Updates the belief by an image.
    fn update(&mut self, evidence: &MapEvidence, share: f64, weight: f64) -> Option<()> {
        let share = share / self.noise;
        let information = evidence.information * share;
        // The image was linearised at the map in use.
        let gradient = evidence.gradient * share + information * (self.coefficients - self.applied);
        let posterior = Posterior::new(&self.covariance, &information, &gradient)?;
        self.block.add(&information, &gradient, &self.coefficients);
        self.covariance = posterior.covariance;
        self.coefficients += posterior.step;
        let freedom = weight - (PARAMETERS + self.basis.terms().len()) as f64;
        if freedom > 10.0 {
            let from_used = self.coefficients - self.applied;
            let squares = evidence.squares
                + 2.0 * evidence.gradient.dot(&from_used)
                + from_used.dot(&(evidence.information * from_used));
            self.seen.add(&evidence.information, squares, freedom);
            let remaining = (squares / freedom).clamp(0.25, 25.0);
            self.noise += NOISE_RATE * (remaining - self.noise);
        }
        if self.is_implausible() {
            // Something else than the mount misled it: back to the map as it was given.
            self.coefficients = TermVector::zeros();
            self.plausible_centre = TermVector::zeros();
            self.forget();
            return Some(());
        }
        if self.block.images >= BLOCK_IMAGES {
            let log_odds_min = f64::from(self.config.knock_log_odds);
            if self.block.is_knocked(&self.prior, log_odds_min) {
                self.knocks += 1;
                self.covariance = self.prior;
            }
            self.block = Block::new(self.coefficients, self.covariance);
        }
        self.images += 1;
        self.update_variances();
        Some(())
    }

    /// Is an unknown farther from the map as given, or from the mount taken over last, than any mount may be?
    fn is_implausible(&self) -> bool {
        (0..TERMS_MAX).any(|k| {
            let limit = PLAUSIBLE_SIGMAS * self.prior[(k, k)].sqrt();
            (self.coefficients[k] - self.plausible_centre[k]).abs() > limit
        })
    }
}

/// Is a deviation of the map one that its covariance explains?
pub(super) fn is_expected(deviation: &TermVector, covariance: &TermMatrix, terms: usize) -> bool {
    let mut covariance = *covariance;
    for k in terms..TERMS_MAX {
        covariance[(k, k)] = 1.0;
    }
    let cholesky = covariance.cholesky();
    cholesky.is_none_or(|cholesky| deviation.dot(&cholesky.solve(deviation)) < WRONG_CHI_SQUARED)
}

/// Did the robot move far enough between two images that they count as independent?
pub(super) fn is_moved(from: Pose, to: Pose, config: &MapCorrectionConfig) -> bool {
    let turn = wrap_angle(to.theta - from.theta).abs();
    math::hypot(to.x - from.x, to.y - from.y) >= config.step_distance
        || turn >= config.step_turn_deg.to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map_correction::{MapBasis, smooth_terms};

    #[test]
    fn belief_that_is_wider_than_that_of_a_new_map_stays_one_while_it_narrows() {
        let config = MapCorrectionConfig::default();
        let basis = MapBasis::new(smooth_terms(config.smooth_std), 0.7);
        let terms = basis.terms().len();
        let mut map = MapCorrection::new(basis, config);
        // A mount on trial was taken over: two unknowns that explain the same images.
        let wide = 25.0 * map.prior[(0, 0)];
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            map.covariance[(i, j)] = if i == j { wide } else { 0.99 * wide };
        }
        map.drift_to(Stamp::from_seconds(1.0));
        let variances = (0..terms).map(|k| map.covariance[(k, k)] / map.prior[(k, k)]);
        assert!(variances.clone().all(|share| share < 1.001));
        let used = map.covariance.view((0, 0), (terms, terms)).into_owned();
        assert!(used.cholesky().is_some(), "{}", map.covariance);
    }
}
