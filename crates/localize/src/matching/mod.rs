//! Matching of line points to markings: which pose near a given one fits best, and what is its covariance?
//!
//! Minimises Σ e(d(o_i)), e(t) = 1 − c²/(c² + t²) (nubot2013 eq. 4, minho2016 eq. 5), by Gauss-Newton on
//! reweighted squares in place of RPROP (docs/methods.md 5). The c of a point is a multiple of its own standard
//! deviation across its marking, so that near points have larger weights than far ones. The image's tilt (a, b) is
//! estimated together with (x, y, θ) under a prior, since the robot's tilt varies from place to place.

pub mod distance_field;
mod point_spread;
mod repeated_errors;

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frames::{Pose, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::sample::LinePoint;
use crate::tilt;

use point_spread::{PointSpread, Residual};
pub use repeated_errors::Repetition;
use repeated_errors::{Remainder, RepeatedErrors};

/// Method of minimisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Minimiser {
    /// Gauss-Newton on reweighted squares.
    #[default]
    GaussNewton,
    /// Resilient backpropagation: steps by the gradient's signs (nubot2013 4, minho2016 VI).
    Rprop,
}

/// Settings of matching.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MatchConfig {
    /// Method of minimisation.
    pub minimiser: Minimiser,
    /// Kernel scale c of e(t), in standard deviations of a point. Points beyond about c are outliers; a smaller value
    /// rejects more points.
    pub kernel_scale_sigmas: f32,
    /// Standard deviation added to that of each point, metres (errors of the painted markings and of the map).
    pub map_std: f32,
    /// Largest number of steps per image; RPROP needs about three times as many as Gauss-Newton.
    pub steps_max: usize,
    /// Step size below which the minimisation ends, metres and radians.
    pub convergence_step: f32,
    /// Standard deviation of the robot's tilt per axis, degrees, before images tell. 0 assumes an upright robot; real
    /// robots show 0.45 from image to image.
    pub tilt_std_deg: f32,
    /// Initial standard deviation of the logarithm of the learned variances of points and tilt (docs/methods.md 5.8): 1.2
    /// stands for a factor of 2 in their spread. 0 keeps the stated spread of points and `tilt_std_deg`.
    pub spread_learning_std: f32,
    /// Height of the viewpoint (the mirror) above the ground, metres. A tilt displaces points by their squared distance
    /// over this height.
    pub viewpoint_height: f32,
}

impl Default for MatchConfig {
    fn default() -> Self {
        MatchConfig {
            minimiser: Minimiser::default(),
            kernel_scale_sigmas: 3.0,
            map_std: 0.015,
            steps_max: 20,
            convergence_step: 2e-4,
            tilt_std_deg: 0.45,
            spread_learning_std: 1.2,
            viewpoint_height: crate::robot::DEFAULT_VIEWPOINT_HEIGHT,
        }
    }
}

/// Predicted pose before the line points are used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePrior {
    /// Predicted pose.
    pub pose: Pose,
    /// Inverse covariance of (x, y, θ, a, b): m⁻², rad⁻². The tilt is that beyond the compensation of the points.
    pub information: Matrix5,
}

/// The result of matching: a pose, its covariance and quality.
#[derive(Debug, Clone, PartialEq)]
pub struct Match {
    /// The best pose, from points and prior.
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians; large along unobservable directions.
    pub covariance: Matrix3<f32>,
    /// Squared Mahalanobis distance from the prior pose; 0 without a prior.
    pub mahalanobis_squared: f32,
    /// Tilt (a, b), radians, beyond the compensation of the points (docs/methods.md 3.1).
    pub tilt: [f32; 2],
    /// Of (x, y, θ, a, b).
    pub pose_tilt_covariance: Matrix5,
    /// Variance that the points count with over the one as a single image: above 1 if images on the way repeat errors.
    pub repetition_ratio: f32,
    /// Of (x, y, θ): the part of this image's error that further images here repeat (docs/methods.md 5.9).
    pub repeated_covariance: Matrix3<f32>,
    /// Number of parameters that the points determined, at most 5. The prior determined the others.
    pub determined_parameters: f32,
    /// Variance of the residuals over that of the points, from this image alone (docs/methods.md 5.6).
    pub observed_scale: f32,
    /// Variance of the points' errors in the covariance over the one that they state: that of the residuals, and what they
    /// repeat (docs/methods.md 5.6).
    pub variance_scale: f32,
    /// Root mean square distance of the inliers from the markings, metres.
    pub inlier_rms: f32,
    /// Mean distance of all points from the markings, metres (nubot2013 4: "average deviation").
    pub mean_distance: f32,
    /// Share of the points within `kernel_scale_sigmas` of a marking.
    pub inlier_share: f32,
    /// Mean of 1 − e: 1 if all points are on the markings.
    pub score: f32,
    /// Negative log likelihood of the points, Σ c²/2σ² e(d), up to a constant.
    pub cost: f32,
    /// Steps taken.
    pub steps: usize,
}

