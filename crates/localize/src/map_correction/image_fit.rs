//! Which pose, tilt and map explain one image best? Gauss-Newton with exact displacements, from a start that may be far off.

use super::state::MapCorrection;
use super::sums::{ImageSums, PoseMatrix, PoseVector, TermMatrix, TermVector};
use crate::frames::Pose;
use crate::matching::distance_field::DistanceField;
use crate::matching::{MatchConfig, PARAMETERS};
use crate::math;
use crate::tilt;

/// Pose, tilt and map of one image.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImageState {
    pub(super) coefficients: TermVector,
    pub(super) pose: Pose,
    /// Of the robot, radians.
    pub(super) tilt: [f32; 2],
}

impl ImageState {
    /// Adds a step of pose and tilt.
    pub(super) fn move_by(&mut self, step: &PoseVector) {
        let Pose { x, y, theta, .. } = self.pose;
        let [dx, dy, dtheta, da, db] = step.map(|value| value as f32).into();
        self.pose = Pose::new(x + dx, y + dy, theta + dtheta);
        self.tilt = [self.tilt[0] + da, self.tilt[1] + db];
    }
}

/// What is known before the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImagePrior {
    /// Mean of pose, tilt and map.
    pub(super) mean: ImageState,
    /// Of (x, y, θ, a, b).
    pub(super) information: PoseMatrix,
    /// Of the map's unknowns; zero keeps the map of the mean.
    pub(super) covariance: TermMatrix,
    /// Share of the points' information on the map.
    pub(super) share: f64,
    /// Largest mean information of the image on the map, relative to what is known already.
    pub(super) gain_max: f64,
}

/// The best state of an image.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImageFit {
    pub(super) state: ImageState,
    /// Of the map's unknowns, after the image.
    pub(super) covariance: TermMatrix,
    /// Σ (1 − e) of its points under their own variances.
    pub(super) score: f32,
}

impl MapCorrection {
    /// Fits the present image, which [`MapCorrection::correct`] prepared. `reaches`: of the points in each step, as shares of a new map's
    /// displacements. None if a step is singular.
    pub(super) fn fit_image(
        &self,
        start: ImageState,
        prior: &ImagePrior,
        reaches: &[f32],
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<ImageFit> {
        let (mut state, mut covariance) = (start, prior.covariance);
        for reach in reaches {
            let (sums, _) = self.image_sums(&state, *reach, distances, matching);
            let offset = state.pose.difference(prior.mean.pose);
            let deviation = PoseVector::from_fn(|i, _| match i {
                0..3 => f64::from(offset[i]),
                _ => f64::from(state.tilt[i - 3] - prior.mean.tilt[i - 3]),
            });
            let evidence = sums.eliminate_pose(&prior.information, &deviation)?;
            let gain = (prior.covariance * evidence.information).trace();
            let gain_max = prior.gain_max * self.basis.terms().len() as f64;
            let share = prior.share.min(gain_max / gain.max(1e-9));
            let information = evidence.information * share;
            let factor = TermMatrix::identity() + prior.covariance * information;
            covariance = factor.lu().solve(&prior.covariance)?;
            // At the new coefficients: Σ⁻¹ (c − m) + g + I (c − c₀) = 0.
            let present = state.coefficients - prior.mean.coefficients;
            let target = covariance * (information * present - evidence.gradient * share);
            let step = target - present;
            let pose_step = sums.pose_step(&prior.information, &deviation, &step)?;
            if step
                .iter()
                .chain(&pose_step)
                .any(|value| !value.is_finite())
            {
                return None;
            }
            state.coefficients += step;
            state.move_by(&pose_step);
        }
        let (_, score) = self.image_sums(&state, 0.0, distances, matching);
        Some(ImageFit {
            state,
            covariance: (covariance + covariance.transpose()) * 0.5,
            score,
        })
    }

    /// Normal equations of the present image at a state, and Σ (1 − e).
    pub(super) fn image_sums(
        &self,
        state: &ImageState,
        reach: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> (ImageSums, f32) {
        let mut sums = ImageSums::new(self.basis.terms().len());
        let mut score = 0.0;
        let coefficients = state.coefficients.map(|value| value as f32);
        let prepared = self.basis.prepare(coefficients.into());
        let Pose { x, y, theta, .. } = state.pose;
        let (sin, cos) = math::sin_cos(theta);
        let kernel_squared = matching.kernel_scale_sigmas * matching.kernel_scale_sigmas;
        let map_variance = matching.map_std * matching.map_std;
        let widths = self
            .prior
            .diagonal()
            .map(|value| reach * reach * value as f32);
        for raw in &self.points {
            let displaced = prepared.displace(raw.given);
            let tilted = tilt::linearize(displaced.at, state.tilt, matching.viewpoint_height);
            let [px, py] = tilted.ground;
            let (rx, ry) = (cos * px - sin * py, sin * px + cos * py);
            let near = distances.nearest(x + rx, y + ry);
            let [nx, ny] = near.normal;
            let (mx, my) = (cos * nx + sin * ny, cos * ny - sin * nx);
            let along_normal =
                |rows: [[f32; 2]; 2]| [0, 1].map(|j| mx * rows[0][j] + my * rows[1][j]);
            let [by_a, by_b] = along_normal(tilted.by_tilt);
            let [by_x, by_y] = along_normal(tilted.by_point);
            let pose_row: [f32; PARAMETERS] = [nx, ny, ny * rx - nx * ry, by_a, by_b];
            let map_row = displaced.derivatives.map(|[dx, dy]| by_x * dx + by_y * dy);
            let along = nx * rx + ny * ry;
            let radial_share = along * along / (rx * rx + ry * ry).max(1e-6);
            let variance = raw.tangential_variance
                + map_variance
                + (raw.radial_variance - raw.tangential_variance) * radial_share;
            let widening: f32 = map_row.iter().zip(&widths).map(|(d, v)| d * d * v).sum();
            let wide = variance + widening;
            let kept = kernel_squared
                / (kernel_squared + near.signed_distance * near.signed_distance / wide);
            score += kept;
            sums.add(&pose_row, &map_row, near.signed_distance, kept * kept, wide);
        }
        (sums, score)
    }
}
