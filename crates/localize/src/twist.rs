//! Velocity of the robot, and its motion between two odometry samples.

use serde::{Deserialize, Serialize};

use crate::math;
use crate::stamp::Stamp;

/// Correction of wheels that measure the true motion: rows of the matrix from the measured (x, y, θ) to the true one.
pub const UNCORRECTED_MOTION: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Velocity of the robot, or its motion in a given time (robot frame).
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Default,
    serde::Serialize,
    serde::Deserialize,
    schemars::JsonSchema,
)]
pub struct Twist {
    /// Forward, m/s (metres).
    pub x: f32,
    /// To the left, m/s (metres).
    pub y: f32,
    /// Counter-clockwise, rad/s (radians).
    pub theta: f32,
}

impl Twist {
    /// The motion by this constant velocity in one unit of time, in the robot frame at its start.
    ///
    /// The robot moves on an arc: the translation is the integral of R(θ̇t)·(x, y) (docs/methods.md 7.2).
    ///
    /// `slip`: see [`Odometry::slip`].
    pub fn integrate(self, stamp: Stamp, slip: f32) -> Odometry {
        // sin θ/θ and (1 − cos θ)/θ. Below 1e-3 the error of their series is under the resolution of f32.
        let (along, across) = if self.theta.abs() < 1e-3 {
            (1.0 - self.theta * self.theta / 6.0, self.theta / 2.0)
        } else {
            let half = math::sin(self.theta / 2.0);
            (
                math::sin(self.theta) / self.theta,
                2.0 * half * half / self.theta,
            )
        };
        Odometry {
            stamp,
            dx: along * self.x - across * self.y,
            dy: across * self.x + along * self.y,
            dtheta: self.theta,
            slip,
        }
    }

    /// All components multiplied by `factor`.
    pub fn scaled(self, factor: f32) -> Twist {
        Twist {
            x: factor * self.x,
            y: factor * self.y,
            theta: factor * self.theta,
        }
    }
}

/// Motion of the robot since the previous odometry sample, in the robot frame at that sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// End of the motion.
    pub stamp: Stamp,
    /// Forward, metres.
    pub dx: f32,
    /// Left, metres.
    pub dy: f32,
    /// Counter-clockwise, radians.
    pub dtheta: f32,
    /// Root mean square residual of the wheels' distances, metres. 0 for three wheels (docs/methods.md 7.1).
    pub slip: f32,
}

/// What a turn counts for as motion: the wheels of a robot that turns in place and is pushed once agree.
pub const METRES_PER_RADIAN: f32 = 0.5;

impl Odometry {
    /// Length of the motion, metres, where a radian counts as [`METRES_PER_RADIAN`].
    pub fn path(&self) -> f32 {
        math::hypot(self.dx, self.dy) + METRES_PER_RADIAN * self.dtheta.abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_circle_integrates_to_its_diameter() {
        // A half circle of 1 m: radius 1/π, so that it ends 2/π to the left.
        let end = Twist {
            x: 1.0,
            y: 0.0,
            theta: std::f32::consts::PI,
        }
        .integrate(Stamp(0), 0.0);
        assert!(end.dx.abs() < 1e-6 && (end.dy - 2.0 / std::f32::consts::PI).abs() < 1e-6);
        let nearly_straight = Twist {
            x: 1.0,
            y: 0.0,
            theta: 0.999e-3,
        };
        let beyond = Twist {
            theta: 1.001e-3,
            ..nearly_straight
        };
        let (below, above) = (
            nearly_straight.integrate(Stamp(0), 0.0),
            beyond.integrate(Stamp(0), 0.0),
        );
        assert!((below.dx - above.dx).abs() < 1e-6 && (below.dy - above.dy).abs() < 2e-6);
    }
}
