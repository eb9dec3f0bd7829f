//! Motion of a tracked object: it rolls on, or was kicked in one of the last images (docs/methods.md 11.2).

use nalgebra::{Matrix3, Matrix4, Matrix4x3, Vector2, Vector4};

use super::config::ObjectTrackConfig;
use super::observation::{Measurement, OdometryFrame};
use crate::frames::At;
use crate::math;

/// Position and velocity (x, y, vx, vy): metres, m/s.
pub(super) type MotionState = Vector4<f32>;

/// Largest number of branches. The two oldest become one, since the images after a kick have decided whether there was one.
const BRANCHES_MAX: usize = 5;

/// A branch that is less probable is dropped.
const WEIGHT_MIN: f32 = 1e-4;

/// Longest time without a detection for which a kick is a branch of its own, seconds. An older one widens the covariance.
const KICK_PENDING_MAX: f32 = 0.1;

/// The deviation of a measurement.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gating {
    /// Squared Mahalanobis distance from the nearest branch.
    pub(super) mahalanobis_squared: f32,
    /// −2 times the logarithm of the likelihood. It includes the determinant, so that an uncertain motion does not take all
    /// measurements.
    pub(super) cost: f32,
}

/// Kalman filters that differ in the image of the last kick, the oldest first.
#[derive(Debug, Clone)]
pub(super) struct ObjectMotion {
    branches: Vec<Branch>,
    /// Time since the last measurement, in which it may have been kicked, seconds.
    kick_pending: f32,
}

#[derive(Debug, Clone)]
struct Branch {
    weight: f32,
    state: MotionState,
    covariance: Matrix4<f32>,
}

/// A branch after a measurement, not yet weighed against the others.
struct Updated {
    branch: Branch,
    /// Natural logarithm of prior probability times likelihood, without common constants.
    log_weight: f32,
    mahalanobis_squared: f32,
}

