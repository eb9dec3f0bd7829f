//! Which path of a kind explains a set of rays best, and how well does it?
//!
//! A ray says that the ball's offset from it is zero in two directions. Both are linear in position and velocity, so a
//! path is the solution of a linear least squares problem whose weights depend on the distance: three solutions in turn.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix};

use super::config::FlightConfig;
use super::ray::BallRay;
use crate::math;
use crate::sensors::attitude::GRAVITY;
use crate::stamp::Stamp;

/// How the ball moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BallMotionMode {
    /// It rolls or lies on the ground.
    Ground,
    /// It flies.
    Flight,
    /// It is held above the ground.
    Held,
}

/// Position of the ball's centre and its velocity at a time, with covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallMotionState {
    /// Time of the state.
    pub stamp: Stamp,
    /// x, y, z, metres, and their velocities, m/s.
    pub state: [f64; 6],
    /// Covariance of the state; zero for what the kind of motion fixes.
    pub covariance: SMatrix<f64, 6, 6>,
}

/// A fitted path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MotionFit {
    pub(super) state: BallMotionState,
    /// Logarithm of the probability of the rays, up to a constant that depends on the rays alone.
    pub(super) log_evidence: f64,
    /// Sum of squared normalized errors, outliers limited.
    pub(super) chi_squared: f64,
    /// Sum of squared normalized errors that each robot's rays share.
    pub(super) shared_errors: f64,
    /// Rays that are no outliers.
    pub(super) inliers: usize,
    /// Outliers in the newest third of the rays.
    pub(super) new_outliers: usize,
}

/// A ray with the robot that saw it, and the errors that this robot's rays share.
#[derive(Debug, Clone, Copy)]
pub(super) struct FitRay {
    pub(super) ray: BallRay,
    /// Index of the robot: its rays share one error of each angle.
    pub(super) robot: usize,
    /// Standard deviations of the shared errors of azimuth and elevation, radians.
    pub(super) bias_std: [f32; 2],
}

/// Where a path begins: where the one before it ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Anchor {
    pub(super) stamp: Stamp,
    at: [f64; 3],
    /// Inverse square root of its covariance.
    whitening: Matrix3<f64>,
    /// Centre of the prior of the position.
    centre: [f64; 2],
}

impl Anchor {
    /// None if the covariance is not positive definite.
    pub(super) fn new(
        stamp: Stamp,
        at: [f64; 3],
        covariance: Matrix3<f64>,
        centre: [f64; 2],
    ) -> Option<Self> {
        let whitening = covariance.cholesky()?.l().try_inverse()?;
        Some(Anchor {
            stamp,
            at,
            whitening,
            centre,
        })
    }
}

/// Prior standard deviations: of the position about the viewpoint and of the height, metres, and of velocities, m/s.
const POSITION_STD: f64 = 6.0;
const HEIGHT_MEAN: f64 = 0.8;
const HEIGHT_STD: f64 = 0.7;
const SPEED_STD: f64 = 4.0;
const VERTICAL_SPEED_STD: f64 = 3.5;
/// Largest and smallest distance that weights a ray, metres.
const DISTANCE_MAX: f64 = 20.0;
const DISTANCE_MIN: f64 = 0.3;
/// Solutions in turn.
const ITERATIONS: usize = 3;
/// Standard deviation of a distance by the apparent size that all rays of a robot share, share of the distance.
const SIZE_BIAS_STD: f64 = 0.15;
/// Errors that the rays of a robot share: azimuth, elevation, size.
const BIASES: usize = 3;
/// A path this far below the ground is less probable by e^(-1/2), metres.
const UNDERGROUND_STD: f64 = 0.05;

impl BallMotionMode {
    /// Numbers of the state that are estimated.
    fn free(self) -> &'static [usize] {
        match self {
            BallMotionMode::Ground => &[0, 1, 3, 4],
            BallMotionMode::Flight => &[0, 1, 2, 3, 4, 5],
            BallMotionMode::Held => &[0, 1, 2],
        }
    }
}

