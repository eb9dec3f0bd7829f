//! When and where does a flying ball meet the ground?

use nalgebra::{Matrix2, SMatrix};

use super::config::FlightConfig;
use super::motion::BallMotionState;
use crate::math;
use crate::sensors::attitude::GRAVITY;

/// Step of the integration, seconds.
const STEP: f64 = 0.005;
/// No ball of a game flies longer, seconds.
const FLIGHT_MAX: f64 = 4.0;

/// The next contact with the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Landing {
    /// Seconds after the state's time.
    pub after: f32,
    /// Point of the ground, metres, in the state's frame.
    pub at: [f32; 2],
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
}

/// Landing of a ball in flight; None if it does not land within some seconds.
pub fn predict_landing(state: &BallMotionState, config: &FlightConfig) -> Option<Landing> {
    let [mut x, mut y, mut z, mut vx, mut vy, mut vz] = state.state;
    let (radius, drag) = (f64::from(config.ball_radius), f64::from(config.drag));
    let mut time = 0.0;
    while z > radius || vz > 0.0 {
        if !(time < FLIGHT_MAX) {
            return None;
        }
        // The velocity at the middle of the step.
        let slow = 1.0 - 0.5 * STEP * drag * math::hypot(math::hypot(vx, vy), vz);
        let middle = [
            vx * slow,
            vy * slow,
            vz * slow - 0.5 * STEP * f64::from(GRAVITY),
        ];
        let fall = drag * math::hypot(math::hypot(middle[0], middle[1]), middle[2]) * STEP;
        (vx, vy) = (vx - fall * middle[0], vy - fall * middle[1]);
        vz -= fall * middle[2] + f64::from(GRAVITY) * STEP;
        let part = if middle[2] < 0.0 && z + middle[2] * STEP < radius {
            // The last step ends at the ground.
            ((radius - z) / (middle[2] * STEP)).clamp(0.0, 1.0)
        } else {
            1.0
        };
        (x, y) = (x + part * STEP * middle[0], y + part * STEP * middle[1]);
        z += part * STEP * middle[2];
        time += part * STEP;
        if part < 1.0 {
            break;
        }
    }
    let down = vz.min(-0.1);
    // Without drag: p = p₀ + v₀ t, and an error of the height changes the time.
    let mut jacobian = SMatrix::<f64, 2, 6>::zeros();
    for (row, speed) in [(0, vx), (1, vy)] {
        jacobian[(row, row)] = 1.0;
        jacobian[(row, row + 3)] = time;
        jacobian[(row, 2)] = -speed / down;
        jacobian[(row, 5)] = -speed * time / down;
    }
    let covariance: Matrix2<f64> = jacobian * state.covariance * jacobian.transpose();
    Some(Landing {
        after: time as f32,
        at: [x as f32, y as f32],
        covariance: [
            covariance[(0, 0)] as f32,
            covariance[(0, 1)] as f32,
            covariance[(1, 1)] as f32,
        ],
    })
}