impl ObjectMotion {
    /// From the first measurement; its velocity is unknown.
    pub(super) fn new(measurement: &Measurement, config: &ObjectTrackConfig) -> Self {
        let mut covariance = Matrix4::zeros();
        covariance
            .fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&measurement.covariance);
        let speed = config.initial_speed_std * config.initial_speed_std;
        (covariance[(2, 2)], covariance[(3, 3)]) = (speed, speed);
        ObjectMotion {
            branches: vec![Branch {
                weight: 1.0,
                state: MotionState::new(measurement.at.x, measurement.at.y, 0.0, 0.0),
                covariance,
            }],
            kick_pending: 0.0,
        }
    }

    /// Predicts position and velocity with rolling friction and adds process noise.
    pub(super) fn predict(&mut self, seconds: f32, config: &ObjectTrackConfig) {
        if self.kick_pending + seconds > KICK_PENDING_MAX {
            let kick = kick_covariance(self.kick_pending, config)
                * kick_probability(self.kick_pending, config);
            for branch in &mut self.branches {
                branch.covariance += kick;
            }
            self.kick_pending = 0.0;
        }
        for branch in &mut self.branches {
            branch.predict(seconds, config);
        }
        self.kick_pending += seconds;
    }

    /// Adds the error of the robot's own motion, which ended at `robot`: its `covariance` (x, y, θ) in the axes of the odometry
    /// frame. A turn moves what is far, and turns velocities.
    pub(super) fn add_motion_noise(&mut self, robot: At<OdometryFrame>, covariance: &Matrix3<f32>) {
        for branch in &mut self.branches {
            branch.add_motion_noise(robot, covariance);
        }
    }

    /// The deviation of a measurement; infinite if the innovation covariances are singular.
    pub(super) fn gating(&self, measurement: &Measurement, config: &ObjectTrackConfig) -> Gating {
        let updated = self.updated(measurement, config);
        Gating {
            mahalanobis_squared: updated
                .iter()
                .map(|updated| updated.mahalanobis_squared)
                .fold(f32::INFINITY, f32::min),
            cost: -2.0 * log_likelihood(&updated),
        }
    }

    /// Kalman update of each branch, and of the branches' probabilities. False if it is impossible: singular, or infinitely far.
    pub(super) fn update(&mut self, measurement: &Measurement, config: &ObjectTrackConfig) -> bool {
        let updated = self.updated(measurement, config);
        let log_likelihood = log_likelihood(&updated);
        if !log_likelihood.is_finite() {
            return false;
        }
        self.branches.clear();
        self.branches
            .extend(updated.into_iter().filter_map(|updated| {
                let weight = math::exp(updated.log_weight - log_likelihood);
                (weight >= WEIGHT_MIN).then_some(Branch {
                    weight,
                    ..updated.branch
                })
            }));
        if self.branches.len() > BRANCHES_MAX {
            let oldest = self.branches.remove(0);
            self.branches[0].merge(&oldest);
        }
        self.kick_pending = 0.0;
        true
    }

    /// Of the most probable branch.
    pub(super) fn state(&self) -> &MotionState {
        &self.most_probable().state
    }

    /// Mean square deviation from the state, over all branches and a possible kick since the last measurement.
    pub(super) fn covariance(&self, config: &ObjectTrackConfig) -> Matrix4<f32> {
        let state = self.state();
        let sum: f32 = self.branches.iter().map(|branch| branch.weight).sum();
        let spread: Matrix4<f32> = self
            .branches
            .iter()
            .map(|branch| branch.spread_about(state) * (branch.weight / sum))
            .sum();
        spread
            + kick_covariance(self.kick_pending, config)
                * kick_probability(self.kick_pending, config)
    }

    fn most_probable(&self) -> &Branch {
        let (first, others) = self.branches.split_first().expect("one branch at least");
        others.iter().fold(first, |best, branch| {
            if branch.weight > best.weight {
                branch
            } else {
                best
            }
        })
    }

    /// Each branch after a measurement, and the most probable one with a kick since the last; without singular ones.
    fn updated(&self, measurement: &Measurement, config: &ObjectTrackConfig) -> Vec<Updated> {
        let kick = kick_probability(self.kick_pending, config);
        let mut updated = Vec::with_capacity(self.branches.len() + 1);
        updated.extend(
            self.branches
                .iter()
                .filter_map(|branch| branch.updated(measurement, branch.weight * (1.0 - kick))),
        );
        if kick > 0.0 {
            let mut kicked = self.most_probable().clone();
            kicked.covariance += kick_covariance(self.kick_pending, config);
            updated.extend(kicked.updated(measurement, kick));
        }
        updated
    }
}

impl Branch {
    fn predict(&mut self, seconds: f32, config: &ObjectTrackConfig) {
        let velocity = Vector2::new(self.state.z, self.state.w);
        let displacement = rolling_displacement(velocity, seconds, config.deceleration);
        let speed = velocity.norm();
        let remaining_speed = (speed - config.deceleration * seconds).max(0.0);
        let slowdown = if speed > 0.0 {
            remaining_speed / speed
        } else {
            0.0
        };
        self.state = MotionState::new(
            self.state.x + displacement.x,
            self.state.y + displacement.y,
            self.state.z * slowdown,
            self.state.w * slowdown,
        );
        let mut transition = Matrix4::identity();
        (transition[(0, 2)], transition[(1, 3)]) = (seconds, seconds);
        // White acceleration noise: independent of the number of steps.
        let q = config.acceleration_noise * config.acceleration_noise;
        self.covariance = transition * self.covariance * transition.transpose()
            + by_axis(
                q * seconds.powi(3) / 3.0,
                q * seconds * seconds / 2.0,
                q * seconds,
            );
    }

    fn add_motion_noise(&mut self, robot: At<OdometryFrame>, covariance: &Matrix3<f32>) {
        let (x, y) = (self.state.x - robot.x, self.state.y - robot.y);
        let jacobian = Matrix4x3::new(
            1.0,
            0.0,
            -y,
            0.0,
            1.0,
            x,
            0.0,
            0.0,
            -self.state.w,
            0.0,
            0.0,
            self.state.z,
        );
        self.covariance += jacobian * covariance * jacobian.transpose();
    }