/// Displacement after `t` seconds besides position and velocity: gravity and drag, or rolling friction.
fn displacement(mode: BallMotionMode, state: &[f64; 6], t: f64, config: &FlightConfig) -> [f64; 3] {
    let [_, _, _, vx, vy, vz] = *state;
    match mode {
        BallMotionMode::Held => [0.0; 3],
        BallMotionMode::Ground => {
            let speed = math::hypot(vx, vy);
            if speed <= 1e-6 {
                return [0.0; 3];
            }
            // It stands still after it has stopped.
            let rolling = f64::from(config.rolling_deceleration).min(speed / t.abs().max(1e-9));
            let slower = -0.5 * rolling * t * t / speed;
            [slower * vx, slower * vy, 0.0]
        }
        BallMotionMode::Flight => {
            let gravity = f64::from(GRAVITY);
            // Drag at the velocity in the middle.
            let middle = [vx, vy, vz - 0.5 * gravity * t];
            let speed = math::hypot(math::hypot(middle[0], middle[1]), middle[2]).min(40.0);
            let drag = -0.5 * f64::from(config.drag) * speed * t * t;
            [
                drag * middle[0],
                drag * middle[1],
                drag * middle[2] - 0.5 * gravity * t * t,
            ]
        }
    }
}

impl BallMotionState {
    /// Position after `t` seconds.
    pub(super) fn position(&self, mode: BallMotionMode, t: f64, config: &FlightConfig) -> [f64; 3] {
        let added = displacement(mode, &self.state, t, config);
        std::array::from_fn(|axis| self.state[axis] + t * self.state[axis + 3] + added[axis])
    }
}

/// A ray's unit vectors and weights.
struct Direction {
    towards: [f64; 3],
    aside: [f64; 3],
    upwards: [f64; 3],
}

fn direction(ray: &BallRay) -> Direction {
    let (sin, cos) = math::sin_cos(f64::from(ray.azimuth));
    let (up, level) = math::sin_cos(f64::from(ray.elevation));
    Direction {
        towards: [level * cos, level * sin, up],
        aside: [-sin, cos, 0.0],
        upwards: [-up * cos, -up * sin, level],
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Normal equations of state and shared errors.
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    /// Adds the equation `Σ coefficients · unknowns = value` with a weight.
    fn add(&mut self, coefficients: &[(usize, f64)], value: f64, weight: f64) {
        for &(row, a) in coefficients {
            self.right[row] += weight * a * value;
            for &(column, b) in coefficients {
                self.matrix[(row, column)] += weight * a * b;
            }
        }
    }
}

/// The best path of a kind through rays in order of time; `start`: a state to begin with, at the last ray's time.
///
/// Without rays the result is that of the anchor alone, with which the probability of rays is compared.
pub(super) fn fit_motion(
    rays: &[FitRay],
    anchor: Option<&Anchor>,
    mode: BallMotionMode,
    start: Option<[f64; 6]>,
    config: &FlightConfig,
) -> Option<MotionFit> {
    let last = rays.last().map(|last| last.ray);
    let stamp = last
        .map(|last| last.stamp)
        .or(anchor.map(|anchor| anchor.stamp))?;
    let mut state = match (start, &last, anchor) {
        (Some(state), _, _) => state,
        (None, Some(last), _) => initial_state(last, mode, config),
        (None, None, anchor) => {
            let [x, y, z] = anchor?.at;
            [x, y, z, 0.0, 0.0, 0.0]
        }
    };
    if mode == BallMotionMode::Ground {
        (state[2], state[5]) = (f64::from(config.ball_radius), 0.0);
    }
    if mode == BallMotionMode::Held {
        state[3..].fill(0.0);
    }
    let mut problem = Problem::new(rays, anchor, stamp, mode, config);
    let mut solved = None;
    for _ in 0..ITERATIONS {
        solved = Some(problem.solve(&mut state)?);
    }
    let (covariance, log_determinant) = solved?;
    let quality = problem.quality(&state);
    let chi_squared = quality.chi_squared;
    let cost = chi_squared + quality.prior + quality.shared_errors + quality.underground;
    let log_evidence = 0.5 * (problem.prior_log_determinant() - log_determinant - cost);
    let finite = state.iter().all(|value| value.is_finite()) && log_evidence.is_finite();
    finite.then_some(MotionFit {
        state: BallMotionState {
            stamp,
            state,
            covariance,
        },
        log_evidence,
        chi_squared,
        shared_errors: quality.shared_errors,
        inliers: quality.inliers,
        new_outliers: quality.new_outliers,
    })
}

/// A ball on the ground on the ray, or some metres away if the ray does not meet the ground.
fn initial_state(ray: &BallRay, mode: BallMotionMode, config: &FlightConfig) -> [f64; 6] {
    let towards = direction(ray).towards;
    let origin = ray.origin.map(f64::from);
    let height = match mode {
        BallMotionMode::Ground => f64::from(config.ball_radius),
        _ => 0.5 * origin[2],
    };
    let distance = match ray.distance {
        Some([distance, _]) => f64::from(distance),
        None if towards[2] < -0.02 => (height - origin[2]) / towards[2],
        None => 4.0,
    };
    let distance = distance.clamp(DISTANCE_MIN, DISTANCE_MAX);
    let at: [f64; 3] = std::array::from_fn(|axis| origin[axis] + distance * towards[axis]);
    [at[0], at[1], at[2], 0.0, 0.0, 0.0]
}

/// The equations of a set of rays.
struct Problem<'a> {
    rays: &'a [FitRay],
    anchor: Option<&'a Anchor>,
    /// Time of the anchor relative to the state's.
    anchor_time: f64,
    directions: Vec<Direction>,
    times: Vec<f64>,
    mode: BallMotionMode,
    config: &'a FlightConfig,
    /// Column of each number of the state.
    column: [Option<usize>; 6],
    unknowns: usize,
    first_bias: usize,
    /// Prior variances of the shared errors of each robot that occurs.
    bias_variances: Vec<Option<[f64; BIASES]>>,
    /// Shared errors of each robot.
    biases: Vec<[f64; BIASES]>,
    prior_mean: [f64; 6],
    prior_variance: [f64; 6],
}

