//! What do the wheels do? An omnidirectional base: wheel speeds, traction with slip, and what the encoders count.

use localize::omni::{OmniError, OmniKinematics, Twist};
use localize::robot::BaseConfig;
use localize::sample::Odometry;
use localize::stamp::Stamp;
use nalgebra::Vector3;

use crate::scenario::WheelConfig;

/// Wheels, motors and encoders.
#[derive(Debug, Clone)]
pub struct SimBase {
    /// The wheels as the robot file believes them.
    omni: OmniKinematics,
    wheels: Vec<Wheel>,
    /// Of the wheels from the centre, metres.
    wheel_distance: f32,
    ticks_per_turn: f32,
    speed_max: f32,
    acceleration_max: f32,
    /// What a wheel can push at most, N.
    traction_force_max: f32,
    slip_stiffness: f32,
    /// What the motors follow now.
    motor_twist: Twist,
}

#[derive(Debug, Clone, Copy)]
struct Wheel {
    /// Real radius over the robot file's.
    radius_scale: f32,
    /// Angle turned since the start, radians; f64 since ticks are counted over hours.
    angle: f64,
    counted: i64,
}

const GRAVITY: f32 = 9.81;

impl SimBase {
    /// A base at rest (MATH.md 5); wheels that cannot drive everywhere are refused.
    pub fn new(config: &BaseConfig, real: &WheelConfig) -> Result<Self, OmniError> {
        let angles: Vec<f32> = config
            .wheel_angles_deg
            .iter()
            .map(|angle_deg| angle_deg.to_radians())
            .collect();
        let omni = OmniKinematics::new(&angles, config.wheel_radius, config.wheel_distance)?;
        let last = real.radius_scale.len().saturating_sub(1);
        let wheels = (0..angles.len())
            .map(|index| Wheel {
                radius_scale: real
                    .radius_scale
                    .get(index.min(last))
                    .copied()
                    .unwrap_or(1.0),
                angle: 0.0,
                counted: 0,
            })
            .collect();
        let weight_each = config.mass * GRAVITY / angles.len() as f32;
        Ok(SimBase {
            omni,
            wheels,
            wheel_distance: config.wheel_distance,
            ticks_per_turn: config.ticks_per_turn,
            speed_max: config.speed_max,
            acceleration_max: config.acceleration_max,
            traction_force_max: real.traction * weight_each,
            slip_stiffness: real.grip,
            motor_twist: Twist::default(),
        })
    }

    /// Turns the motors towards a wanted twist for `step` seconds and pushes the carpet, given the real motion.
    ///
    /// Force (N along the robot's x and y) and torque (N m) of all wheels on the robot.
    pub fn step(&mut self, wanted: Twist, real: Twist, step: f32) -> [f32; 3] {
        self.ramp_motors(wanted, step);
        let radius = self.omni.wheel_radius();
        let turns = self.omni.wheel_speeds(self.motor_twist);
        for (wheel, turn) in self.wheels.iter_mut().zip(turns) {
            wheel.angle += f64::from(turn * step);
        }
        let turns = self.omni.wheel_speeds(self.motor_twist);
        let ground = self.omni.wheel_speeds(real);
        let pushes = self
            .wheels
            .iter()
            .zip(turns.zip(ground))
            .map(|(wheel, (turn, ground))| {
                // The controller turns the wheel as if it had the radius of the robot file.
                let slip = radius * (turn * wheel.radius_scale - ground);
                (self.slip_stiffness * slip)
                    .clamp(-self.traction_force_max, self.traction_force_max)
            });
        self.omni.wrench(pushes)
    }

    /// The motors' ramp: acceleration and wheel speed are limited, the direction of motion is kept.
    fn ramp_motors(&mut self, wanted: Twist, step: f32) {
        let target = self.omni.limit_twist(wanted, self.speed_max);
        let now = self.motor_twist;
        let change = Vector3::new(target.x - now.x, target.y - now.y, target.theta - now.theta);
        let size = Vector3::new(change.x, change.y, change.z * self.wheel_distance).norm();
        let most = self.acceleration_max * step;
        let part = if size > most { most / size } else { 1.0 };
        self.motor_twist = Twist {
            x: now.x + part * change.x,
            y: now.y + part * change.y,
            theta: now.theta + part * change.z,
        };
    }

