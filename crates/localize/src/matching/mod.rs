//! Which pose, near a given one, lays the line points onto the markings best, and how sure is that?
//!
//! Minimises Σ e(d(o_i)), e(t) = 1 − c²/(c² + t²) (nubot2013 eq. 4, minho2016 eq. 5), by Gauss-Newton on
//! reweighted squares in place of RPROP. Every point's c is a multiple of its own expected deviation across the
//! marking it meets, so that near points count for more than far ones. The frame's lean (a, b) is estimated along
//! with (x, y, θ) under a prior, since a robot stands a little differently everywhere.

pub mod distance_field;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::frames::{Pose, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;
use crate::tilt;

/// How the error is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Minimiser {
    /// Gauss-Newton on reweighted squares.
    #[default]
    GaussNewton,
    /// Resilient backpropagation: steps by the gradient's signs (nubot2013 4, minho2016 VI).
    Rprop,
}

/// How line points are matched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MatchConfig {
    /// How the error is minimised.
    pub minimiser: Minimiser,
    /// c of e(t) in standard deviations of a point: beyond about this a point is an outlier.
    pub kernel_scale_sigmas: f32,
    /// Deviation that every point has besides its own, metres: paint is not where the rule book says, and the map is
    /// not perfect.
    pub map_std: f32,
    /// Most steps per frame; RPROP needs about three times as many as Newton.
    pub steps_max: usize,
    /// A step smaller than this ends the search, metres (and radians at one metre's lever).
    pub convergence_step: f32,
    /// Standard deviation of the robot's lean in each direction, degrees; 0 takes every frame for upright.
    /// Photographs of real robots show 0.45 from frame to frame.
    pub tilt_std_deg: f32,
    /// Height of the viewpoint (the mirror) above the ground, metres: a lean moves far points by their distance
    /// squared over it.
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
            viewpoint_height: crate::robot::DEFAULT_VIEWPOINT_HEIGHT,
        }
    }
}

/// Where the robot is expected before its points are seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePrior {
    /// The expected pose.
    pub pose: Pose,
    /// Inverse covariance of (x, y, θ, a, b), the lean beyond what the points were bent by: m⁻², rad⁻².
    pub information: Matrix5,
}

/// A pose and how well it explains the points.
#[derive(Debug, Clone, PartialEq)]
pub struct Match {
    /// The best pose (by points and expectation together, where there was one).
    pub pose: Pose,
    /// Of (x, y, θ), metres and radians; large along directions that nothing determines.
    pub covariance: Matrix3<f32>,
    /// Squared deviation from the expected pose in its standard deviations; 0 without expectation.
    pub mahalanobis_squared: f32,
    /// Lean (a, b), radians: the ground point (X, Y) was mapped about (aH, bH) + (aX + bY)(X, Y)/H short.
    pub tilt: [f32; 2],
    /// Of (x, y, θ, a, b).
    pub pose_tilt_covariance: Matrix5,
    /// Root mean square distance of the inliers from the markings, metres.
    pub residual: f32,
    /// Mean distance of all points from the markings, metres (nubot2013 4: "average deviation").
    pub mean_distance: f32,
    /// Share of the points within `reach_sigmas` of a marking.
    pub inlier_share: f32,
    /// Σ (1 − e) over the number of points: 1 were all on the markings.
    pub score: f32,
    /// Negative logarithm of the points' likelihood, Σ c²/2σ² e(d), up to a constant.
    pub cost: f32,
    /// Steps taken.
    pub steps: usize,
}

/// A point made ready: what does not change between Newton steps.
#[derive(Debug, Clone, Copy)]
struct PreparedPoint {
    x: f32,
    y: f32,
    /// Variance across the bearing plus the floor, m².
    tangential_variance: f32,
    /// Radial minus tangential variance over the squared distance.
    radial_excess_variance: f32,
}

/// Matches the points of one frame; holds the buffers between frames.
#[derive(Debug, Clone)]
pub struct Matcher {
    config: MatchConfig,
    points: Vec<PreparedPoint>,
    prior: PosePrior,
}

/// Pose and lean.
pub(crate) const PARAMETERS: usize = 5;
/// Of pose and lean, (x, y, θ, a, b).
pub type Matrix5 = SMatrix<f32, 5, 5>;
type NormalMatrix = Matrix5;
type Vector5 = SVector<f32, PARAMETERS>;

/// Information of a pose of which nothing is known (m⁻², m⁻², rad⁻²): no field is larger than 30 m, no heading further
/// than half a turn away. Keeps free directions invertible.
const UNINFORMATIVE_PRIOR: Matrix3<f32> =
    Matrix3::new(1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.1);

