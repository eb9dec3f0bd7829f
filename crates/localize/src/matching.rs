//! Which pose, near a given one, lays the line points onto the markings best, and how sure is that?
//!
//! Minimises Σ e(d(o_i)), e(t) = 1 − c²/(c² + t²) (nubot2013 eq. 4, minho2016 eq. 5), by Gauss-Newton on
//! reweighted squares in place of RPROP. Every point's c is a multiple of its own expected deviation across the
//! marking it meets, so that near points count for more than far ones. The frame's lean (a, b) is estimated along
//! with (x, y, θ) under a prior, since a robot stands a little differently everywhere.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::distance::DistanceField;
use crate::frame::{Pose, wrap_angle};
use crate::sample::LinePoint;

/// How the error is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Minimiser {
    /// Gauss-Newton on reweighted squares.
    #[default]
    Newton,
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
    pub reach_sigmas: f32,
    /// Deviation that every point has besides its own, metres: paint is not where the rule book says, and the map is
    /// not perfect.
    pub point_std_min: f32,
    /// Most steps per frame; RPROP needs about three times as many as Newton.
    pub steps_max: usize,
    /// A step smaller than this ends the search, metres (and radians at one metre's lever).
    pub step_end: f32,
    /// Standard deviation of the robot's lean in each direction, degrees; 0 takes every frame for upright.
    /// Photographs of real robots show 0.45 from frame to frame.
    pub lean_std_deg: f32,
    /// Height of the viewpoint (the mirror) above the ground, metres: a lean moves far points by their distance
    /// squared over it.
    pub viewpoint_height: f32,
}

impl Default for MatchConfig {
    fn default() -> Self {
        MatchConfig {
            minimiser: Minimiser::default(),
            reach_sigmas: 3.0,
            point_std_min: 0.015,
            steps_max: 20,
            step_end: 2e-4,
            lean_std_deg: 0.45,
            viewpoint_height: 0.75,
        }
    }
}

/// Where the robot is expected before its points are seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
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
    pub strain: f32,
    /// Lean (a, b), radians: the ground point (X, Y) was mapped about (aH, bH) + (aX + bY)(X, Y)/H short.
    pub lean: [f32; 2],
    /// Of (x, y, θ, a, b).
    pub with_lean: Matrix5,
    /// Root mean square distance of the inliers from the markings, metres.
    pub residual: f32,
    /// Mean distance of all points from the markings, metres (nubot2013 4: "average deviation").
    pub deviation: f32,
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
struct Ready {
    x: f32,
    y: f32,
    /// Variance across the bearing plus the floor, m².
    variance_across: f32,
    /// Radial minus tangential variance over the squared distance.
    variance_along: f32,
}

/// Matches the points of one frame; holds the buffers between frames.
#[derive(Debug, Clone)]
pub struct Matcher {
    config: MatchConfig,
    points: Vec<Ready>,
    expected: Expected,
}

/// Pose and lean.
pub(crate) const PARAMETERS: usize = 5;
/// Of pose and lean, (x, y, θ, a, b).
pub type Matrix5 = SMatrix<f32, 5, 5>;
type Normal = Matrix5;
type Vector = SVector<f32, PARAMETERS>;

/// Information of a pose of which nothing is known (m⁻², m⁻², rad⁻²): no field is larger than 30 m, no heading further
/// than half a turn away. Keeps free directions invertible.
const NOTHING_KNOWN: Matrix3<f32> = Matrix3::new(1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.1);

/// As many points as claimed by themselves how far off they are, before this frame's residual is believed.
const CLAIMED: f32 = 10.0;

/// Sums over the points at one pose.
struct Sums {
    normal: Normal,
    gradient: Vector,
    /// Σ w, Σ ψ², Σ ψ′, Σ w d², Σ |d|, Σ (1 − e), inliers.
    weight: f32,
    psi_squared: f32,
    psi_slope: f32,
    squares: f32,
    deviations: f32,
    score: f32,
    inliers: f32,
}