    /// What the encoders counted since the last call, as the robot file believes its wheels. `stuck` names a wheel whose
    /// encoder does not count.
    pub fn read_encoders(&mut self, stamp: Stamp, stuck: Option<usize>) -> Odometry {
        let tick = f64::from(std::f32::consts::TAU / self.ticks_per_turn);
        let turns: Vec<f32> = self
            .wheels
            .iter_mut()
            .enumerate()
            .map(|(index, wheel)| {
                let total = (wheel.angle / tick).floor() as i64;
                let ticks = total - wheel.counted;
                wheel.counted = total;
                let heard = if stuck == Some(index) { 0 } else { ticks };
                (heard as f64 * tick) as f32
            })
            .collect();
        let (motion, slip) = self.omni.twist(&turns);
        motion.integrate(stamp, slip)
    }

    /// How far each wheel has turned since the start, radians.
    pub fn wheel_angles(&self) -> impl Iterator<Item = f64> + '_ {
        self.wheels.iter().map(|wheel| wheel.angle)
    }

    /// Stops the motors at once, as when the robot is lifted.
    pub fn stop_motors(&mut self) {
        self.motor_twist = Twist::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn base(angles: &[f32]) -> SimBase {
        let config = BaseConfig {
            wheel_angles_deg: angles.to_vec(),
            ticks_per_turn: 1e6,
            ..BaseConfig::default()
        };
        SimBase::new(&config, &WheelConfig::default()).expect("a base")
    }

    /// Drives for a second on rails: the robot moves exactly as its motors want.
    fn odometry_after_one_second(mut base: SimBase, twist: Twist) -> [f32; 3] {
        base.motor_twist = twist;
        let (mut x, mut y, mut theta) = (0.0f32, 0.0f32, 0.0f32);
        for _ in 0..100 {
            for _ in 0..5 {
                base.step(twist, twist, 0.002);
            }
            let Odometry { dx, dy, dtheta, .. } = base.read_encoders(Stamp(0), None);
            let (sin, cos) = theta.sin_cos();
            x += cos * dx - sin * dy;
            y += sin * dx + cos * dy;
            theta += dtheta;
        }
        [x, y, theta]
    }

    #[test]
    fn odometry_of_3_and_4_wheels_integrates_to_the_driven_arc() {
        let twist = Twist {
            x: 1.0,
            y: -0.5,
            theta: 1.2,
        };
        // Exact integral of a constant twist over one second.
        let (sin, cos) = twist.theta.sin_cos();
        let wanted = [
            (twist.x * sin - twist.y * (1.0 - cos)) / twist.theta,
            (twist.x * (1.0 - cos) + twist.y * sin) / twist.theta,
            twist.theta,
        ];
        for angles in [&[60.0, 180.0, 300.0][..], &[45.0, 135.0, 225.0, 315.0]] {
            let found = odometry_after_one_second(base(angles), twist);
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-3, "{found} {wanted}");
            }
        }
    }

    #[test]
    fn wheel_force_is_limited_by_traction() {
        let mut base = base(&[60.0, 180.0, 300.0]);
        let shoved = Twist {
            x: 3.0,
            ..Twist::default()
        };
        let force = base.step(Twist::default(), shoved, 0.002);
        let weight = 30.0 * GRAVITY;
        // Two of three wheels roll partly along x: 2·sin 60° of a third of the weight each.
        let wanted = -0.7 * weight / 3.0 * 2.0 * 60f32.to_radians().sin();
        assert!((force[0] - wanted).abs() < 0.5, "{} {wanted}", force[0]);
        // Locked wheels that slide count nothing.
        let counted = base.read_encoders(Stamp(0), None);
        assert_eq!((counted.dx, counted.dy, counted.dtheta), (0.0, 0.0, 0.0));
    }

    #[test]
    fn stuck_encoder_distorts_odometry() {
        let twist = Twist {
            x: 1.0,
            ..Twist::default()
        };
        let mut base = base(&[60.0, 180.0, 300.0]);
        base.motor_twist = twist;
        for _ in 0..50 {
            base.step(twist, twist, 0.002);
        }
        // Two of three wheels carry x; without one of them half of it is left, and a turn that never was.
        let Odometry { dx, dtheta, .. } = base.read_encoders(Stamp(0), Some(0));
        assert!((dx - 0.05).abs() < 0.004, "half of 0.1 m, found {dx}");
        assert!(dtheta.abs() > 0.1, "{dtheta}");
    }
}
