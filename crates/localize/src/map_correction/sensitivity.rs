//! What does the map's error do to the pose? Sums over the points of an image, and the pose's error by the map's.

use nalgebra::Matrix3;

use super::state::{MapCorrection, TrackedImage};
use super::sums::{ImageSums, PoseByTerm, widen};
use super::term::TERMS_MAX;
use crate::frames::Pose;
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::tilt::{self, ground_from_map};

impl MapCorrection {
    /// Covariance of (x, y, θ) by the map's remaining uncertainty.
    pub fn pose_covariance(&self) -> Matrix3<f32> {
        let by_term = self.sensitivity.fixed_rows::<3>(0);
        let covariance = by_term * self.claimed_deviation() * by_term.transpose();
        ((covariance + covariance.transpose()) * 0.5).map(|value| value as f32)
            + self.trial_covariance()
    }

    /// A pose was found without a prediction: its error follows from this image alone.
    pub fn restart(
        &mut self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) {
        if image.points.len() != self.points.len() {
            return;
        }
        self.drift_to(image.stamp);
        self.last_pose = None;
        let (_, widened) = self.accumulate(image, distances, matching, false);
        self.update_sensitivity(image, &widened);
        self.last_pose = Some(image.matched.pose);
    }

    /// The pose was moved to the other field half.
    pub fn apply_half_turn(&mut self) {
        for i in 0..2 {
            for j in 0..TERMS_MAX {
                self.sensitivity[(i, j)] = -self.sensitivity[(i, j)];
            }
        }
        let turned = |pose: Pose| Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI);
        self.last_pose = self.last_pose.map(turned);
        self.used_pose = self.used_pose.map(turned);
    }

    /// Sums over the points at the matched pose: with their own variances (for the map), and with the widened ones, as
    /// the matcher used them (for the pose).
    pub(super) fn accumulate(
        &self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
        for_map: bool,
    ) -> (ImageSums, ImageSums) {
        let terms = self.basis.terms().len();
        let (mut stated, mut widened) = (ImageSums::new(terms), ImageSums::new(terms));
        let Pose { x, y, theta, .. } = image.matched.pose;
        let (sin, cos) = math::sin_cos(theta);
        let height = matching.viewpoint_height;
        let kernel_squared = matching.kernel_scale_sigmas * matching.kernel_scale_sigmas;
        let map_variance = matching.map_std * matching.map_std;
        // Tilt and mount do nearly the same to the points. Only exact derivatives tell them apart.
        let tilt = [0, 1].map(|k| image.expected_tilt[k] + image.matched.tilt[k]);
        for (point, raw) in image.points.iter().zip(&self.points) {
            let tilted = tilt::linearize(raw.at, tilt, height);
            let [px, py] = ground_from_map([point.at.x, point.at.y], image.matched.tilt, height);
            let (rx, ry) = (cos * px - sin * py, sin * px + cos * py);
            let near = distances.nearest(x + rx, y + ry);
            let [nx, ny] = near.normal;
            let along = nx * rx + ny * ry;
            let radial_share = along * along / (rx * rx + ry * ry).max(1e-6);
            let variance = |radial: f32, tangential: f32| {
                tangential + map_variance + (radial - tangential) * radial_share
            };
            let wide = variance(
                point.std_radial * point.std_radial,
                point.std_tangential * point.std_tangential,
            ) * image
                .matched
                .point_spread
                .at(math::hypot(point.at.x, point.at.y));
            let kept = kernel_squared / (kernel_squared + near.signed_distance.powi(2) / wide);
            let robust_weight = kept * kept;
            let (mx, my) = (cos * nx + sin * ny, cos * ny - sin * nx);
            let along_normal =
                |rows: [[f32; 2]; 2]| [0, 1].map(|j| mx * rows[0][j] + my * rows[1][j]);
            let [by_a, by_b] = along_normal(tilted.by_tilt);
            let [by_x, by_y] = along_normal(tilted.by_point);
            let pose_row = [nx, ny, ny * rx - nx * ry, by_a, by_b];
            let map_row = raw.derivatives.map(|[dx, dy]| by_x * dx + by_y * dy);
            widened.add_cross(&pose_row, &map_row, robust_weight / wide);
            if for_map {
                let own = variance(raw.radial_variance, raw.tangential_variance);
                stated.add(
                    &pose_row,
                    &map_row,
                    near.signed_distance,
                    robust_weight,
                    own,
                );
            }
        }
        (stated, widened)
    }

    /// Error of pose and tilt per error of the unknowns after the match: X ← P (Λ X − N_pc).
    pub(super) fn update_sensitivity(&mut self, image: &TrackedImage, sums: &ImageSums) {
        let moved = match self.last_pose {
            Some(last) => [image.predicted.x - last.x, image.predicted.y - last.y],
            None => [0.0; 2],
        };
        for k in 0..TERMS_MAX {
            // A heading error moves the pose sideways while the robot drives.
            let heading = self.sensitivity[(2, k)];
            self.sensitivity[(0, k)] -= heading * f64::from(moved[1]);
            self.sensitivity[(1, k)] += heading * f64::from(moved[0]);
            if image.independent_tilt_std.is_some() {
                self.sensitivity[(3, k)] = 0.0;
                self.sensitivity[(4, k)] = 0.0;
            }
        }
        let posterior = widen(&image.matched.pose_tilt_covariance);
        let scale = f64::from(image.matched.variance_scale);
        let prior = image
            .prior_information
            .map_or(PoseByTerm::zeros(), |information| {
                widen(&information) * self.sensitivity
            });
        self.sensitivity = posterior * (prior - sums.cross_information() / scale);
    }
}
