//! Where is the ball on one path of one kind? A Kalman filter of its state and of the errors that a robot's rays share.
//!
//! A ray says that the ball's offset from it is zero in two directions. Both are linear in the position, and only their
//! weights depend on the distance. Shared errors decay: tilt and pose change while a ball is followed.

use nalgebra::SMatrix;

use super::config::FlightConfig;
use super::motion::{BallMotionMode, BallMotionState};
use super::ray::RobotRay;
use super::ray_rows::{DISTANCE_MIN, RayGeometry, Row, direction, distances_to, dot, ray_rows};
use crate::math;
use crate::stamp::Stamp;

/// Numbers of the ball's state: position and velocity.
const STATE: usize = 6;
/// Errors that the rays of a robot share: azimuth, elevation, size. In units of their standard deviations.
const BIASES: usize = 3;
/// Time constant of the error of the size, seconds.
const SIZE_BIAS_TIME: f64 = 10.0;
/// Logarithm of the density of an outlier: one ray in a hundred, anywhere around, within a radian of elevation.
const OUTLIER_LOG_DENSITY: f64 = -6.4;
/// Angle between the ray and the expected ball above which the derivatives are not those of the expected place.
const NEAR_ANGLE: f64 = 0.1;
/// Change of the distance by an update above which the update is repeated with the new weights.
const DISTANCE_CHANGE: f64 = 0.1;

/// Gaussian of the ball's state and of the shared errors of each robot.
#[derive(Debug, Clone)]
pub(super) struct PathFilter {
    pub(super) mode: BallMotionMode,
    pub(super) stamp: Stamp,
    mean: Vec<f64>,
    /// Row by row.
    covariance: Vec<f64>,
}

/// What a kick or an impact does to the velocity: v = kept·v₀ + added, with variances of the sum.
#[derive(Debug, Clone, Copy)]
pub(super) struct VelocityChange {
    pub(super) kept: [f64; 3],
    /// m/s.
    pub(super) added: [f64; 3],
    /// m²/s².
    pub(super) variances: [f64; 3],
}

/// How well a ray agrees with a path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Agreement {
    /// Logarithm of the probability density of the ray.
    pub(super) log_density: f64,
    /// Logarithm of the density of a ray without error.
    pub(super) log_peak: f64,
    /// Sum of squared normalized errors.
    pub(super) nis: f64,
    /// The errors are beyond the limit, and the path ignores the ray.
    pub(super) is_outlier: bool,
}

impl PathFilter {
    /// A path with independent position and velocity; `robots`: number of robots whose shared errors are estimated.
    ///
    /// Variances of zero state what the kind of motion fixes.
    pub(super) fn new(
        mode: BallMotionMode,
        stamp: Stamp,
        mean: [f64; STATE],
        variances: [f64; STATE],
        robots: usize,
    ) -> Self {
        let mut filter = PathFilter {
            mode,
            stamp,
            mean: mean.to_vec(),
            covariance: vec![0.0; STATE * STATE],
        };
        for (index, variance) in variances.into_iter().enumerate() {
            filter.covariance[STATE * index + index] = variance;
        }
        filter.include_robots(robots);
        filter
    }

    /// The ball's state alone.
    pub(super) fn state(&self) -> BallMotionState {
        BallMotionState {
            stamp: self.stamp,
            state: std::array::from_fn(|index| self.mean[index]),
            covariance: SMatrix::from_fn(|row, column| self.p(row, column)),
        }
    }

    pub(super) fn position(&self) -> [f64; 3] {
        [self.mean[0], self.mean[1], self.mean[2]]
    }

    pub(super) fn velocity(&self) -> [f64; 3] {
        [self.mean[3], self.mean[4], self.mean[5]]
    }

    /// Mean squares of the velocity's components, m²/s².
    pub(super) fn squared_velocity(&self) -> [f64; 3] {
        [3, 4, 5].map(|index| self.mean[index] * self.mean[index] + self.p(index, index))
    }

    /// Standard deviation of the height, metres.
    pub(super) fn height_std(&self) -> f64 {
        self.p(2, 2).max(0.0).sqrt()
    }

    fn size(&self) -> usize {
        self.mean.len()
    }

    fn p(&self, row: usize, column: usize) -> f64 {
        self.covariance[self.size() * row + column]
    }

    fn p_mut(&mut self, row: usize, column: usize) -> &mut f64 {
        let size = self.size();
        &mut self.covariance[size * row + column]
    }