/// How well a state explains the rays.
struct Quality {
    chi_squared: f64,
    prior: f64,
    shared_errors: f64,
    underground: f64,
    inliers: usize,
    new_outliers: usize,
}

impl<'a> Problem<'a> {
    fn new(
        rays: &'a [FitRay],
        anchor: Option<&'a Anchor>,
        stamp: Stamp,
        mode: BallMotionMode,
        config: &'a FlightConfig,
    ) -> Self {
        let mut column = [None; 6];
        for (index, &number) in mode.free().iter().enumerate() {
            column[number] = Some(index);
        }
        let robots = rays.iter().map(|ray| ray.robot + 1).max().unwrap_or(0);
        let mut bias_variances = vec![None; robots];
        for ray in rays {
            let [azimuth, elevation] = ray.bias_std.map(|std| f64::from(std * std).max(1e-12));
            let size = SIZE_BIAS_STD * SIZE_BIAS_STD;
            bias_variances[ray.robot] = Some([azimuth, elevation, size]);
        }
        let [x, y] = match (anchor, rays.last()) {
            (Some(anchor), _) => anchor.centre,
            (None, Some(last)) => [last.ray.origin[0], last.ray.origin[1]].map(f64::from),
            (None, None) => [0.0; 2],
        };
        let square = |value: f64| value * value;
        Problem {
            rays,
            anchor,
            anchor_time: anchor.map_or(0.0, |anchor| stamp.seconds_until(anchor.stamp)),
            directions: rays.iter().map(|ray| direction(&ray.ray)).collect(),
            times: rays
                .iter()
                .map(|ray| stamp.seconds_until(ray.ray.stamp))
                .collect(),
            mode,
            config,
            column,
            first_bias: mode.free().len(),
            unknowns: mode.free().len() + BIASES * robots,
            biases: vec![[0.0; BIASES]; robots],
            bias_variances,
            prior_mean: [x, y, HEIGHT_MEAN, 0.0, 0.0, 0.0],
            prior_variance: [
                square(POSITION_STD),
                square(POSITION_STD),
                square(HEIGHT_STD),
                square(SPEED_STD),
                square(SPEED_STD),
                square(VERTICAL_SPEED_STD),
            ],
        }
    }

    /// Logarithm of the determinant of the prior's information.
    fn prior_log_determinant(&self) -> f64 {
        let free = self.mode.free().iter();
        let state = free.map(|&number| -math::ln(self.prior_variance[number]));
        let biases = self.bias_variances.iter().flat_map(|variances| {
            variances
                .unwrap_or([1.0; BIASES])
                .map(|variance| -math::ln(variance))
        });
        state.sum::<f64>() + biases.sum::<f64>()
    }

