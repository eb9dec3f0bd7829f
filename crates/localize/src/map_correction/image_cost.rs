//! How well could a pose explain an image, if the map were as wrong as it may be?
//!
//! The errors of a map are few unknowns that all points share. A wrong pose leaves residuals which no mount explains, although each point alone
//! may be that far off.

use super::image_fit::{ImagePrior, ImageState};
use super::mount_search::pose_information;
use super::state::MapCorrection;
use super::sums::PoseVector;
use crate::frames::Pose;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;

/// Reaches of the fit, as shares of a new map's displacements.
const REACHES: [f32; 6] = [1.0, 0.7, 0.4, 0.2, 0.0, 0.0];

/// Standard deviations of a pose that was matched with the map in use: metres, radians.
const POSE_STD: [f64; 3] = [0.3, 0.3, 0.05];

impl MapCorrection {
    /// Is a point less certain by the map than by itself? Root mean squares over the points of the present image.
    pub fn is_uncertain(&self) -> bool {
        let [own, map] = self.points.iter().fold([0.0; 2], |[own, map], point| {
            let [radial, tangential] = self.variances_at(point.range(), &self.variances);
            let own_variance = point.radial_variance + point.tangential_variance;
            [own + own_variance, map + radial + tangential]
        });
        map > own
    }

    /// Negative log likelihood of the present image, which [`MapCorrection::correct`] prepared, for the best pose and tilt near those given
    /// with the best map. `exponent`: of the points' likelihood.
    pub fn image_cost(
        &self,
        pose: Pose,
        tilt: [f32; 2],
        (tilt_std, exponent): (f32, f32),
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> f32 {
        let start = ImageState {
            coefficients: self.applied,
            pose,
            tilt,
        };
        let prior = ImagePrior {
            mean: ImageState {
                tilt: [0.0; 2],
                ..start
            },
            information: pose_information(POSE_STD, f64::from(tilt_std).max(1e-3).powi(-2)),
            covariance: self.covariance,
            share: f64::from(exponent),
            gain_max: f64::INFINITY,
        };
        let points = self.points.len() as f32;
        let kernel_squared = matching.kernel_scale_sigmas * matching.kernel_scale_sigmas;
        let unexplained = |score: f32| 0.5 * kernel_squared * exponent * (points - score);
        let Some(fit) = self.fit_image(start, &prior, &REACHES, distances, matching) else {
            return unexplained(0.0);
        };
        let step = fit.state.coefficients - self.applied;
        let terms = self.basis.terms().len();
        let known = self.covariance.view((0, 0), (terms, terms)).into_owned();
        let used = step.rows(0, terms).into_owned();
        let by_map = known
            .cholesky()
            .map_or(0.0, |it| used.dot(&it.solve(&used)));
        let offset = fit.state.pose.difference(pose);
        let deviation = PoseVector::from_fn(|i, _| match i {
            0..3 => f64::from(offset[i]),
            _ => f64::from(fit.state.tilt[i - 3]),
        });
        let by_pose = deviation.dot(&(prior.information * deviation));
        unexplained(fit.score) + 0.5 * (by_map + by_pose) as f32
    }
}
