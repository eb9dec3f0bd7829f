//! How does a ball decelerate? It slides, gains spin, then rolls; a hollow shell starts to roll at 3/5 of its speed.

use localize::sensors::attitude::GRAVITY;
use nalgebra::Vector2;

/// Friction of a ball on the carpet; rapier does the rest of its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallFriction {
    /// Friction coefficient while it slides.
    pub(crate) sliding_friction: f32,
    /// Deceleration while it rolls, m/s².
    pub(crate) rolling_deceleration: f32,
}

/// Mass over (moment of inertia / radius²) of a thin shell: 1 / (2/3).
pub(crate) const SHELL_INERTIA_RATIO: f32 = 1.5;
/// Slip below which a ball rolls, m/s: friction removes about that much in a step of 2 ms.
const ROLLING_SLIP_MAX: f32 = 0.02;

impl BallFriction {
    /// Velocity and surface velocity of the spin (both m/s, equal while rolling) after `step` seconds.
    pub(crate) fn step(
        &self,
        velocity: Vector2<f32>,
        spin: Vector2<f32>,
        step: f32,
    ) -> (Vector2<f32>, Vector2<f32>) {
        let slip = velocity - spin;
        let slip_speed = slip.norm();
        if slip_speed > ROLLING_SLIP_MAX {
            // Slip decreases at (1 + 3/2)·μg: the last step must not overshoot.
            let change = (self.sliding_friction * GRAVITY * step)
                .min(slip_speed / (1.0 + SHELL_INERTIA_RATIO));
            let along = slip / slip_speed;
            return (
                velocity - along * change,
                spin + along * change * SHELL_INERTIA_RATIO,
            );
        }
        let speed = velocity.norm();
        let slower = (speed - self.rolling_deceleration * step).max(0.0);
        let velocity = if speed > 0.0 {
            velocity * (slower / speed)
        } else {
            velocity
        };
        (velocity, velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: BallFriction = BallFriction {
        sliding_friction: 0.35,
        rolling_deceleration: 0.4,
    };

    #[test]
    fn sliding_shell_rolls_at_three_fifths_of_its_speed() {
        let (mut velocity, mut spin) = (Vector2::new(5.0, 0.0), Vector2::zeros());
        while (velocity - spin).norm() > ROLLING_SLIP_MAX {
            (velocity, spin) = LAW.step(velocity, spin, 0.002);
        }
        assert!((velocity.x - 3.0).abs() < 0.02, "{}", velocity.x);
    }

    #[test]
    fn rolling_ball_stops_at_v_squared_over_2a() {
        let (mut velocity, mut spin) = (Vector2::new(2.0, 0.0), Vector2::new(2.0, 0.0));
        let mut distance = 0.0;
        while velocity.norm() > 0.0 {
            (velocity, spin) = LAW.step(velocity, spin, 0.002);
            distance += velocity.x * 0.002;
        }
        assert!(
            (distance - 2.0 * 2.0 / (2.0 * 0.4)).abs() < 0.02,
            "{distance}"
        );
    }
}