    /// Solves once, with weights and curvature of `state`; returns its covariance and the determinant's logarithm.
    fn solve(&mut self, state: &mut [f64; 6]) -> Option<(SMatrix<f64, 6, 6>, f64)> {
        let mut normal = Normal {
            matrix: DMatrix::zeros(self.unknowns, self.unknowns),
            right: DVector::zeros(self.unknowns),
        };
        for &number in self.mode.free() {
            if let Some(column) = self.column[number] {
                let weight = 1.0 / self.prior_variance[number];
                normal.add(&[(column, 1.0)], self.prior_mean[number], weight);
            }
        }
        for (robot, variances) in self.bias_variances.iter().enumerate() {
            for (angle, variance) in variances.unwrap_or([1.0; BIASES]).into_iter().enumerate() {
                let column = self.first_bias + BIASES * robot + angle;
                normal.add(&[(column, 1.0)], 0.0, 1.0 / variance);
            }
        }
        for index in 0..self.rays.len() {
            self.add_ray(&mut normal, state, index);
        }
        self.add_anchor(&mut normal, state);
        let cholesky = normal.matrix.cholesky()?;
        let log_determinant = 2.0
            * cholesky
                .l_dirty()
                .diagonal()
                .iter()
                .map(|&l| math::ln(l))
                .sum::<f64>();
        let solution = cholesky.solve(&normal.right);
        let inverse = cholesky.inverse();
        let mut covariance = SMatrix::<f64, 6, 6>::zeros();
        for (a, &row) in self.mode.free().iter().enumerate() {
            state[row] = solution[a];
            for (b, &column) in self.mode.free().iter().enumerate() {
                covariance[(row, column)] = inverse[(a, b)];
            }
        }
        for (robot, biases) in self.biases.iter_mut().enumerate() {
            *biases = [0, 1, 2].map(|angle| solution[self.first_bias + BIASES * robot + angle]);
        }
        Some((covariance, log_determinant))
    }

    /// Errors of a ray in units of its standard deviations: azimuth, elevation, distance.
    fn errors(&self, state: &[f64; 6], index: usize) -> [f64; 3] {
        let FitRay { ray, robot, .. } = &self.rays[index];
        let direction = &self.directions[index];
        let offset = self.offset(state, index);
        let (level, distance) = distances(offset);
        let [azimuth, elevation, size] = self.biases[*robot];
        [
            (dot(direction.aside, offset) / level + azimuth) / f64::from(ray.azimuth_std),
            (dot(direction.upwards, offset) / distance + elevation) / f64::from(ray.elevation_std),
            ray.distance.map_or(0.0, |[measured, std]| {
                (dot(direction.towards, offset) - f64::from(measured) * (1.0 + size))
                    / f64::from(std)
            }),
        ]
    }

    /// Vector from the viewpoint to the ball.
    fn offset(&self, state: &[f64; 6], index: usize) -> [f64; 3] {
        let time = self.times[index];
        let added = displacement(self.mode, state, time, self.config);
        let origin = self.rays[index].ray.origin;
        std::array::from_fn(|axis| {
            state[axis] + time * state[axis + 3] + added[axis] - f64::from(origin[axis])
        })
    }

    fn is_outlier(&self, errors: [f64; 3]) -> bool {
        let limit = f64::from(self.config.outlier_sigmas);
        // Of a few rays none can be told to be the wrong one.
        self.rays.len() > 4 && errors.iter().any(|error| error.abs() > limit)
    }

    fn add_ray(&self, normal: &mut Normal, state: &[f64; 6], index: usize) {
        if self.is_outlier(self.errors(state, index)) {
            return;
        }
        let FitRay { ray, robot, .. } = &self.rays[index];
        let direction = &self.directions[index];
        let time = self.times[index];
        let (level, distance) = distances(self.offset(state, index));
        let added = displacement(self.mode, state, time, self.config);
        let bias = self.first_bias + BIASES * robot;
        let mut equation =
            |axis: [f64; 3], scale: f64, std: f64, bias: (usize, f64), target: f64| {
                let mut value = target;
                let mut coefficients = Vec::with_capacity(7);
                for (number, fixed) in state.iter().enumerate() {
                    let part = axis[number % 3] * scale * if number < 3 { 1.0 } else { time };
                    match self.column[number] {
                        Some(column) => coefficients.push((column, part)),
                        None => value -= part * fixed,
                    }
                }
                for (number, part) in axis.into_iter().enumerate() {
                    value -= part * scale * (added[number] - f64::from(ray.origin[number]));
                }
                coefficients.push(bias);
                normal.add(&coefficients, value, 1.0 / (std * std));
            };
        let (azimuth_std, elevation_std) =
            (f64::from(ray.azimuth_std), f64::from(ray.elevation_std));
        equation(direction.aside, 1.0 / level, azimuth_std, (bias, 1.0), 0.0);
        equation(
            direction.upwards,
            1.0 / distance,
            elevation_std,
            (bias + 1, 1.0),
            0.0,
        );
        if let Some([measured, std]) = ray.distance.map(|pair| pair.map(f64::from)) {
            equation(direction.towards, 1.0, std, (bias + 2, -measured), measured);
        }
    }

