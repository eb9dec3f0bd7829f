//! Error of the tracked pose by errors of the points that successive images repeat (docs/methods.md 5.9).
//!
//! Filtering does not average them away. An image changes the pose by its gain, so its errors enter by that gain, together
//! with those of the images before: where it determines nothing, such as along a single line, it adds none.

use nalgebra::Matrix3;

use crate::frames::Pose;
use crate::matching::{PosePrior, Repetition, RigidDifference, positive_inverse};

/// An image determines a direction of which it removes a larger share of the variance.
const DETERMINED_MIN: f64 = 1e-3;

/// Covariance of that error over the images so far.
#[derive(Debug, Clone, Default)]
pub(super) struct RepeatedPoseError {
    /// Of (x, y, θ).
    covariance: Matrix3<f64>,
    /// Between it and the error of the last image's pose by its points alone, where they determine it.
    with_image: Matrix3<f64>,
    /// Of the last image.
    pose: Option<Pose>,
}

impl RepeatedPoseError {
    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.covariance.map(|value| value as f32)
    }

    /// Takes an image that was matched under a prior: pose and covariance after it, and the share of the points' variance that
    /// repeats.
    pub(super) fn update(
        &mut self,
        pose: Pose,
        covariance: &Matrix3<f32>,
        repeated_factor: f32,
        prior: &PosePrior,
    ) {
        if let Some(last) = self.pose.replace(pose) {
            self.carry(last, prior.pose);
        }
        // Of the pose alone: a tilt that is estimated with it is a part of what is unknown.
        let predicted = positive_inverse(&prior.information.map(f64::from));
        let predicted = predicted.map(|full| full.fixed_view::<3, 3>(0, 0).into_owned());
        let root = predicted
            .and_then(|predicted| predicted.cholesky())
            .map(|cholesky| cholesky.l());
        let Some((root, whitening)) = root.and_then(|root| Some((root, root.try_inverse()?)))
        else {
            return;
        };
        let whiten = |matrix: &Matrix3<f64>| whitening * matrix * whitening.transpose();
        // With the prediction's covariance as the unit, an image keeps a share k from 0 to 1 of it along three axes. Rounding leaves
        // more or less than that of a long covariance.
        let difference = RigidDifference::between(prior.pose, pose);
        let kept = whiten(&difference.pose_covariance(covariance).map(f64::from));
        let unit = Matrix3::identity();
        let kept = unit - positive_part(unit - positive_part(kept));
        let gain = unit - kept;
        let (error, with_image) = (whiten(&self.covariance), whiten(&self.with_image));
        let repeated = f64::from(repeated_factor);
        // With the points' information N and covariance C afterwards, gain = C N, and what repeats of the error by the points alone is
        // f N⁻¹, so C f lies between it and the pose: nowhere where they determine nothing.
        let own = gain * kept * repeated;
        let carried = kept * with_image * gain;
        let sum = kept * error * kept + own + carried + carried.transpose();
        // Images that determine other directions than those before may leave less than nothing of it.
        let sum = positive_part(sum);
        // Along each axis k g / (g + least k), k the share that is kept and g the gain.
        let determined = positive_inverse(&(gain + kept * DETERMINED_MIN))
            .map_or_else(Matrix3::zeros, |inverse| kept * gain * inverse);
        let with_image = kept * with_image + determined * repeated;
        self.covariance = root * sum * root.transpose();
        self.with_image = root * with_image * root.transpose();
    }

    /// Carries the error from one pose to the next: a heading's error displaces, and images err less alike.
    fn carry(&mut self, from: Pose, to: Pose) {
        let mut motion = Matrix3::identity();
        motion[(0, 2)] = f64::from(from.y - to.y);
        motion[(1, 2)] = f64::from(to.x - from.x);
        self.covariance = motion * self.covariance * motion.transpose();
        self.with_image = motion * self.with_image * f64::from(Repetition::correlation(from, to));
    }
}

/// Without the negative eigenvalues of a symmetric matrix, which rounding leaves.
fn positive_part(matrix: Matrix3<f64>) -> Matrix3<f64> {
    let matrix = (matrix + matrix.transpose()) * 0.5;
    if positive_inverse(&matrix).is_some() {
        return matrix;
    }
    let mut parts = matrix.symmetric_eigen();
    parts.eigenvalues.apply(|value| *value = value.max(0.0));
    parts.recompose()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The wheels' standard deviation per image, metres and radians; a power of two, so that information and covariance are exact inverses.
    const WHEELS: f32 = 0.015625;
    const SHARE: f32 = 0.5;

    fn prior(pose: Pose) -> PosePrior {
        PosePrior {
            pose,
            information: crate::matching::Matrix5::from_diagonal_element(WHEELS.powi(-2)),
        }
    }

    /// Covariance after an image that determines an axis or does not.
    fn covariance(determines: [bool; 3]) -> Matrix3<f32> {
        let variance = |known| if known { 1e-4 } else { WHEELS * WHEELS };
        Matrix3::from_diagonal(&determines.map(variance).into())
    }

    #[test]
    fn standing_robot_has_the_whole_error_where_images_determine_and_none_elsewhere() {
        let mut error = RepeatedPoseError::default();
        let at = Pose::new(0.0, 0.0, 0.0);
        for _ in 0..200 {
            error.update(at, &covariance([true, false, true]), SHARE, &prior(at));
        }
        // Half of the variance of the pose by the points alone, (1/0.01² − 1/WHEELS²)⁻¹.
        let expected = SHARE / 5904.0;
        let found = error.covariance();
        assert!((found[(0, 0)] / expected - 1.0).abs() < 0.01, "{found}");
        assert!(found[(1, 1)] < 1e-9, "{found}");
    }

    #[test]
    fn error_of_before_remains_where_images_no_longer_determine() {
        let mut error = RepeatedPoseError::default();
        let from = Pose::new(0.0, 0.0, 0.0);
        for _ in 0..200 {
            error.update(from, &covariance([true; 3]), SHARE, &prior(from));
        }
        let before = error.covariance();
        let to = Pose::new(2.0, 0.0, 0.0);
        error.update(to, &covariance([true, false, false]), SHARE, &prior(to));
        let after = error.covariance();
        // Two metres on, the error of the heading displaces by twice as much.
        let expected = before[(1, 1)] + 4.0 * before[(2, 2)];
        assert!(
            (after[(1, 1)] / expected - 1.0).abs() < 0.01,
            "{before} {after}"
        );
    }
}