/// A point with its quantities that are constant between steps.
#[derive(Debug, Clone, Copy)]
struct PreparedPoint {
    x: f32,
    y: f32,
    /// Variance across the bearing plus the map's variance, m².
    tangential_variance: f32,
    /// Radial minus tangential variance over the squared distance.
    radial_excess_variance: f32,
}

/// Matches the points of one image; keeps its buffers between images.
#[derive(Debug, Clone)]
pub struct Matcher {
    config: MatchConfig,
    points: Vec<PreparedPoint>,
    prior: PosePrior,
    spread: PointSpread,
    repeated: RepeatedErrors,
    residuals: Vec<Residual>,
    remainders: Vec<Remainder>,
    /// Variance of the present image's mean error over that of independent points.
    repetition: f32,
}

/// Number of parameters: pose and tilt.
pub(crate) const PARAMETERS: usize = 5;
/// A matrix over pose and tilt, (x, y, θ, a, b).
pub type Matrix5 = SMatrix<f32, 5, 5>;
type NormalMatrix = Matrix5;
/// A vector over pose and tilt, (x, y, θ, a, b).
pub(crate) type Vector5 = SVector<f32, PARAMETERS>;

/// Information of an unknown pose (m⁻², m⁻², rad⁻²): no field is larger than 30 m, no heading error larger than π.
/// Keeps unobservable directions invertible.
pub(crate) const UNINFORMATIVE_PRIOR: Matrix3<f32> =
    Matrix3::new(1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.1);

/// Variance of a matched pose over that of independent residuals: a point is compared with the nearest marking, which is
/// not always its own, so that residuals understate errors (measured on synthetic drives, docs/methods.md 5.6).
const NEAREST_MARKING_SCALE: f32 = 1.15;

/// Repeated variance, relative to that of independent points, from which it is reported.
const REPEATED_MIN: f32 = 0.02;

/// Sums over the points at one pose.
struct NormalEquations {
    normal: NormalMatrix,
    gradient: Vector5,
    /// Σ w, Σ ψ², Σ ψ′, Σ w d², Σ |d|, Σ (1 − e), inliers.
    weight: f32,
    psi_squared: f32,
    psi_slope: f32,
    weighted_squares: f32,
    distance_sum: f32,
    score: f32,
    inliers: f32,
}

impl Matcher {
    /// A matcher with empty buffers.
    pub fn new(config: MatchConfig) -> Self {
        Matcher {
            spread: PointSpread::new(config.spread_learning_std),
            repeated: RepeatedErrors::new(),
            residuals: Vec::new(),
            remainders: Vec::new(),
            repetition: 1.0,
            config,
            points: Vec::new(),
            prior: PosePrior {
                pose: Pose::new(0.0, 0.0, 0.0),
                information: Matrix5::identity(),
            },
        }
    }

    /// The configuration in use.
    pub fn config(&self) -> &MatchConfig {
        &self.config
    }

    /// Sets the standard deviation of the tilt beyond the compensation of the points, radians.
    pub fn set_tilt_std(&mut self, std: f32) {
        self.config.tilt_std_deg = std.to_degrees();
    }

