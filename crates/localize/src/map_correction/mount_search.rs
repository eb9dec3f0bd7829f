//! Is the mirror mounted far from where the map has it? Fits pose, tilt and map to an image from many mounts.
//!
//! A mirror some millimetres off its axis moves far points to other markings, where neither matching nor learning finds back.
//! Only starts near the true mount lead to it.

use super::image_fit::{ImageFit, ImagePrior, ImageState};
use super::learning::{FREE_TILT_INFORMATION, INDEPENDENT_POINTS};
use super::refit::STATE_TILT_INFORMATION;
use super::state::{INITIAL_NOISE, MapCorrection, TrackedImage};
use super::sums::{PoseMatrix, TermMatrix, TermVector};
use super::term::TermKind;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;
use crate::math;

/// Standard deviation of a far mount, in those of a new map.
const FAR_SIGMAS: f64 = 5.0;

/// Offsets of the mirror from which the fit starts: distance in standard deviations of a new map, and number of directions. No offset
/// up to 7 is farther than 2.2 from one of them.
const STARTS: [(f64, usize); 3] = [(0.0, 1), (3.0, 6), (6.0, 10)];

/// Mounts of one image that are tried, and the difference of their offsets from which they count as two, in standard deviations of a
/// new map. One image often allows several: offset, tilt and focal length together do nearly the same to it.
const MOUNTS_MAX: usize = 4;
const SAME_SIGMAS: f64 = 0.5;

/// Reaches of a fit from a start that is right to 2 mm, as shares of a new map's displacements.
const REACHES: [f32; 8] = [2.0, 1.5, 1.0, 0.7, 0.4, 0.2, 0.0, 0.0];

/// Standard deviations of the pose that a wrong mount leaves: metres, radians.
const POSE_STD: [f64; 3] = [1.0, 1.0, 0.1];

impl MapCorrection {
    /// Mounts that explain `margin` points of the image more than the map in use does at any pose and tilt, best first, with the number of
    /// points more.
    pub(super) fn search_mounts(
        &self,
        image: &TrackedImage,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Vec<(ImageFit, f32)> {
        let place = |kind| self.basis.terms().iter().position(|term| term.kind == kind);
        let (Some(x), Some(y)) = (
            place(TermKind::MirrorOffsetX),
            place(TermKind::MirrorOffsetY),
        ) else {
            return Vec::new();
        };
        let axes = [x, y];
        let here = self.image_state(image);
        let bound = self.best_in_use(&[here], image, distances, matching) + margin;
        if bound >= self.points.len() as f32 {
            return Vec::new();
        }
        let given = ImageState {
            coefficients: TermVector::zeros(),
            pose: image.predicted,
            tilt: image.expected_tilt,
        };
        let prior = ImagePrior {
            mean: given,
            information: pose_information(POSE_STD, STATE_TILT_INFORMATION),
            covariance: self.far_prior(axes),
            share: 1.0,
            gain_max: f64::INFINITY,
        };
        let starts = STARTS.iter().flat_map(|(sigmas, count)| {
            (0..*count).map(move |k| {
                let angle = std::f64::consts::TAU * k as f64 / *count as f64;
                [sigmas * math::cos(angle), sigmas * math::sin(angle)]
            })
        });
        let mut found: Vec<ImageFit> = starts
            .filter_map(|sigmas| {
                let mut start = given;
                for (axis, sigmas) in axes.into_iter().zip(sigmas) {
                    start.coefficients[axis] = sigmas * self.prior[(axis, axis)].sqrt();
                }
                self.fit_image(start, &prior, &REACHES, distances, matching)
            })
            .filter(|fit| fit.score > bound)
            .collect();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut distinct: Vec<(ImageFit, f32)> = Vec::new();
        for fit in found {
            let is_known = distinct.iter().any(|(known, _)| {
                let difference = fit.state.coefficients - known.state.coefficients;
                axes.iter().all(|axis| {
                    difference[*axis].abs() < SAME_SIGMAS * self.prior[(*axis, *axis)].sqrt()
                })
            });
            if !is_known && distinct.len() < MOUNTS_MAX {
                distinct.push((fit, fit.score + margin - bound));
            }
        }
        distinct
    }

    /// Covariance of the unknowns of a mirror that may be far off its axis.
    fn far_prior(&self, axes: [usize; 2]) -> TermMatrix {
        let mut far = self.prior;
        for axis in axes {
            far[(axis, axis)] = self.prior[(axis, axis)] * FAR_SIGMAS * FAR_SIGMAS;
        }
        far
    }

    /// Share of an image's information on a mount on trial. What residuals taught under the map in use does not hold for it.
    pub(super) fn trial_share(&self) -> f64 {
        let independent = INDEPENDENT_POINTS / self.points.len().max(1) as f32;
        f64::from(self.config.information_share * independent.min(1.0)) / INITIAL_NOISE
    }

    /// The present state of an image.
    pub(super) fn image_state(&self, image: &TrackedImage) -> ImageState {
        ImageState {
            coefficients: self.applied,
            pose: image.matched.pose,
            tilt: [0, 1].map(|k| image.expected_tilt[k] + image.matched.tilt[k]),
        }
    }

    /// The largest Σ (1 − e) of an image under the map in use, pose and tilt free, from poses and tilts of some states.
    pub(super) fn best_in_use(
        &self,
        starts: &[ImageState],
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> f32 {
        let predicted = ImageState {
            coefficients: self.applied,
            pose: image.predicted,
            tilt: image.expected_tilt,
        };
        let prior = ImagePrior {
            mean: predicted,
            information: pose_information(POSE_STD, FREE_TILT_INFORMATION),
            covariance: TermMatrix::zeros(),
            share: 0.0,
            gain_max: f64::INFINITY,
        };
        let present = self.present_score(image, distances, matching);
        let fitted = starts.iter().chain([&predicted]).filter_map(|start| {
            let start = ImageState {
                coefficients: self.applied,
                ..*start
            };
            self.fit_image(start, &prior, &REACHES, distances, matching)
        });
        fitted.map(|fit| fit.score).fold(present, f32::max)
    }
}

/// Information of a pose with these standard deviations, and of a tilt.
pub(super) fn pose_information(pose_std: [f64; 3], tilt: f64) -> PoseMatrix {
    PoseMatrix::from_fn(|i, j| match i {
        _ if i != j => 0.0,
        0..3 => pose_std[i].powi(-2),
        _ => tilt,
    })
}
