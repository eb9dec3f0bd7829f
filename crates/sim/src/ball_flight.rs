//! How does a ball fly and bounce? Gravity, quadratic drag, and impacts with friction and spin (docs/methods.md 14.2).

use localize::sensors::attitude::GRAVITY;
use nalgebra::{Vector2, Vector3};

use crate::ball::SHELL_INERTIA_RATIO;
use crate::scenario::BallConfig;

/// Density of air at 20 °C, kg/m³.
const AIR_DENSITY: f32 = 1.2;
/// Rebounds slower than this end the flight, m/s: the ball would rise by half a millimetre.
const REBOUND_MIN: f32 = 0.1;

/// Laws of a ball in the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallFlight {
    /// Deceleration by drag over the squared speed, 1/m.
    pub(crate) drag: f32,
    /// Coefficient of restitution on the carpet.
    pub(crate) floor_restitution: f32,
    /// Friction coefficient on the carpet.
    pub(crate) sliding_friction: f32,
}

/// Motion of a ball: the height is that of its lowest point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallMotion {
    /// Metres above the carpet.
    pub(crate) height: f32,
    /// m/s.
    pub(crate) velocity: Vector3<f32>,
    /// Velocity that the spin about horizontal axes gives the ball's upper side, m/s: equal to the velocity while it rolls.
    pub(crate) surface_velocity: Vector2<f32>,
}

impl BallMotion {
    /// True if the ball touches the carpet and does not leave it.
    pub(crate) fn is_on_ground(&self) -> bool {
        self.height <= 0.0 && self.velocity.z <= 0.0
    }
}

impl BallFlight {
    pub(crate) fn new(config: &BallConfig) -> Self {
        let radius = config.diameter / 2.0;
        let area = std::f32::consts::PI * radius * radius;
        BallFlight {
            drag: 0.5 * AIR_DENSITY * config.drag_coefficient * area / config.mass,
            floor_restitution: config.floor_restitution,
            sliding_friction: config.sliding_friction,
        }
    }

    /// Height, velocity and spin after `step` seconds in the air, with one impact on the carpet at most.
    pub(crate) fn step(&self, mut motion: BallMotion, step: f32) -> BallMotion {
        // Implicit in the speed, so that no drag is too strong for the step.
        motion.velocity /= 1.0 + self.drag * motion.velocity.norm() * step;
        let rise = motion.velocity.z;
        let fallen = motion.height + (rise - 0.5 * GRAVITY * step) * step;
        if fallen > 0.0 {
            motion.height = fallen;
            motion.velocity.z = rise - GRAVITY * step;
            return motion;
        }
        // The exact time of the impact within the step: energy would otherwise depend on the phase of the steps.
        let impact_speed = (rise * rise + 2.0 * GRAVITY * motion.height.max(0.0)).sqrt();
        let rest = (step - (rise + impact_speed) / GRAVITY).clamp(0.0, step);
        motion.velocity.z = -impact_speed;
        self.bounce(&mut motion);
        motion.height = 0.0;
        let rebound = motion.velocity.z;
        if rebound < REBOUND_MIN {
            motion.velocity.z = 0.0;
            return motion;
        }
        motion.height = (rebound - 0.5 * GRAVITY * rest).max(0.0) * rest;
        motion.velocity.z = rebound - GRAVITY * rest;
        motion
    }

    /// Impact on the carpet: restitution upwards, Coulomb friction against the slip until the ball rolls.
    fn bounce(&self, motion: &mut BallMotion) {
        let impact_speed = -motion.velocity.z;
        motion.velocity.z = self.floor_restitution * impact_speed;
        let velocity = motion.velocity.xy();
        let slip = velocity - motion.surface_velocity;
        let slip_speed = slip.norm();
        if slip_speed <= 0.0 {
            return;
        }
        let change = (self.sliding_friction * (1.0 + self.floor_restitution) * impact_speed)
            .min(slip_speed / (1.0 + SHELL_INERTIA_RATIO));
        let along = slip / slip_speed * change;
        motion.velocity.x -= along.x;
        motion.velocity.y -= along.y;
        motion.surface_velocity += along * SHELL_INERTIA_RATIO;
    }
}