    /// Adds the shared errors of robots up to this number.
    pub(super) fn include_robots(&mut self, robots: usize) {
        let (old, new) = (self.size(), STATE + BIASES * robots);
        if new <= old {
            return;
        }
        let mut covariance = vec![0.0; new * new];
        for (to, from) in covariance
            .chunks_exact_mut(new)
            .zip(self.covariance.chunks_exact(old))
        {
            to[..old].copy_from_slice(from);
        }
        for index in old..new {
            covariance[new * index + index] = 1.0;
        }
        self.covariance = covariance;
        self.mean.resize(new, 0.0);
    }

    /// Moves the path to a time.
    pub(super) fn predict(&mut self, stamp: Stamp, config: &FlightConfig) {
        let t = self.stamp.seconds_until(stamp);
        self.stamp = stamp;
        if t <= 0.0 {
            return;
        }
        let noise = self.mode.noise(&self.mean);
        let kept = self.mode.velocity_kept(t);
        self.mode.advance(&mut self.mean, t, config);
        let size = self.size();
        let (positions, rest) = self.covariance.split_at_mut(3 * size);
        for (position, velocity) in positions.iter_mut().zip(&mut rest[..3 * size]) {
            *position += t * *velocity;
            *velocity *= kept;
        }
        for row in self.covariance.chunks_exact_mut(size) {
            for axis in 0..3 {
                row[axis] += t * row[axis + 3];
                row[axis + 3] *= kept;
            }
        }
        // On the ground the height is known.
        let axes = if self.mode == BallMotionMode::Ground {
            2
        } else {
            3
        };
        for axis in 0..axes {
            *self.p_mut(axis, axis) += noise * t * t * t / 3.0;
            *self.p_mut(axis, axis + 3) += noise * t * t / 2.0;
            *self.p_mut(axis + 3, axis) += noise * t * t / 2.0;
            *self.p_mut(axis + 3, axis + 3) += noise * t;
        }
        self.decay_biases(t, config);
    }

    /// Shared errors are Gauss-Markov processes.
    fn decay_biases(&mut self, t: f64, config: &FlightConfig) {
        let size = self.size();
        let angles = math::exp(-t / f64::from(config.bearing_bias_time));
        let sizes = math::exp(-t / SIZE_BIAS_TIME);
        for bias in STATE..size {
            let decay = if (bias - STATE) % BIASES == 2 {
                sizes
            } else {
                angles
            };
            self.mean[bias] *= decay;
            for value in &mut self.covariance[size * bias..size * (bias + 1)] {
                *value *= decay;
            }
            for row in self.covariance.chunks_exact_mut(size) {
                row[bias] *= decay;
            }
            *self.p_mut(bias, bias) += 1.0 - decay * decay;
        }
    }

    /// The path after an impact or a kick at any moment between `before` and now.
    pub(super) fn after_change(
        before: &PathFilter,
        stamp: Stamp,
        mode: BallMotionMode,
        change: &VelocityChange,
        config: &FlightConfig,
    ) -> Self {
        let t = before.stamp.seconds_until(stamp).max(0.0);
        let mut after = before.clone();
        after.mode = mode;
        after.stamp = stamp;
        let size = after.size();
        // p = p₀ + u·v₀ + (t − u)·v with the moment u between 0 and t, on average in the middle.
        let half = 0.5 * t;
        for (axis, kept) in change.kept.into_iter().enumerate() {
            let old = before.mean[axis + 3];
            let new = kept * old + change.added[axis];
            after.mean[axis] += half * (old + new);
            after.mean[axis + 3] = new;
            for index in 0..size {
                let velocity = after.p(axis + 3, index);
                *after.p_mut(axis, index) += half * (1.0 + kept) * velocity;
                *after.p_mut(axis + 3, index) = kept * velocity;
            }
            for index in 0..size {
                let velocity = after.p(index, axis + 3);
                *after.p_mut(index, axis) += half * (1.0 + kept) * velocity;
                *after.p_mut(index, axis + 3) = kept * velocity;
            }
            let variance = change.variances[axis];
            let moment = t * t / 12.0 * (new - old) * (new - old);
            *after.p_mut(axis, axis) += moment + variance * t * t / 3.0;
            *after.p_mut(axis, axis + 3) += half * variance;
            *after.p_mut(axis + 3, axis) += half * variance;
            *after.p_mut(axis + 3, axis + 3) += variance;
        }
        if mode == BallMotionMode::Ground {
            after.fix(2, f64::from(config.ball_radius));
            after.fix(5, 0.0);
        }
        after.decay_biases(t, config);
        after
    }