    /// Standard deviation of the tilt beyond the compensation of the points, radians.
    pub fn tilt_std(&self) -> f32 {
        self.config.tilt_std_deg.to_radians().max(1e-5)
    }

    /// Matches `points` (finite; robot frame) from `start`, whose error is about `start_error` metres.
    ///
    /// The kernel scale starts at `start_error` and shrinks to that of the points, so that a start a few decimetres off
    /// converges.
    pub fn refine(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        start: Pose,
        start_error: f32,
    ) -> Match {
        let uninformative = PosePrior {
            pose: start,
            information: self.uninformative_prior(),
        };
        self.repetition = self.repeated.repetition().image_factor();
        Match {
            mahalanobis_squared: 0.0,
            ..self.minimise(distances, points, uninformative, [0.0; 2], start_error)
        }
    }

    /// Matches `points` (finite; robot frame) under a prior: the iterated update of an EKF. Directions that the points
    /// do not determine keep their prior, and a few points cannot rotate the robot.
    pub fn refine_with_prior(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        prior: PosePrior,
        start_error: f32,
    ) -> Match {
        self.refine_from_tilt(distances, points, prior, [0.0; 2], start_error)
    }

    /// The same from another tilt than the expected one, radians.
    pub fn refine_from_tilt(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        prior: PosePrior,
        tilt: [f32; 2],
        start_error: f32,
    ) -> Match {
        self.repetition = self.repeated.sequence_factor(prior.pose);
        self.minimise(distances, points, prior, tilt, start_error)
    }

    /// The same as [`Matcher::refine_with_prior`], if the robot moved so much against the prediction that no repeated error
    /// explains it: the points count as those of a single image.
    pub fn refine_as_single_image(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        prior: PosePrior,
        start_error: f32,
    ) -> Match {
        self.repetition = self.repeated.repetition().image_factor();
        self.minimise(distances, points, prior, [0.0; 2], start_error)
    }

    fn minimise(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        prior: PosePrior,
        [a, b]: [f32; 2],
        start_error: f32,
    ) -> Match {
        self.prepare(points, prior);
        let Pose { x, y, theta, .. } = prior.pose;
        let mut state = Vector5::from([x, y, theta, a, b]);
        let kernel_factor = self.kernel_start_factor(start_error);
        let steps = match self.config.minimiser {
            Minimiser::GaussNewton => self.gauss_newton(distances, &mut state, kernel_factor),
            Minimiser::Rprop => self.rprop(distances, &mut state, kernel_factor),
        };
        let sums = self.accumulate(distances, &state, 1.0);
        self.summarize(&sums, &state, steps)
    }

    /// Gauss-Newton; the kernel scale is halved with every step until it is that of the points.
    fn gauss_newton(
        &self,
        distances: &DistanceField,
        state: &mut Vector5,
        mut kernel_factor: f32,
    ) -> usize {
        for steps in 1..=self.config.steps_max {
            let sums = self.accumulate(distances, state, kernel_factor);
            let step = self.gauss_newton_step(&sums, state);
            *state += step;
            if kernel_factor > 1.0 {
                kernel_factor = (kernel_factor * 0.5).max(1.0);
            } else if step.fixed_rows::<3>(0).amax() < self.config.convergence_step {
                return steps;
            }
        }
        self.config.steps_max
    }

    /// RPROP over (x, y, θ): each parameter's step grows by 1.2 while the derivative keeps its sign and is halved when
    /// the sign changes (nubot2013 4 after Lauer et al.). The tilt is not estimated.
    fn rprop(
        &self,
        distances: &DistanceField,
        state: &mut Vector5,
        mut kernel_factor: f32,
    ) -> usize {
        let mut steps = Vector3::from_element(0.02_f32);
        let mut last = Vector3::zeros();
        for count in 1..=self.config.steps_max {
            let sums = self.accumulate(distances, state, kernel_factor);
            let prior_gradient =
                self.prior.information * self.prior_residual(state) * self.repetition;
            let gradient = (sums.gradient + prior_gradient)
                .fixed_rows::<3>(0)
                .into_owned();
            for i in 0..3 {
                let kept: f32 = last[i] * gradient[i];
                if kept > 0.0 {
                    steps[i] = (steps[i] * 1.2).min(0.3);
                } else if kept < 0.0 {
                    steps[i] *= 0.5;
                }
                if gradient[i] != 0.0 {
                    state[i] -= steps[i] * gradient[i].signum();
                }
            }
            last = gradient;
            kernel_factor = (kernel_factor * 0.8).max(1.0);
            if steps.amax() < self.config.convergence_step {
                return count;
            }
        }
        self.config.steps_max
    }

