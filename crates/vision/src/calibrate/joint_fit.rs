//! Joint robust least squares of the map correction and all image poses, from line points to markings.

use localize::Pose;
use localize::matching::distance_field::DistanceField;
use localize::math;
use nalgebra::{DMatrix, DVector};

use crate::calibrate::map_correction::{BasisValues, MapCorrection, PARAMETER_COUNT, PriorTerm};

/// Parameters of an image: x, y, θ and its tilt (a, b).
const IMAGE_PARAMETERS: usize = 5;

/// Standard deviation of one image's tilt, radians: photographs of real robots show 0.45°.
const IMAGE_TILT_STD: f64 = 0.45 * std::f64::consts::PI / 180.0;

/// Deviation of the painted markings from the rule book, metres; added to a point's pixel deviation.
const MARKING_STD: f64 = 0.015;

/// Scale of the robust error per round, metres: from a wrong map to the accuracy of paint.
const ROBUST_SCALES: [f64; 6] = [0.6, 0.4, 0.25, 0.15, 0.1, 0.08];

/// Gauss-Newton steps per scale.
const ITERATIONS_PER_SCALE: usize = 8;

/// A line point of one image, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct CalibrationPoint {
    /// Its ground point in the start map, robot frame.
    pub(super) start: [f64; 2],
    pub(super) std_radial: f64,
    pub(super) std_tangential: f64,
}

/// One image's points and the pose being fitted.
#[derive(Debug, Clone)]
pub(super) struct FitImage {
    pub(super) index: usize,
    pub(super) points: Vec<FitPoint>,
    state: [f64; IMAGE_PARAMETERS],
    /// False once most of its points are outliers.
    pub(super) used: bool,
}

/// A line point in the start map.
#[derive(Debug, Clone)]
pub(super) struct FitPoint {
    basis: BasisValues,
    variance: f64,
}

/// Residual of one image.
pub(super) struct ImageFit {
    pub(super) sum_squared: f64,
    pub(super) inlier_count: f64,
    pub(super) rms_px: f64,
}

impl FitImage {
    pub(super) fn new(index: usize, points: &[CalibrationPoint], pose: Pose) -> Self {
        FitImage {
            index,
            points: points
                .iter()
                .map(|point| {
                    let (radial, tangential) = (point.std_radial, point.std_tangential);
                    FitPoint {
                        basis: BasisValues::new(point.start),
                        variance: MARKING_STD * MARKING_STD
                            + 0.5 * (radial * radial + tangential * tangential),
                    }
                })
                .collect(),
            state: [
                f64::from(pose.x),
                f64::from(pose.y),
                f64::from(pose.theta),
                0.0,
                0.0,
            ],
            used: true,
        }
    }

    pub(super) fn pose(&self) -> Pose {
        Pose::new(
            self.state[0] as f32,
            self.state[1] as f32,
            self.state[2] as f32,
        )
    }
}

/// The joint fit: map correction and images.
pub(super) struct JointFit<'a> {
    distances: &'a DistanceField,
    pub(super) correction: MapCorrection,
    pub(super) images: Vec<FitImage>,
}

impl<'a> JointFit<'a> {
    pub(super) fn new(distances: &'a DistanceField, correction: MapCorrection) -> Self {
        JointFit {
            distances,
            correction,
            images: Vec::new(),
        }
    }

    /// Runs all rounds; excludes images whose points are mostly outliers after a late round.
    pub(super) fn optimize(&mut self) {
        for (round, robust_scale) in ROBUST_SCALES.into_iter().enumerate() {
            // First only the poses under the initial map, then everything.
            for step in 0..ITERATIONS_PER_SCALE {
                let fit_map = round > 0 || step >= 3;
                if self.gauss_newton_step(robust_scale, fit_map) < 1e-5 {
                    break;
                }
            }
            if round >= 3 {
                for index in 0..self.images.len() {
                    let evaluation = self.evaluate(&self.images[index]);
                    let image = &mut self.images[index];
                    image.used = evaluation.inlier_count >= 0.5 * image.points.len() as f64;
                }
            }
        }
    }