    /// States that the height is that of a ball on the ground, with a standard deviation; the squared normalized error.
    pub(super) fn touch_ground(&mut self, std: f64, config: &FlightConfig) -> f64 {
        let row = Row {
            axis: [0.0, 0.0, 1.0],
            bias: (0, 0.0),
            value: f64::from(config.ball_radius),
            variance: std * std,
        };
        let (innovation, variance) = self.apply(&row);
        innovation * innovation / variance
    }

    fn fix(&mut self, index: usize, value: f64) {
        let size = self.size();
        self.mean[index] = value;
        self.covariance[size * index..size * (index + 1)].fill(0.0);
        for row in self.covariance.chunks_exact_mut(size) {
            row[index] = 0.0;
        }
    }

    /// Updates the path by a ray of its time, unless the ray is an outlier; `robot`: place of the robot's shared errors.
    pub(super) fn update(
        &mut self,
        ray: &RobotRay,
        robot: usize,
        config: &FlightConfig,
    ) -> Agreement {
        let prior = (self.mean.clone(), self.covariance.clone());
        let at = self.position();
        let before = distances_to(at, ray);
        let limit = f64::from(config.outlier_sigmas);
        let [level, _] = before;
        let offset: [f64; 3] =
            std::array::from_fn(|axis| at[axis] - f64::from(ray.ray.origin[axis]));
        let measured = direction(f64::from(ray.ray.azimuth), f64::from(ray.ray.elevation));
        let is_ahead = dot(measured.towards, offset) > 0.0;
        let across = math::hypot(dot(measured.aside, offset), dot(measured.upwards, offset));
        // Far from the ray the directions of the ray itself are used: the error is then linear in the position.
        let near = is_ahead && across < NEAR_ANGLE * level;
        let mut agreement = self.update_once(at, near, ray, robot, config);
        if agreement.nis > limit * limit {
            (self.mean, self.covariance) = prior;
            agreement.is_outlier = true;
            agreement.log_density =
                (agreement.log_peak - 0.5 * limit * limit).min(OUTLIER_LOG_DENSITY);
            return agreement;
        }
        let after = distances_to(self.position(), ray);
        if !near || (after[1] / before[1] - 1.0).abs() > DISTANCE_CHANGE {
            let at = self.position();
            (self.mean, self.covariance) = prior;
            agreement = self.update_once(at, true, ray, robot, config);
        }
        let ahead: [f64; 3] =
            std::array::from_fn(|axis| self.mean[axis] - f64::from(ray.ray.origin[axis]));
        if dot(measured.towards, ahead) < DISTANCE_MIN {
            // No ball is within the robot.
            agreement.is_outlier = true;
            agreement.log_density -= 0.5 * limit * limit;
        }
        agreement
    }

    fn update_once(
        &mut self,
        at: [f64; 3],
        near: bool,
        ray: &RobotRay,
        robot: usize,
        config: &FlightConfig,
    ) -> Agreement {
        let mut agreement = Agreement {
            log_density: 0.0,
            log_peak: 0.0,
            nis: 0.0,
            is_outlier: false,
        };
        let geometry = RayGeometry {
            at,
            velocity: self.velocity(),
            near,
        };
        let first = STATE + BIASES * robot;
        for row in ray_rows(&geometry, ray, first, config)
            .into_iter()
            .flatten()
        {
            let (innovation, variance) = self.apply(&row);
            let squared = innovation * innovation / variance;
            agreement.nis += squared;
            agreement.log_peak -= 0.5 * math::ln(std::f64::consts::TAU * variance);
        }
        agreement.log_density = agreement.log_peak - 0.5 * agreement.nis;
        agreement
    }

    /// Updates by one number; its innovation and the variance of it.
    fn apply(&mut self, row: &Row) -> (f64, f64) {
        let size = self.size();
        let [x, y, z] = row.axis;
        let (bias, coefficient) = row.bias;
        let product =
            |line: &[f64]| x * line[0] + y * line[1] + z * line[2] + coefficient * line[bias];
        let gains: Vec<f64> = self.covariance.chunks_exact(size).map(product).collect();
        let innovation = row.value - product(&self.mean);
        let variance = (product(&gains) + row.variance).max(1e-12);
        for (value, gain) in self.mean.iter_mut().zip(&gains) {
            *value += gain * innovation / variance;
        }
        for (line, gain) in self.covariance.chunks_exact_mut(size).zip(&gains) {
            let factor = gain / variance;
            for (value, other) in line.iter_mut().zip(&gains) {
                *value -= factor * other;
            }
        }
        (innovation, variance)
    }
}