impl Matcher {
    /// A matcher with empty buffers.
    pub fn new(config: MatchConfig) -> Self {
        Matcher {
            config,
            points: Vec::new(),
            expected: Expected {
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
    pub fn expect_lean(&mut self, std: f32) {
        self.config.lean_std_deg = std.to_degrees();
    }

    /// How far frames lean beyond what their points were bent by, radians (one sigma).
    pub fn lean_std(&self) -> f32 {
        self.config.lean_std_deg.to_radians().max(1e-5)
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
        let nothing = Expected {
            pose: start,
            information: self.nothing_known(),
        };
        Match {
            strain: 0.0,
            ..self.fuse(distances, points, nothing, spread)
        }
    }

    /// Matches `points` (finite; robot frame) under an expectation: the iterated update of an EKF, so that directions
    /// which the points leave free stay where they are expected, and a few points cannot turn the robot.
    pub fn fuse(
        &mut self,
        distances: &DistanceField,
        points: &[LinePoint],
        expected: Expected,
        spread: f32,
    ) -> Match {
        self.make_ready(points, expected);
        let Pose { x, y, theta, .. } = expected.pose;
        let mut state = Vector::from([x, y, theta, 0.0, 0.0]);
        let widening = self.widening(spread);
        let steps = match self.config.minimiser {
            Minimiser::Newton => self.newton(distances, &mut state, widening),
            Minimiser::Rprop => self.rprop(distances, &mut state, widening),
        };
        let sums = self.sums(distances, &state, 1.0);
        self.conclude(&sums, &state, steps)
    }

    /// Gauss-Newton; the reach is halved with every step until it is the points' own.
    fn newton(&self, distances: &DistanceField, state: &mut Vector, mut widening: f32) -> usize {
        for steps in 1..=self.config.steps_max {
            let sums = self.sums(distances, state, widening);
            let step = self.step(&sums, state);
            *state += step;
            if widening > 1.0 {
                widening = (widening * 0.5).max(1.0);
            } else if step.fixed_rows::<3>(0).amax() < self.config.step_end {
                return steps;
            }
        }
        self.config.steps_max
    }

    /// RPROP over (x, y, θ): each parameter has a step of its own, larger by 1.2 while the derivative keeps its sign,
    /// half as large where it changed (nubot2013 4 after Lauer et al.). The lean is not estimated.
    fn rprop(&self, distances: &DistanceField, state: &mut Vector, mut widening: f32) -> usize {
        let mut steps = Vector3::from_element(0.02_f32);
        let mut last = Vector3::zeros();
        for count in 1..=self.config.steps_max {
            let sums = self.sums(distances, state, widening);
            let pull = self.expected.information * self.deviation(state);
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
            if steps.amax() < self.config.step_end {
                return count;
            }
        }
        self.config.steps_max
    }

    /// How well `points` lie on the markings at exactly `pose`, nothing moved.
    pub fn assess(&mut self, distances: &DistanceField, points: &[LinePoint], pose: Pose) -> Match {
        let information = self.nothing_known();
        self.make_ready(points, Expected { pose, information });
        let state = Vector::from([pose.x, pose.y, pose.theta, 0.0, 0.0]);
        let sums = self.sums(distances, &state, 1.0);
        self.conclude(&sums, &state, 0)
    }

    fn make_ready(&mut self, points: &[LinePoint], expected: Expected) {
        self.expected = expected;
        let floor = self.config.point_std_min * self.config.point_std_min;
        self.points.clear();
        self.points.extend(points.iter().map(|point| {
            let across = point.std_tangential * point.std_tangential;
            let radial = point.std_radial * point.std_radial;
            let (x, y) = (point.at.x, point.at.y);
            Ready {
                x,
                y,
                variance_across: across + floor,
                variance_along: (radial - across) / (x * x + y * y).max(1e-6),
            }
        }));
    }

    /// By how much the reach is widened at the start so that it covers `spread`.
    fn widening(&self, spread: f32) -> f32 {
        let variance = self
            .points
            .iter()
            .map(|point| point.variance_across)
            .sum::<f32>()
            / self.points.len().max(1) as f32;
        (spread / (self.config.reach_sigmas * variance.sqrt())).clamp(1.0, 16.0)
    }

    /// One pass over the points: normal equations of the reweighted squares and the sums that judge them.
    fn sums(&self, distances: &DistanceField, state: &Vector, widening: f32) -> Sums {
        let (sin, cos) = state[2].sin_cos();
        let (a, b) = (state[3], state[4]);
        let height = self.config.viewpoint_height;
        let per_height = 1.0 / height;
        let reach_squared = (self.config.reach_sigmas * widening).powi(2);
        let mut normal = [0.0_f32; 15];
        let mut gradient = [0.0_f32; PARAMETERS];
        let (mut weight, mut psi_squared, mut psi_slope) = (0.0, 0.0, 0.0);
        let (mut squares, mut deviations, mut score, mut inliers) = (0.0, 0.0, 0.0, 0.0);
        for point in &self.points {
            // MATH.md 2, "Tilt": where the point lies if the robot leant by (a, b).
            let stretch = height / (height - a * point.x - b * point.y).max(0.5 * height);
            let (x, y) = (
                (point.x + a * height) * stretch,
                (point.y + b * height) * stretch,
            );
            let (rx, ry) = (cos * x - sin * y, sin * x + cos * y);
            let near = distances.nearest(state[0] + rx, state[1] + ry);
            let [nx, ny] = near.normal;
            let radial = nx * rx + ny * ry;
            let variance = point.variance_across + point.variance_along * radial * radial;
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
            let squared = near.distance * near.distance * information;
            // e(t) with t in standard deviations: 1 − e = k²/(k² + t²).
            let kept = reach_squared / (reach_squared + squared);
            let root_weight = kept * kept;
            let factor = root_weight * information;
            weight += root_weight;
            psi_squared += root_weight * root_weight * squared;
            psi_slope += root_weight * (4.0 * kept - 3.0);
            squares += root_weight * near.distance * near.distance;
            deviations += near.distance.abs();
            score += kept;
            inliers += f32::from(u8::from(squared < reach_squared));
            let mut k = 0;
            for i in 0..PARAMETERS {
                let scaled = factor * row[i];
                gradient[i] += scaled * near.distance;
                for value in &row[i..] {
                    normal[k] += scaled * value;
                    k += 1;
                }
            }
        }
        Sums {
            normal: symmetric(&normal),
            gradient: Vector::from(gradient),
            weight,
            psi_squared,
            psi_slope,
            squares,
            deviations,
            score,
            inliers,
        }
    }

    /// The Gauss-Newton step under expectation and lean's prior; no step where the equations have no solution.
    fn step(&self, sums: &Sums, state: &Vector) -> Vector {
        let normal = sums.normal + self.expected.information;
        let gradient = sums.gradient + self.expected.information * self.deviation(state);
        let Some(cholesky) = normal.cholesky() else {
            return Vector::zeros();
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
    fn nothing_known(&self) -> Matrix5 {
        let mut information = Matrix5::from_diagonal_element(self.lean_information());
        information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&NOTHING_KNOWN);
        information
    }

    /// 1/σ² of the lean, bounded so that σ = 0 holds the robot upright.
    fn lean_information(&self) -> f32 {
        let std = self.config.lean_std_deg.to_radians();
        1.0 / (std * std).max(1e-10)
    }

    fn deviation(&self, state: &Vector) -> Vector {
        let expected = self.expected.pose;
        Vector::from([
            state[0] - expected.x,
            state[1] - expected.y,
            wrap_angle(state[2] - expected.theta),
            state[3],
            state[4],
        ])
    }

    fn conclude(&self, sums: &Sums, state: &Vector, steps: usize) -> Match {
        let count = self.points.len().max(1) as f32;
        // Covariance of an M-estimator: (Σψ²/Σw) / (Σψ′/Σw)² · (Σ w J Jᵀ)⁻¹, with the degrees of freedom that the
        // pose itself took. It scales with the residual, whatever the points claimed.
        let weight = sums.weight.max(1e-6);
        let freedom = (weight / (weight - 3.0).max(1.0)).max(1.0);
        let slope = (sums.psi_slope / weight).clamp(0.2, 1.0);
        let seen = sums.psi_squared / weight / (slope * slope) * freedom;
        let scale = ((seen * weight + CLAIMED) / (weight + CLAIMED)).clamp(0.1, 25.0);
        let normal = sums.normal / scale + self.expected.information;
        let with_lean = normal.try_inverse().unwrap_or_else(|| {
            let nothing = self.nothing_known().diagonal();
            Matrix5::from_diagonal(&nothing.map(|known| 1.0 / known))
        });
        let with_lean = (with_lean + with_lean.transpose()) * 0.5;
        let deviation = self.deviation(state);
        let reach_squared = self.config.reach_sigmas * self.config.reach_sigmas;
        Match {
            pose: Pose::new(state[0], state[1], state[2]),
            covariance: with_lean.fixed_view::<3, 3>(0, 0).into_owned(),
            strain: deviation.dot(&(self.expected.information * deviation)),
            lean: [state[3], state[4]],
            with_lean,
            residual: (sums.squares / weight).sqrt(),
            deviation: sums.deviations / count,
            inlier_share: sums.inliers / count,
            score: sums.score / count,
            cost: 0.5 * reach_squared * (self.points.len() as f32 - sums.score),
            steps,
        }
    }
}

/// The full matrix from its upper triangle, row by row.
fn symmetric(upper: &[f32; 15]) -> Normal {
    let mut full = Normal::zeros();
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