    /// The path passes the anchor.
    fn add_anchor(&self, normal: &mut Normal, state: &[f64; 6]) {
        let Some(anchor) = self.anchor else { return };
        let added = displacement(self.mode, state, self.anchor_time, self.config);
        for row in 0..3 {
            let (mut coefficients, mut value) = (Vec::with_capacity(6), 0.0);
            for (axis, added) in added.into_iter().enumerate() {
                let weight = anchor.whitening[(row, axis)];
                value += weight * (anchor.at[axis] - added);
                for (number, factor) in [(axis, 1.0), (axis + 3, self.anchor_time)] {
                    match self.column[number] {
                        Some(column) => coefficients.push((column, weight * factor)),
                        None => value -= weight * factor * state[number],
                    }
                }
            }
            normal.add(&coefficients, value, 1.0);
        }
    }

    fn anchor_cost(&self, state: &[f64; 6]) -> f64 {
        let Some(anchor) = self.anchor else {
            return 0.0;
        };
        let added = displacement(self.mode, state, self.anchor_time, self.config);
        let off = nalgebra::Vector3::from_fn(|axis, _| {
            state[axis] + self.anchor_time * state[axis + 3] + added[axis] - anchor.at[axis]
        });
        (anchor.whitening * off).norm_squared()
    }

    fn quality(&self, state: &[f64; 6]) -> Quality {
        let limit = f64::from(self.config.outlier_sigmas);
        let (mut chi_squared, mut inliers, mut new_outliers) = (0.0, 0, 0);
        for index in 0..self.rays.len() {
            let errors = self.errors(state, index);
            let squared: f64 = errors.iter().map(|error| error * error).sum();
            if self.is_outlier(errors) {
                chi_squared += squared.min(limit * limit);
                new_outliers += usize::from(3 * index >= 2 * self.rays.len());
            } else {
                (chi_squared, inliers) = (chi_squared + squared, inliers + 1);
            }
        }
        let mut prior = self.anchor_cost(state);
        for &number in self.mode.free() {
            let off = state[number] - self.prior_mean[number];
            prior += off * off / self.prior_variance[number];
        }
        let mut shared_errors = 0.0;
        for (biases, variances) in self.biases.iter().zip(&self.bias_variances) {
            for (bias, variance) in biases.iter().zip(variances.unwrap_or([1.0; BIASES])) {
                shared_errors += bias * bias / variance;
            }
        }
        let ground = f64::from(self.config.ball_radius);
        let below = |index: usize| {
            let height = self.offset(state, index)[2] + f64::from(self.rays[index].ray.origin[2]);
            (ground - height).max(0.0) / UNDERGROUND_STD
        };
        let (first, last) = match self.rays.len() {
            0 => (0.0, 0.0),
            count => (below(0), below(count - 1)),
        };
        Quality {
            chi_squared,
            prior,
            shared_errors,
            underground: first * first + last * last,
            inliers,
            new_outliers,
        }
    }
}

/// Horizontal and whole length of a vector, limited so that no weight is extreme.
fn distances([x, y, z]: [f64; 3]) -> (f64, f64) {
    let level = math::hypot(x, y);
    let whole = math::hypot(level, z);
    (
        level.clamp(DISTANCE_MIN, DISTANCE_MAX),
        whole.clamp(DISTANCE_MIN, DISTANCE_MAX),
    )
}

/// Mean and covariance of states by the logarithms of their probabilities; all are of one time.
pub(super) fn mix(
    states: impl Iterator<Item = (f64, BallMotionState)> + Clone,
) -> Option<BallMotionState> {
    let largest = states.clone().map(|(log_probability, _)| log_probability);
    let largest = largest.fold(f64::NEG_INFINITY, f64::max);
    let (_, first) = states.clone().next()?;
    let (mut all, mut mean) = (0.0, [0.0; 6]);
    for (log_probability, state) in states.clone() {
        let weight = math::exp(log_probability - largest);
        all += weight;
        for (sum, value) in mean.iter_mut().zip(state.state) {
            *sum += weight * value;
        }
    }
    let mean = mean.map(|sum| sum / all);
    let mut covariance = SMatrix::<f64, 6, 6>::zeros();
    for (log_probability, state) in states {
        let weight = math::exp(log_probability - largest) / all;
        let off = SMatrix::<f64, 6, 1>::from_fn(|axis, _| state.state[axis] - mean[axis]);
        covariance += (state.covariance + off * off.transpose()) * weight;
    }
    Some(BallMotionState {
        stamp: first.stamp,
        state: mean,
        covariance,
    })
}