    /// The quality of a given pose, without minimisation.
    pub fn evaluate(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        pose: Pose,
    ) -> Match {
        let information = self.uninformative_prior();
        self.repetition = self.repeated.repetition().image_factor();
        self.prepare(points, PosePrior { pose, information });
        let state = Vector5::from([pose.x, pose.y, pose.theta, 0.0, 0.0]);
        let sums = self.accumulate(distances, &state, 1.0);
        self.summarize(&sums, &state, 0)
    }

    fn prepare(&mut self, points: &[LinePoint], prior: PosePrior) {
        self.prior = prior;
        let map_variance = self.config.map_std * self.config.map_std;
        let spread = &self.spread;
        self.points.clear();
        self.points.extend(points.iter().map(|point| {
            let tangential = point.std_tangential * point.std_tangential;
            let radial = point.std_radial * point.std_radial;
            let (x, y) = (point.at.x, point.at.y);
            let squared_range = x * x + y * y;
            let factor = spread.factor(squared_range.sqrt());
            PreparedPoint {
                x,
                y,
                tangential_variance: factor * (tangential + map_variance),
                radial_excess_variance: factor * (radial - tangential) / squared_range.max(1e-6),
            }
        }));
    }

    /// Learns the spread of the points and how their errors repeat from the residuals of the last match, `matched`, an
    /// image `seconds` after the previous one (docs/methods.md 5.8, 5.9).
    pub fn learn_spread(&mut self, distances: &DistanceField, matched: &Match, seconds: f32) {
        let Pose { x, y, theta, .. } = matched.pose;
        let state = Vector5::from([x, y, theta, matched.tilt[0], matched.tilt[1]]);
        let sums = self.accumulate(distances, &state, 1.0);
        // What a pose from these points alone would explain is no error of theirs.
        let free = (sums.normal + self.uninformative_prior())
            .cholesky()
            .map_or_else(Vector5::zeros, |cholesky| -cholesky.solve(&sums.gradient));
        let (sin, cos) = math::sin_cos(theta);
        let height = self.config.viewpoint_height;
        let inverse_height = 1.0 / height;
        self.residuals.clear();
        self.remainders.clear();
        for point in &self.points {
            let [px, py] = tilt::ground_from_map([point.x, point.y], matched.tilt, height);
            let (rx, ry) = (cos * px - sin * py, sin * px + cos * py);
            let near = distances.nearest(x + rx, y + ry);
            let [nx, ny] = near.normal;
            let radial = nx * rx + ny * ry;
            let variance =
                point.tangential_variance + point.radial_excess_variance * radial * radial;
            self.residuals.push(Residual {
                distance: near.signed_distance,
                variance,
                range: (rx * rx + ry * ry).sqrt(),
            });
            let along = radial * inverse_height;
            let explained = nx * free[0]
                + ny * free[1]
                + (ny * rx - nx * ry) * free[2]
                + along * (px * free[3] + py * free[4]);
            self.remainders.push(Remainder {
                at: [
                    x + rx - near.signed_distance * nx,
                    y + ry - near.signed_distance * ny,
                ],
                sigmas: (near.signed_distance + explained) / variance.sqrt(),
                normal: near.normal,
            });
        }
        self.repeated
            .update(self.remainders.iter().copied(), matched.pose);
        self.spread.update(
            self.residuals.iter().copied(),
            matched.determined_parameters,
            matched.observed_scale,
            seconds,
        );
    }

    /// What is known about errors that repeat.
    pub fn repetition(&self) -> Repetition {
        self.repeated.repetition()
    }