    /// One Gauss-Newton step on the reweighted squares; returns its size. `fit_map`: the map is free too.
    fn gauss_newton_step(&mut self, robust_scale: f64, fit_map: bool) -> f64 {
        let unknowns = PARAMETER_COUNT + IMAGE_PARAMETERS * self.images.len();
        let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut gradient = DVector::<f64>::zeros(unknowns);
        let mut row: Vec<(usize, f64)> = Vec::new();
        for (number, image) in self.images.iter().enumerate() {
            let start = PARAMETER_COUNT + IMAGE_PARAMETERS * number;
            let [x, y, theta, a, b] = image.state;
            let (sin, cos) = math::sin_cos(theta);
            for point in image.points.iter().filter(|_| image.used) {
                let (ground, by) = self.correction.jacobian(&point.basis, [a, b]);
                let on_field = [
                    x + cos * ground[0] - sin * ground[1],
                    y + sin * ground[0] + cos * ground[1],
                ];
                if !(on_field[0].is_finite() && on_field[1].is_finite()) {
                    continue;
                }
                let nearest = self
                    .distances
                    .nearest(on_field[0] as f32, on_field[1] as f32);
                let distance = f64::from(nearest.signed_distance);
                let [nx, ny] = nearest.normal.map(f64::from);
                // The normal in the robot frame.
                let (rx, ry) = (cos * nx + sin * ny, cos * ny - sin * nx);
                let by = by.map(|[gx, gy]| rx * gx + ry * gy);
                // Geman and McClure's weight (c²/(c² + t²))², over the point's own variance.
                let c2 = robust_scale * robust_scale + 9.0 * point.variance;
                let weight = (c2 / (c2 + distance * distance)).powi(2)
                    / (point.variance + 0.01 * robust_scale * robust_scale);
                row.clear();
                if fit_map {
                    MapCorrection::append_jacobian(&point.basis, by, &mut row);
                }
                let by_theta = ny * (on_field[0] - x) - nx * (on_field[1] - y);
                row.extend([(start, nx), (start + 1, ny), (start + 2, by_theta)]);
                row.extend([(start + 3, by[2]), (start + 4, by[3])]);
                for &(i, di) in &row {
                    gradient[i] += weight * distance * di;
                    for &(j, dj) in &row {
                        normal[(i, j)] += weight * di * dj;
                    }
                }
            }
            let information = 1.0 / (IMAGE_TILT_STD * IMAGE_TILT_STD);
            for (i, tilt) in [(start + 3, a), (start + 4, b)] {
                normal[(i, i)] += information;
                gradient[i] += information * tilt;
            }
            for i in start..start + 3 {
                normal[(i, i)] += 1.0;
            }
        }
        for PriorTerm { weight, row } in MapCorrection::prior_terms() {
            let value: f64 = row
                .iter()
                .map(|&(i, di)| di * self.correction.parameters[i])
                .sum();
            for &(i, di) in &row {
                gradient[i] += weight * value * di;
                for &(j, dj) in &row {
                    normal[(i, j)] += weight * di * dj;
                }
            }
        }
        if !fit_map {
            for i in 0..PARAMETER_COUNT {
                gradient[i] = 0.0;
                normal[(i, i)] += 1e12;
            }
        }
        let Some(cholesky) = normal.cholesky() else {
            return 0.0;
        };
        let step = -cholesky.solve(&gradient);
        for (value, step) in self.correction.parameters.iter_mut().zip(step.iter()) {
            *value += step;
        }
        let mut size = 0.0f64;
        for (number, image) in self.images.iter_mut().enumerate() {
            for (i, value) in image.state.iter_mut().enumerate() {
                let change = step[PARAMETER_COUNT + IMAGE_PARAMETERS * number + i];
                *value += change;
                size = size.max(change.abs());
            }
        }
        size
    }

    /// Residual of an image at the present fit.
    pub(super) fn evaluate(&self, image: &FitImage) -> ImageFit {
        let [x, y, theta, a, b] = image.state;
        let (sin, cos) = math::sin_cos(theta);
        let (mut squares, mut inliers, mut relative) = (0.0, 0.0, 0.0);
        for point in &image.points {
            let [gx, gy] = self.correction.correct_point(&point.basis, [a, b]);
            let (fx, fy) = (x + cos * gx - sin * gy, y + sin * gx + cos * gy);
            if !(fx.is_finite() && fy.is_finite()) {
                continue;
            }
            let distance = f64::from(self.distances.nearest(fx as f32, fy as f32).signed_distance);
            if distance * distance <= 9.0 * (point.variance + MARKING_STD * MARKING_STD) {
                squares += distance * distance;
                relative += distance * distance / point.variance;
                inliers += 1.0;
            }
        }
        ImageFit {
            sum_squared: squares,
            inlier_count: inliers,
            rms_px: 0.5 * (relative / f64::max(inliers, 1.0)).sqrt(),
        }
    }
}
