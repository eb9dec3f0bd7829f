//! Did something hit the camera? Fits pose, tilt and map to one image as if the map were new, and compares.
//!
//! After a large knock most points lie beyond the reach of matching, and the usual update sees little of it. The fit
//! begins with the reach of a new map's uncertainty and shrinks it, as matching does with its start error.

use super::state::{MapCorrection, TrackedImage};
use super::sums::{ImageSums, PoseMatrix, PoseVector, TermMatrix, TermVector, widen};
use super::term::TERMS_MAX;
use crate::frames::Pose;
use crate::matching::distance_field::DistanceField;
use crate::matching::{MatchConfig, PARAMETERS};
use crate::math;
use crate::tilt::ground_from_map;

/// Shares of a new map's standard deviation by which the reach is widened, step by step.
const REACH: [f32; 6] = [1.0, 0.7, 0.4, 0.2, 0.1, 0.0];

/// Information of a tilt that the filter's state knows, rad⁻²: 1°.
pub(super) const STATE_TILT_INFORMATION: f64 = 3300.0;

/// Pose, tilt and map that explain one image best.
pub(super) struct Refit {
    pub(super) coefficients: TermVector,
    pub(super) pose: Pose,
    /// Σ (1 − e) of its points.
    pub(super) score: f32,
}

/// A state of the fit.
#[derive(Clone, Copy)]
struct Candidate {
    pose: Pose,
    tilt: [f32; 2],
    /// Beyond the map in use.
    step: [f32; TERMS_MAX],
}

impl MapCorrection {
    /// Fits pose, tilt and map to an image from the predicted pose. `map_covariance`: of the map's unknowns; zero keeps the
    /// map in use.
    pub(super) fn refit(
        &self,
        image: &TrackedImage,
        map_covariance: &TermMatrix,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Refit> {
        let mut candidate = Candidate {
            pose: image.predicted,
            tilt: [0.0; 2],
            step: [0.0; TERMS_MAX],
        };
        let mut pose_prior = PoseMatrix::zeros();
        if let Some(information) = image.prior_information {
            // The knock may have moved the last estimates already: a tenth of their information.
            let information = widen(&information) * 0.1;
            pose_prior
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&information.fixed_view::<3, 3>(0, 0));
        }
        for k in 3..PARAMETERS {
            pose_prior[(k, k)] = image
                .independent_tilt_std
                .map_or(STATE_TILT_INFORMATION, |std| {
                    1.0 / f64::from(std * std).max(1e-10)
                });
        }
        for reach in REACH {
            let (sums, _) = self.sums_at(&candidate, reach, image, distances, matching);
            let share = f64::from(self.config.information_share);
            let (step, pose_step) =
                joint_step(&sums, &pose_prior, map_covariance, &candidate, image, share)?;
            for k in 0..TERMS_MAX {
                candidate.step[k] += step[k] as f32;
            }
            let Pose { x, y, theta, .. } = candidate.pose;
            candidate.pose = Pose::new(
                x + pose_step[0] as f32,
                y + pose_step[1] as f32,
                theta + pose_step[2] as f32,
            );
            for k in 0..2 {
                candidate.tilt[k] += pose_step[3 + k] as f32;
            }
        }
        let (_, score) = self.sums_at(&candidate, 0.0, image, distances, matching);
        Some(Refit {
            coefficients: self.applied + TermVector::from_fn(|k, _| candidate.step[k].into()),
            pose: candidate.pose,
            score,
        })
    }

    /// Σ (1 − e) of an image's points under the present map, with the variances of [`MapCorrection::refit`]: those of the matcher
    /// follow the spread that it learned, and would not compare.
    pub(super) fn present_score(
        &self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> f32 {
        let candidate = Candidate {
            pose: image.matched.pose,
            tilt: image.matched.tilt,
            step: [0.0; TERMS_MAX],
        };
        self.sums_at(&candidate, 0.0, image, distances, matching).1
    }

    /// Normal equations at a candidate, and Σ (1 − e).
    fn sums_at(
        &self,
        candidate: &Candidate,
        reach: f32,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> (ImageSums, f32) {
        let mut sums = ImageSums::new(self.basis.terms().len());
        let mut score = 0.0;
        let Pose { x, y, theta, .. } = candidate.pose;
        let (sin, cos) = math::sin_cos(theta);
        let height = matching.viewpoint_height;
        let kernel_squared = matching.kernel_scale_sigmas * matching.kernel_scale_sigmas;
        let map_variance = matching.map_std * matching.map_std;
        for (point, raw) in image.points.iter().zip(&self.points) {
            let mut at = [point.at.x, point.at.y];
            for (derivative, step) in raw.derivatives.iter().zip(candidate.step) {
                at[0] += derivative[0] * step;
                at[1] += derivative[1] * step;
            }
            let [px, py] = ground_from_map(at, candidate.tilt, height);
            let (rx, ry) = (cos * px - sin * py, sin * px + cos * py);
            let near = distances.nearest(x + rx, y + ry);
            let [nx, ny] = near.normal;
            let (mx, my) = (cos * nx + sin * ny, cos * ny - sin * nx);
            let map_row = raw.derivatives.map(|[dx, dy]| mx * dx + my * dy);
            let along = nx * rx + ny * ry;
            let radial_share = along * along / (rx * rx + ry * ry).max(1e-6);
            let variance = raw.tangential_variance
                + map_variance
                + (raw.radial_variance - raw.tangential_variance) * radial_share;
            let widening: f32 = map_row
                .iter()
                .enumerate()
                .map(|(k, value)| value * value * self.prior[(k, k)] as f32)
                .sum();
            let squared =
                near.signed_distance * near.signed_distance / (variance + reach * reach * widening);
            let kept = kernel_squared / (kernel_squared + squared);
            score += kept;
            let per_height = along / height;
            let pose_row = [nx, ny, ny * rx - nx * ry, px * per_height, py * per_height];
            sums.add(
                &pose_row,
                &map_row,
                near.signed_distance,
                kept * kept,
                variance,
            );
        }
        (sums, score)
    }
}

/// One Gauss-Newton step over map, pose and tilt under their priors.
fn joint_step(
    sums: &ImageSums,
    pose_prior: &PoseMatrix,
    map_covariance: &TermMatrix,
    candidate: &Candidate,
    image: &TrackedImage,
    share: f64,
) -> Option<(TermVector, PoseVector)> {
    let offset = candidate.pose.difference(image.predicted);
    let deviation = PoseVector::from_fn(|i, _| match i {
        0..3 => f64::from(offset[i]),
        _ => f64::from(candidate.tilt[i - 3]),
    });
    let evidence = sums.eliminate_pose(pose_prior, &deviation)?;
    let (information, gradient) = (evidence.information * share, evidence.gradient * share);
    // (1 + Σ I)⁻¹ Σ, with the prior's pull towards the present coefficients.
    let factor = TermMatrix::identity() + map_covariance * information;
    let lu = factor.lu();
    let covariance = lu.solve(map_covariance)?;
    let present = TermVector::from_fn(|k, _| f64::from(candidate.step[k]));
    // At the new coefficients: Σ⁻¹ s + g + I (s − s₀) = 0, so s = Σ' (I s₀ − g).
    let target = covariance * (information * present - gradient);
    let step = target - present;
    let pose_step = sums.pose_step(pose_prior, &deviation, &step)?;
    step.iter()
        .chain(pose_step.iter())
        .all(|value| value.is_finite())
        .then_some((step, pose_step))
}