    /// Initial factor of the kernel scale, such that it covers `start_error` metres.
    fn kernel_start_factor(&self, start_error: f32) -> f32 {
        let variance = self
            .points
            .iter()
            .map(|point| point.tangential_variance)
            .sum::<f32>()
            / self.points.len().max(1) as f32;
        (start_error / (self.config.kernel_scale_sigmas * variance.sqrt())).clamp(1.0, 16.0)
    }

    /// One pass over the points: normal equations of the reweighted squares, and the sums for the quality.
    fn accumulate(
        &self,
        distances: &DistanceField,
        state: &Vector5,
        kernel_factor: f32,
    ) -> NormalEquations {
        let (sin, cos) = math::sin_cos(state[2]);
        let (a, b) = (state[3], state[4]);
        let height = self.config.viewpoint_height;
        let inverse_height = 1.0 / height;
        let kernel_squared = (self.config.kernel_scale_sigmas * kernel_factor).powi(2);
        let mut normal = [0.0_f32; 15];
        let mut gradient = [0.0_f32; PARAMETERS];
        let (mut weight, mut psi_squared, mut psi_slope) = (0.0, 0.0, 0.0);
        let (mut squares, mut deviations, mut score, mut inliers) = (0.0, 0.0, 0.0, 0.0);
        for point in &self.points {
            let [x, y] = tilt::ground_from_map([point.x, point.y], [a, b], height);
            let (rx, ry) = (cos * x - sin * y, sin * x + cos * y);
            let near = distances.nearest(state[0] + rx, state[1] + ry);
            let [nx, ny] = near.normal;
            let radial = nx * rx + ny * ry;
            let variance =
                point.tangential_variance + point.radial_excess_variance * radial * radial;
            // By the tilt: docs/methods.md 3.5.
            let along = radial * inverse_height;
            let row = [nx, ny, ny * rx - nx * ry, x * along, y * along];
            let information = 1.0 / variance;
            let squared = near.signed_distance * near.signed_distance * information;
            // e(t) with t in standard deviations: 1 − e = k²/(k² + t²).
            let kept = kernel_squared / (kernel_squared + squared);
            let root_weight = kept * kept;
            let factor = root_weight * information;
            weight += root_weight;
            psi_squared += root_weight * root_weight * squared;
            psi_slope += root_weight * (4.0 * kept - 3.0);
            squares += root_weight * near.signed_distance * near.signed_distance;
            deviations += near.signed_distance.abs();
            score += kept;
            inliers += f32::from(u8::from(squared < kernel_squared));
            let mut k = 0;
            for i in 0..PARAMETERS {
                let scaled = factor * row[i];
                gradient[i] += scaled * near.signed_distance;
                for value in &row[i..] {
                    normal[k] += scaled * value;
                    k += 1;
                }
            }
        }
        NormalEquations {
            normal: symmetric_from_upper(&normal),
            gradient: Vector5::from(gradient),
            weight,
            psi_squared,
            psi_slope,
            weighted_squares: squares,
            distance_sum: deviations,
            score,
            inliers,
        }
    }

    /// The Gauss-Newton step with the prior; zero if the normal equations are singular.
    fn gauss_newton_step(&self, sums: &NormalEquations, state: &Vector5) -> Vector5 {
        let prior = self.prior.information * self.repetition;
        let normal = sums.normal + prior;
        let gradient = sums.gradient + prior * self.prior_residual(state);
        let Some(cholesky) = normal.cholesky() else {
            return Vector5::zeros();
        };
        let mut step = -cholesky.solve(&gradient);
        // A larger step would leave the region that the points were linearised in.
        let size = step.fixed_rows::<3>(0).amax();
        if size > 0.5 {
            step *= 0.5 / size;
        }
        step
    }