/// As many points as claimed by themselves how far off they are, before this frame's residual is believed.
const PRIOR_POINTS: f32 = 10.0;

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

    /// From now on frames lean by so much, radians (one sigma), beyond what their points were bent by already.
    pub fn set_tilt_std(&mut self, std: f32) {
        self.config.tilt_std_deg = std.to_degrees();
    }

    /// How far frames lean beyond what their points were bent by, radians (one sigma).
    pub fn tilt_std(&self) -> f32 {
        self.config.tilt_std_deg.to_radians().max(1e-5)
    }

    /// Matches `points` (finite; robot frame) from `start`, whose error may be about `spread` metres.
    ///
    /// The reach starts at `spread` and shrinks to the points' own, so that a start a few decimetres off is drawn in.
    pub fn refine(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        start: Pose,
        spread: f32,
    ) -> Match {
        let nothing = PosePrior {
            pose: start,
            information: self.uninformative_prior(),
        };
        Match {
            mahalanobis_squared: 0.0,
            ..self.refine_with_prior(distances, points, nothing, spread)
        }
    }

    /// Matches `points` (finite; robot frame) under an expectation: the iterated update of an EKF, so that directions
    /// which the points leave free stay where they are expected, and a few points cannot turn the robot.
    pub fn refine_with_prior(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        expected: PosePrior,
        spread: f32,
    ) -> Match {
        self.prepare(points, expected);
        let Pose { x, y, theta, .. } = expected.pose;
        let mut state = Vector5::from([x, y, theta, 0.0, 0.0]);
        let widening = self.kernel_start_factor(spread);
        let steps = match self.config.minimiser {
            Minimiser::GaussNewton => self.gauss_newton(distances, &mut state, widening),
            Minimiser::Rprop => self.rprop(distances, &mut state, widening),
        };
        let sums = self.accumulate(distances, &state, 1.0);
        self.summarize(&sums, &state, steps)
    }

    /// Gauss-Newton; the reach is halved with every step until it is the points' own.
    fn gauss_newton(
        &self,
        distances: &DistanceField,
        state: &mut Vector5,
        mut widening: f32,
    ) -> usize {
        for steps in 1..=self.config.steps_max {
            let sums = self.accumulate(distances, state, widening);
            let step = self.gauss_newton_step(&sums, state);
            *state += step;
            if widening > 1.0 {
                widening = (widening * 0.5).max(1.0);
            } else if step.fixed_rows::<3>(0).amax() < self.config.convergence_step {
                return steps;
            }
        }
        self.config.steps_max
    }

    /// RPROP over (x, y, θ): each parameter has a step of its own, larger by 1.2 while the derivative keeps its sign,
    /// half as large where it changed (nubot2013 4 after Lauer et al.). The lean is not estimated.
    fn rprop(&self, distances: &DistanceField, state: &mut Vector5, mut widening: f32) -> usize {
        let mut steps = Vector3::from_element(0.02_f32);
        let mut last = Vector3::zeros();
        for count in 1..=self.config.steps_max {
            let sums = self.accumulate(distances, state, widening);
            let pull = self.prior.information * self.prior_residual(state);
            let gradient = (sums.gradient + pull).fixed_rows::<3>(0).into_owned();
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
            widening = (widening * 0.8).max(1.0);
            if steps.amax() < self.config.convergence_step {
                return count;
            }
        }
        self.config.steps_max
    }

    /// How well `points` lie on the markings at exactly `pose`, nothing moved.
    pub fn evaluate(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        pose: Pose,
    ) -> Match {
        let information = self.uninformative_prior();
        self.prepare(points, PosePrior { pose, information });
        let state = Vector5::from([pose.x, pose.y, pose.theta, 0.0, 0.0]);
        let sums = self.accumulate(distances, &state, 1.0);
        self.summarize(&sums, &state, 0)
    }

    fn prepare(&mut self, points: &[LinePoint], expected: PosePrior) {
        self.prior = expected;
        let floor = self.config.map_std * self.config.map_std;
        self.points.clear();
        self.points.extend(points.iter().map(|point| {
            let across = point.std_tangential * point.std_tangential;
            let radial = point.std_radial * point.std_radial;
            let (x, y) = (point.at.x, point.at.y);
            PreparedPoint {
                x,
                y,
                tangential_variance: across + floor,
                radial_excess_variance: (radial - across) / (x * x + y * y).max(1e-6),
            }
        }));
    }

    /// By how much the reach is widened at the start so that it covers `spread`.
    fn kernel_start_factor(&self, spread: f32) -> f32 {
        let variance = self
            .points
            .iter()
            .map(|point| point.tangential_variance)
            .sum::<f32>()
            / self.points.len().max(1) as f32;
        (spread / (self.config.kernel_scale_sigmas * variance.sqrt())).clamp(1.0, 16.0)
    }

    /// One pass over the points: normal equations of the reweighted squares and the sums that judge them.
    fn accumulate(
        &self,
        distances: &DistanceField,
        state: &Vector5,
        widening: f32,
    ) -> NormalEquations {
        let (sin, cos) = state[2].sin_cos();
        let (a, b) = (state[3], state[4]);
        let height = self.config.viewpoint_height;
        let per_height = 1.0 / height;
        let reach_squared = (self.config.kernel_scale_sigmas * widening).powi(2);
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
            // The normal in the robot frame, for the lean's derivatives.
            let (mx, my) = (cos * nx + sin * ny, cos * ny - sin * nx);
            let along = radial * per_height;
            let row = [
                nx,
                ny,
                ny * rx - nx * ry,
                mx * height + x * along,
                my * height + y * along,
            ];
            let information = 1.0 / variance;
            let squared = near.signed_distance * near.signed_distance * information;
            // e(t) with t in standard deviations: 1 − e = k²/(k² + t²).
            let kept = reach_squared / (reach_squared + squared);
            let root_weight = kept * kept;
            let factor = root_weight * information;
            weight += root_weight;
            psi_squared += root_weight * root_weight * squared;
            psi_slope += root_weight * (4.0 * kept - 3.0);
            squares += root_weight * near.signed_distance * near.signed_distance;
            deviations += near.signed_distance.abs();
            score += kept;
            inliers += f32::from(u8::from(squared < reach_squared));
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

    /// The Gauss-Newton step under expectation and lean's prior; no step where the equations have no solution.
    fn gauss_newton_step(&self, sums: &NormalEquations, state: &Vector5) -> Vector5 {
        let normal = sums.normal + self.prior.information;
        let gradient = sums.gradient + self.prior.information * self.prior_residual(state);
        let Some(cholesky) = normal.cholesky() else {
            return Vector5::zeros();
        };
        let mut step = -cholesky.solve(&gradient);
        // A step further than the reach of any point would be blind.
        let size = step.fixed_rows::<3>(0).amax();
        if size > 0.5 {
            step *= 0.5 / size;
        }
        step
    }

    /// Of a pose of which nothing is known, and of how robots lean.
    fn uninformative_prior(&self) -> Matrix5 {
        let mut information = Matrix5::from_diagonal_element(self.tilt_information());
        information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&UNINFORMATIVE_PRIOR);
        information
    }

    /// 1/σ² of the lean, bounded so that σ = 0 holds the robot upright.
    fn tilt_information(&self) -> f32 {
        let std = self.config.tilt_std_deg.to_radians();
        1.0 / (std * std).max(1e-10)
    }

    fn prior_residual(&self, state: &Vector5) -> Vector5 {
        let expected = self.prior.pose;
        Vector5::from([
            state[0] - expected.x,
            state[1] - expected.y,
            wrap_angle(state[2] - expected.theta),
            state[3],
            state[4],
        ])
    }

    fn summarize(&self, sums: &NormalEquations, state: &Vector5, steps: usize) -> Match {
        let count = self.points.len().max(1) as f32;
        // Covariance of an M-estimator: (Σψ²/Σw) / (Σψ′/Σw)² · (Σ w J Jᵀ)⁻¹, with the degrees of freedom that the
        // pose itself took. It scales with the residual, whatever the points claimed.
        let weight = sums.weight.max(1e-6);
        let freedom = (weight / (weight - 3.0).max(1.0)).max(1.0);
        let slope = (sums.psi_slope / weight).clamp(0.2, 1.0);
        let seen = sums.psi_squared / weight / (slope * slope) * freedom;
        let scale = ((seen * weight + PRIOR_POINTS) / (weight + PRIOR_POINTS)).clamp(0.1, 25.0);
        let normal = sums.normal / scale + self.prior.information;
        let with_lean = normal.try_inverse().unwrap_or_else(|| {
            let nothing = self.uninformative_prior().diagonal();
            Matrix5::from_diagonal(&nothing.map(|known| 1.0 / known))
        });
        let with_lean = (with_lean + with_lean.transpose()) * 0.5;
        let deviation = self.prior_residual(state);
        let reach_squared = self.config.kernel_scale_sigmas * self.config.kernel_scale_sigmas;
        Match {
            pose: Pose::new(state[0], state[1], state[2]),
            covariance: with_lean.fixed_view::<3, 3>(0, 0).into_owned(),
            mahalanobis_squared: deviation.dot(&(self.prior.information * deviation)),
            tilt: [state[3], state[4]],
            pose_tilt_covariance: with_lean,
            residual: (sums.weighted_squares / weight).sqrt(),
            mean_distance: sums.distance_sum / count,
            inlier_share: sums.inliers / count,
            score: sums.score / count,
            cost: 0.5 * reach_squared * (self.points.len() as f32 - sums.score),
            steps,
        }
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
