//! How does a ball move between two images? Kinds of motion with their gravity, drag and friction.

use nalgebra::SMatrix;

use super::config::FlightConfig;
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
    /// A hand holds it above the ground, lifts it or carries it.
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

/// Lift and a drag of another ball, share of the squared speed, 1/m. With it the acceleration is in error for a time.
const DRAG_ERROR: f64 = 0.008;
/// Error of the deceleration of a rolling ball, m/s².
const ROLLING_ERROR: f64 = 0.3;
/// Time for which an error of the acceleration lasts, seconds.
const ERROR_TIME: f64 = 0.5;
/// Standard deviation of each component of a hand's velocity, m/s, and the time for which a velocity lasts, seconds.
pub(super) const HAND_SPEED_STD: f64 = 0.5;
const HAND_TIME: f64 = 0.5;

impl BallMotionMode {
    /// Acceleration of a ball with a velocity, m/s².
    fn acceleration(self, [vx, vy, vz]: [f64; 3], config: &FlightConfig) -> [f64; 3] {
        match self {
            BallMotionMode::Held => [vx, vy, vz].map(|velocity| -velocity / HAND_TIME),
            BallMotionMode::Ground => {
                let speed = math::hypot(vx, vy).max(1e-6);
                let slower = -f64::from(config.rolling_deceleration) / speed;
                [slower * vx, slower * vy, 0.0]
            }
            BallMotionMode::Flight => {
                let speed = math::hypot(math::hypot(vx, vy), vz).min(40.0);
                let drag = -f64::from(config.drag) * speed;
                [drag * vx, drag * vy, drag * vz - f64::from(GRAVITY)]
            }
        }
    }

    /// Moves a state by `t` seconds.
    pub(super) fn advance(self, state: &mut [f64], t: f64, config: &FlightConfig) {
        let velocity = [state[3], state[4], state[5]];
        let first = self.acceleration(velocity, config);
        let t_moving = match self {
            // It stands still after it has stopped.
            BallMotionMode::Ground => {
                let deceleration = f64::from(config.rolling_deceleration).max(1e-9);
                t.min(math::hypot(velocity[0], velocity[1]) / deceleration)
            }
            _ => t,
        };
        let middle = std::array::from_fn(|axis| velocity[axis] + 0.5 * t_moving * first[axis]);
        let acceleration = self.acceleration(middle, config);
        for axis in 0..3 {
            state[axis] += t_moving * (velocity[axis] + 0.5 * t_moving * acceleration[axis]);
            state[axis + 3] += t_moving * acceleration[axis];
        }
    }

    /// Share of an error of the velocity that is left after `t` seconds: that of a hand is a Gauss-Markov process.
    pub(super) fn velocity_kept(self, t: f64) -> f64 {
        match self {
            BallMotionMode::Held => math::exp(-t / HAND_TIME),
            BallMotionMode::Ground | BallMotionMode::Flight => 1.0,
        }
    }

    /// Spectral density of the noise of the velocity, m²/s³.
    pub(super) fn noise(self, state: &[f64]) -> f64 {
        match self {
            BallMotionMode::Held => 2.0 * HAND_SPEED_STD * HAND_SPEED_STD / HAND_TIME,
            BallMotionMode::Ground => ROLLING_ERROR * ROLLING_ERROR * ERROR_TIME,
            BallMotionMode::Flight => {
                let squared = state[3] * state[3] + state[4] * state[4] + state[5] * state[5];
                let error = DRAG_ERROR * squared.min(400.0);
                error * error * ERROR_TIME
            }
        }
    }
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