    /// Information of an unknown pose with the tilt's prior.
    fn uninformative_prior(&self) -> Matrix5 {
        let mut information = Matrix5::from_diagonal_element(self.tilt_information());
        information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&UNINFORMATIVE_PRIOR);
        information
    }

    /// 1/σ² of the tilt, bounded so that σ = 0 fixes the robot upright.
    fn tilt_information(&self) -> f32 {
        let std = self.config.tilt_std_deg.to_radians();
        1.0 / (std * std).max(1e-10)
    }

    fn prior_residual(&self, state: &Vector5) -> Vector5 {
        let prior = self.prior.pose;
        Vector5::from([
            state[0] - prior.x,
            state[1] - prior.y,
            wrap_angle(state[2] - prior.theta),
            state[3],
            state[4],
        ])
    }

    fn summarize(&self, sums: &NormalEquations, state: &Vector5, steps: usize) -> Match {
        let count = self.points.len().max(1) as f32;
        // Covariance of an M-estimator: (Σψ²/Σw) / (Σψ′/Σw)² · (Σ w J Jᵀ)⁻¹, corrected for the degrees of freedom of
        // the pose. It scales with the residual, whatever standard deviations the points state.
        let weight = sums.weight.max(1e-6);
        let freedom = (weight / (weight - 3.0).max(1.0)).max(1.0);
        let slope = (sums.psi_slope / weight).clamp(0.2, 1.0);
        let observed_scale = sums.psi_squared / weight / (slope * slope) * freedom;
        let [expected_scale, stated_weight] = self.spread.expected_scale();
        let scale = ((observed_scale * weight + expected_scale * stated_weight)
            / (weight + stated_weight))
            .clamp(0.1, 25.0);
        let variance_scale = scale * NEAREST_MARKING_SCALE * self.repetition;
        let normal = sums.normal / variance_scale + self.prior.information;
        let pose_tilt = normal.try_inverse().unwrap_or_else(|| {
            let information = self.uninformative_prior().diagonal();
            Matrix5::from_diagonal(&information.map(|value| 1.0 / value))
        });
        let pose_tilt = (pose_tilt + pose_tilt.transpose()) * 0.5;
        let repeated_covariance = self.repeated_covariance(&sums.normal, scale);
        let deviation = self.prior_residual(state);
        let kernel_squared = self.config.kernel_scale_sigmas * self.config.kernel_scale_sigmas;
        Match {
            pose: Pose::new(state[0], state[1], state[2]),
            covariance: pose_tilt.fixed_view::<3, 3>(0, 0).into_owned(),
            mahalanobis_squared: deviation.dot(&(self.prior.information * deviation)),
            tilt: [state[3], state[4]],
            pose_tilt_covariance: pose_tilt,
            repetition_ratio: self.repetition / self.repeated.repetition().image_factor(),
            repeated_covariance,
            determined_parameters: PARAMETERS as f32 - (pose_tilt * self.prior.information).trace(),
            observed_scale,
            variance_scale,
            inlier_rms: (sums.weighted_squares / weight).sqrt(),
            mean_distance: sums.distance_sum / count,
            inlier_share: sums.inliers / count,
            score: sums.score / count,
            cost: 0.5 * kernel_squared * (self.points.len() as f32 - sums.score),
            steps,
        }
    }
}

impl Matcher {
    /// Covariance of (x, y, θ) by the errors that repeat. None of it is known where the points say nothing.
    fn repeated_covariance(&self, normal: &Matrix5, scale: f32) -> Matrix3<f32> {
        let factor = self.repeated.repetition().floor_factor();
        if factor < REPEATED_MIN {
            return Matrix3::zeros();
        }
        let information = normal / (scale * factor) + self.uninformative_prior();
        information
            .try_inverse()
            .map_or_else(Matrix3::zeros, |covariance| {
                let pose = covariance.fixed_view::<3, 3>(0, 0);
                (pose + pose.transpose()) * 0.5
            })
    }
}

/// The full matrix from its upper triangle, row by row.
fn symmetric_from_upper(upper: &[f32; 15]) -> NormalMatrix {
    let mut full = NormalMatrix::zeros();
    let mut k = 0;
    for i in 0..PARAMETERS {
        for j in i..PARAMETERS {
            full[(i, j)] = upper[k];
            full[(j, i)] = upper[k];
            k += 1;
        }
    }
    full
}