/// Velocity after an impact on a surface with a unit normal; `surface`: velocity of the surface. None if they separate.
pub(crate) fn reflect(
    velocity: Vector3<f32>,
    surface: Vector3<f32>,
    normal: Vector3<f32>,
    restitution: f32,
) -> Option<Vector3<f32>> {
    let approach = (velocity - surface).dot(&normal);
    (approach < 0.0).then(|| velocity - normal * ((1.0 + restitution) * approach))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::STEP;

    const NO_DRAG: BallFlight = BallFlight {
        drag: 0.0,
        floor_restitution: 0.6,
        sliding_friction: 0.35,
    };

    fn kicked(forward: f32, up: f32) -> BallMotion {
        BallMotion {
            height: 0.0,
            velocity: Vector3::new(forward, 0.0, up),
            surface_velocity: Vector2::zeros(),
        }
    }

    /// Apex of each flight between impacts, metres.
    fn apexes(law: &BallFlight, mut motion: BallMotion, count: usize) -> Vec<f32> {
        let mut apexes = vec![0.0f32];
        let mut rising = true;
        while apexes.len() <= count {
            let before = motion.height;
            motion = law.step(motion, STEP);
            if motion.height > before && !rising {
                apexes.push(0.0);
            }
            rising = motion.height > before;
            if let Some(apex) = apexes.last_mut() {
                *apex = apex.max(motion.height);
            }
        }
        apexes.truncate(count);
        apexes
    }

    #[test]
    fn without_drag_the_path_is_the_parabola() {
        let mut motion = kicked(5.0, 6.0);
        for step in 1..=500 {
            motion = NO_DRAG.step(motion, STEP);
            let t = step as f32 * STEP;
            let height = 6.0 * t - 0.5 * GRAVITY * t * t;
            assert!((motion.height - height).abs() < 1e-4, "{t} s: {motion:?}");
            assert_eq!(motion.velocity.x, 5.0);
        }
        let apex = apexes(&NO_DRAG, kicked(5.0, 6.0), 1)[0];
        assert!((apex - 36.0 / (2.0 * GRAVITY)).abs() < 1e-4, "{apex}");
    }

    #[test]
    fn each_bounce_keeps_the_square_of_the_restitution() {
        let apexes = apexes(&NO_DRAG, kicked(0.0, 6.0), 5);
        for pair in apexes.windows(2) {
            assert!((pair[1] / pair[0] - 0.36).abs() < 2e-3, "{apexes:?}");
        }
    }

    #[test]
    fn falling_ball_reaches_the_terminal_speed_of_quadratic_drag() {
        let law = BallFlight {
            drag: 0.02,
            ..NO_DRAG
        };
        let mut motion = kicked(0.0, 0.0);
        motion.height = 1000.0;
        let terminal = (GRAVITY / 0.02).sqrt();
        for step in 1..=4000 {
            motion = law.step(motion, STEP);
            let t = step as f32 * STEP;
            let speed = terminal * (GRAVITY * t / terminal).tanh();
            assert!((motion.velocity.z + speed).abs() < 1e-3 * terminal, "{t}");
        }
        assert!((motion.velocity.z / terminal + 1.0).abs() < 5e-3);
    }

    #[test]
    fn horizontal_drag_slows_by_the_distance_flown() {
        let law = BallFlight {
            drag: 0.02,
            ..NO_DRAG
        };
        // dv/dt = −k·v² gives v = v₀/(1 + k·v₀·t); gravity is made negligible by the speed.
        let mut motion = kicked(200.0, 0.0);
        motion.height = 1000.0;
        for _ in 0..500 {
            motion = law.step(motion, STEP);
        }
        let expected = 200.0 / (1.0 + 0.02 * 200.0 * 500.0 * STEP);
        assert!((motion.velocity.x / expected - 1.0).abs() < 0.01);
    }

    #[test]
    fn bouncing_shell_ends_at_three_fifths_of_its_speed() {
        // Friction acts through the carpet's contact point alone, so v + (2/3)·spin is kept by every impact.
        let mut motion = kicked(5.0, 6.0);
        for _ in 0..4000 {
            motion = NO_DRAG.step(motion, STEP);
            let kept = motion.velocity.x + motion.surface_velocity.x / SHELL_INERTIA_RATIO;
            assert!((kept - 5.0).abs() < 1e-4, "{motion:?}");
            if motion.is_on_ground() {
                break;
            }
        }
        assert!(motion.is_on_ground(), "{motion:?}");
        assert!((motion.velocity.x - 3.0).abs() < 1e-3, "{motion:?}");
    }

    #[test]
    fn backspin_makes_the_ball_return() {
        let mut motion = kicked(1.0, 0.0);
        (motion.height, motion.surface_velocity.x) = (1.0, -6.0);
        while motion.height > 0.0 && motion.velocity.z <= 0.0 {
            motion = NO_DRAG.step(motion, STEP);
        }
        assert!(motion.velocity.x < 0.0, "{motion:?}");
    }

    #[test]
    fn no_step_is_too_long_for_the_drag() {
        let law = BallFlight {
            drag: 1e4,
            ..NO_DRAG
        };
        let mut motion = kicked(50.0, 50.0);
        for _ in 0..100 {
            motion = law.step(motion, 0.1);
            assert!(motion.height >= 0.0 && motion.velocity.norm() < 50.0);
        }
    }
}
