//! Error of the tracked pose by errors of the points that successive images repeat (docs/methods.md 5.9).
//!
//! Filtering does not average them away. An image changes the pose by its gain, so its errors enter by that gain, together
//! with those of the images before: where it determines nothing, such as along a single line, it adds none.

use nalgebra::Matrix3;

use crate::frames::Pose;
use crate::matching::{PosePrior, Repetition};

/// Covariance of that error over the images so far.
#[derive(Debug, Clone, Default)]
pub(super) struct RepeatedPoseError {
    /// Of (x, y, θ).
    covariance: Matrix3<f32>,
    /// Between it and the error of the last image's pose by its points alone.
    with_image: Matrix3<f32>,
    /// Of the last image.
    pose: Option<Pose>,
}

impl RepeatedPoseError {
    pub(super) fn covariance(&self) -> Matrix3<f32> {
        self.covariance
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
        let predicted = prior.information.try_inverse();
        let predicted = predicted.map(|full| full.fixed_view::<3, 3>(0, 0).into_owned());
        let Some(information) = predicted.and_then(|predicted| predicted.try_inverse()) else {
            return;
        };
        let kept = covariance * information;
        let gain = Matrix3::identity() - kept;
        // With the points' information N, gain = C N, and what repeats of the error by the points alone is f N⁻¹.
        let own = gain * covariance * repeated_factor;
        let carried = kept * self.with_image * gain.transpose();
        let sum = kept * self.covariance * kept.transpose() + own + carried + carried.transpose();
        // Images that determine other directions than those before may leave less than nothing of it.
        let mut parts = ((sum + sum.transpose()) * 0.5).symmetric_eigen();
        parts
            .eigenvalues
            .apply(|variance| *variance = variance.max(0.0));
        self.covariance = parts.recompose();
        self.with_image = kept * self.with_image + covariance * repeated_factor;
    }

    /// Carries the error from one pose to the next: a heading's error displaces, and images err less alike.
    fn carry(&mut self, from: Pose, to: Pose) {
        let mut motion = Matrix3::identity();
        motion[(0, 2)] = from.y - to.y;
        motion[(1, 2)] = to.x - from.x;
        self.covariance = motion * self.covariance * motion.transpose();
        self.with_image = motion * self.with_image * Repetition::correlation(from, to);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The wheels' standard deviation per image, metres and radians.
    const WHEELS: f32 = 0.02;
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
        // Half of the variance of the pose by the points alone, (1/0.01² − 1/0.02²)⁻¹.
        let expected = SHARE / 7500.0;
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