    /// Kalman update; `prior`: probability of this branch. None if the innovation covariance is singular.
    fn updated(&self, measurement: &Measurement, prior: f32) -> Option<Updated> {
        let innovation = Vector2::new(
            measurement.at.x - self.state.x,
            measurement.at.y - self.state.y,
        );
        let innovation_covariance =
            self.covariance.fixed_view::<2, 2>(0, 0) + measurement.covariance;
        let inverse = innovation_covariance.try_inverse()?;
        let mahalanobis_squared = (innovation.transpose() * inverse * innovation).x;
        let determinant = innovation_covariance.determinant().max(f32::MIN_POSITIVE);
        let gain = self.covariance.fixed_view::<4, 2>(0, 0) * inverse;
        let position_rows = self.covariance.fixed_view::<2, 4>(0, 0);
        let reduced = self.covariance - gain * position_rows;
        Some(Updated {
            branch: Branch {
                weight: prior,
                state: self.state + gain * innovation,
                covariance: (reduced + reduced.transpose()) * 0.5,
            },
            log_weight: math::ln(prior) - (mahalanobis_squared + math::ln(determinant)) / 2.0,
            mahalanobis_squared,
        })
    }

    /// Becomes the Gaussian with the mean and the covariance of both.
    fn merge(&mut self, other: &Branch) {
        let weight = self.weight + other.weight;
        let state = (self.state * self.weight + other.state * other.weight) / weight;
        self.covariance = (self.spread_about(&state) * self.weight
            + other.spread_about(&state) * other.weight)
            / weight;
        (self.state, self.weight) = (state, weight);
    }

    /// Mean square deviation from a state.
    fn spread_about(&self, state: &MotionState) -> Matrix4<f32> {
        let off = self.state - state;
        self.covariance + off * off.transpose()
    }
}

/// Probability of a kick within `seconds`.
fn kick_probability(seconds: f32, config: &ObjectTrackConfig) -> f32 {
    1.0 - math::exp(-config.kick_rate * seconds)
}

/// Covariance that one kick within the last `seconds` adds; all times are equally probable.
fn kick_covariance(seconds: f32, config: &ObjectTrackConfig) -> Matrix4<f32> {
    let variance = config.kick_speed_std * config.kick_speed_std;
    by_axis(
        variance * seconds * seconds / 3.0,
        variance * seconds / 2.0,
        variance,
    )
}

/// Covariance of position and velocity, the same for each axis.
fn by_axis(position: f32, cross: f32, velocity: f32) -> Matrix4<f32> {
    let mut covariance = Matrix4::zeros();
    for axis in 0..2 {
        covariance[(axis, axis)] = position;
        covariance[(axis, axis + 2)] = cross;
        covariance[(axis + 2, axis)] = cross;
        covariance[(axis + 2, axis + 2)] = velocity;
    }
    covariance
}

/// Natural logarithm of the sum of the weights.
fn log_likelihood(updated: &[Updated]) -> f32 {
    let largest = updated
        .iter()
        .map(|updated| updated.log_weight)
        .fold(f32::NEG_INFINITY, f32::max);
    let sum: f32 = updated
        .iter()
        .map(|updated| math::exp(updated.log_weight - largest))
        .sum();
    largest + math::ln(sum)
}

/// Displacement of an object that decelerates to rest, metres.
pub(super) fn rolling_displacement(
    velocity: Vector2<f32>,
    seconds: f32,
    deceleration: f32,
) -> Vector2<f32> {
    let speed = velocity.norm();
    if speed <= 0.0 {
        return Vector2::zeros();
    }
    let rolling = if deceleration > 0.0 {
        seconds.min(speed / deceleration)
    } else {
        seconds
    };
    velocity / speed * (speed * rolling - deceleration * rolling * rolling / 2.0)
}
