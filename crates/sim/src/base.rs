//! What do the wheels do? An omnidirectional base: wheel speeds, traction with slip, and what the encoders count.

use nalgebra::{DMatrix, Vector2, Vector3};
use vision::robot::BaseConfig;

use crate::scenario::WheelConfig;

/// A velocity in the robot frame: m/s forward, m/s to the left, rad/s counter-clockwise.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Forward, m/s.
    pub vx: f32,
    /// To the left, m/s.
    pub vy: f32,
    /// Counter-clockwise, rad/s.
    pub omega: f32,
}

impl Twist {
    fn vector(self) -> Vector3<f32> {
        Vector3::new(self.vx, self.vy, self.omega)
    }
}

/// Wheels, motors and encoders.
#[derive(Debug, Clone)]
pub struct Base {
    /// Direction each wheel rolls in, robot frame, and its lever about the centre (metres).
    wheels: Vec<Wheel>,
    /// Robot-frame twist from rim speeds as the robot file believes (least squares).
    twist_from_rims: DMatrix<f32>,
    nominal_radius: f32,
    ticks_per_turn: f32,
    speed_max: f32,
    acceleration_max: f32,
    /// What a wheel can push at most, N.
    push_max: f32,
    grip: f32,
    /// What the motors follow now.
    followed: Twist,
}

#[derive(Debug, Clone, Copy)]
struct Wheel {
    roll: Vector2<f32>,
    lever: f32,
    /// Real radius, metres.
    radius: f32,
    /// Angle turned since the start, radians; f64 since ticks are counted over hours.
    turned: f64,
    counted: i64,
}

/// Force and torque of all wheels on the robot, robot frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// N along the robot's x and y.
    pub force: [f32; 2],
    /// N m counter-clockwise.
    pub torque: f32,
}

const GRAVITY: f32 = 9.81;

impl Base {
    /// A base at rest. Wheel i at angle a_i rolls along (−sin a_i, cos a_i) (MATH.md 5).
    pub fn new(config: &BaseConfig, real: &WheelConfig) -> Self {
        let wheels: Vec<Wheel> = config
            .wheel_angles_deg
            .iter()
            .enumerate()
            .map(|(index, angle_deg)| {
                let (sin, cos) = angle_deg.to_radians().sin_cos();
                let last = real.radius_scale.len().saturating_sub(1);
                let scale = real
                    .radius_scale
                    .get(index.min(last))
                    .copied()
                    .unwrap_or(1.0);
                Wheel {
                    roll: Vector2::new(-sin, cos),
                    lever: config.wheel_distance,
                    radius: config.wheel_radius * scale,
                    turned: 0.0,
                    counted: 0,
                }
            })
            .collect();
        let rims_from_twist = DMatrix::from_fn(wheels.len(), 3, |row, column| match column {
            2 => wheels[row].lever,
            axis => wheels[row].roll[axis],
        });
        // Wheels in fewer than two directions leave one motion unseen: it is then reported as none.
        let twist_from_rims = rims_from_twist
            .pseudo_inverse(1e-6)
            .unwrap_or_else(|_| DMatrix::zeros(3, wheels.len()));
        let weight_each = config.mass * GRAVITY / wheels.len() as f32;
        Base {
            wheels,
            twist_from_rims,
            nominal_radius: config.wheel_radius,
            ticks_per_turn: config.ticks_per_turn,
            speed_max: config.speed_max,
            acceleration_max: config.acceleration_max,
            push_max: real.traction * weight_each,
            grip: real.grip,
            followed: Twist::default(),
        }
    }

    /// Rim speeds (m/s) that a twist asks of the wheels.
    pub fn rim_speeds(&self, twist: Twist) -> impl Iterator<Item = f32> + '_ {
        self.wheels.iter().map(move |wheel| {
            wheel.roll.x * twist.vx + wheel.roll.y * twist.vy + wheel.lever * twist.omega
        })
    }

    /// Turns the motors towards a wanted twist for `step` seconds and pushes the carpet, given the real motion.
    pub fn drive(&mut self, wanted: Twist, real: Twist, step: f32) -> Drive {
        self.follow(wanted, step);
        let mut drive = Drive::default();
        let rims: Vec<f32> = self.rim_speeds(self.followed).collect();
        let ground: Vec<f32> = self.rim_speeds(real).collect();
        for ((wheel, rim), ground) in self.wheels.iter_mut().zip(rims).zip(ground) {
            // The controller turns the wheel as if it had the radius of the robot file.
            let real_rim = rim * wheel.radius / self.nominal_radius;
            wheel.turned += f64::from(rim / self.nominal_radius * step);
            let push = (self.grip * (real_rim - ground)).clamp(-self.push_max, self.push_max);
            drive.force[0] += push * wheel.roll.x;
            drive.force[1] += push * wheel.roll.y;
            drive.torque += push * wheel.lever;
        }
        drive
    }

    /// The motors' ramp: acceleration and wheel speed are limited, the direction of motion is kept.
    fn follow(&mut self, wanted: Twist, step: f32) {
        let fastest = self
            .rim_speeds(wanted)
            .fold(0.0f32, |most, rim| most.max(rim.abs()));
        let within = if fastest > self.speed_max {
            self.speed_max / fastest
        } else {
            1.0
        };
        let target = wanted.vector() * within;
        let change = target - self.followed.vector();
        let lever = self.wheels.first().map_or(1.0, |wheel| wheel.lever);
        let size = Vector3::new(change.x, change.y, change.z * lever).norm();
        let most = self.acceleration_max * step;
        let part = if size > most { most / size } else { 1.0 };
        let next = self.followed.vector() + change * part;
        self.followed = Twist {
            vx: next.x,
            vy: next.y,
            omega: next.z,
        };
    }

    /// Robot-frame motion (metres, metres, radians) that the encoders counted since the last call; least squares
    /// over all wheels. `stuck` names a wheel whose encoder does not count.
    pub fn count(&mut self, stuck: Option<usize>) -> [f32; 3] {
        let tick = f64::from(std::f32::consts::TAU / self.ticks_per_turn);
        let radius = self.nominal_radius;
        let ways = self.wheels.iter_mut().enumerate().map(|(index, wheel)| {
            let total = (wheel.turned / tick).floor() as i64;
            let ticks = total - wheel.counted;
            wheel.counted = total;
            let heard = if stuck == Some(index) { 0 } else { ticks };
            (heard as f64 * tick) as f32 * radius
        });
        let ways = nalgebra::DVector::from_iterator(self.twist_from_rims.ncols(), ways);
        let motion = &self.twist_from_rims * ways;
        // A turn during the motion bends it: half the turn is the mean heading (exact for constant twists to θ²).
        let (sin, cos) = (motion[2] / 2.0).sin_cos();
        [
            cos * motion[0] - sin * motion[1],
            sin * motion[0] + cos * motion[1],
            motion[2],
        ]
    }

    /// Stops the motors at once, as when the robot is lifted.
    pub fn halt(&mut self) {
        self.followed = Twist::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn base(angles: &[f32]) -> Base {
        let config = BaseConfig {
            wheel_angles_deg: angles.to_vec(),
            ticks_per_turn: 1e6,
            ..BaseConfig::default()
        };
        Base::new(&config, &WheelConfig::default())
    }

    /// Drives for a second on rails: the robot moves exactly as its motors want.
    fn counted_after_a_second(mut base: Base, twist: Twist) -> [f32; 3] {
        base.followed = twist;
        let (mut x, mut y, mut theta) = (0.0f32, 0.0f32, 0.0f32);
        for _ in 0..100 {
            for _ in 0..5 {
                base.drive(twist, twist, 0.002);
            }
            let [dx, dy, dtheta] = base.count(None);
            let (sin, cos) = theta.sin_cos();
            x += cos * dx - sin * dy;
            y += sin * dx + cos * dy;
            theta += dtheta;
        }
        [x, y, theta]
    }

    #[test]
    fn encoders_of_three_and_four_wheels_add_up_to_the_arc_driven() {
        let twist = Twist {
            vx: 1.0,
            vy: -0.5,
            omega: 1.2,
        };
        // Exact integral of a constant twist over one second.
        let (sin, cos) = twist.omega.sin_cos();
        let wanted = [
            (twist.vx * sin - twist.vy * (1.0 - cos)) / twist.omega,
            (twist.vx * (1.0 - cos) + twist.vy * sin) / twist.omega,
            twist.omega,
        ];
        for angles in [&[60.0, 180.0, 300.0][..], &[45.0, 135.0, 225.0, 315.0]] {
            let found = counted_after_a_second(base(angles), twist);
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-3, "{found} {wanted}");
            }
        }
    }

    #[test]
    fn a_wheel_pushes_no_more_than_its_grip_on_the_carpet() {
        let mut base = base(&[60.0, 180.0, 300.0]);
        let shoved = Twist {
            vx: 3.0,
            ..Twist::default()
        };
        let drive = base.drive(Twist::default(), shoved, 0.002);
        let weight = 30.0 * GRAVITY;
        // Two of three wheels roll partly along x: 2·sin 60° of a third of the weight each.
        let wanted = -0.7 * weight / 3.0 * 2.0 * 60f32.to_radians().sin();
        assert!(
            (drive.force[0] - wanted).abs() < 0.5,
            "{} {wanted}",
            drive.force[0]
        );
        // Locked wheels that slide count nothing.
        assert_eq!(base.count(None), [0.0; 3]);
    }

    #[test]
    fn a_stuck_encoder_loses_its_part_of_the_motion() {
        let twist = Twist {
            vx: 1.0,
            ..Twist::default()
        };
        let mut base = base(&[60.0, 180.0, 300.0]);
        base.followed = twist;
        for _ in 0..50 {
            base.drive(twist, twist, 0.002);
        }
        // Two of three wheels carry x; without one of them half of it is left, and a turn that never was.
        let [dx, _, dtheta] = base.count(Some(0));
        assert!((dx - 0.05).abs() < 0.004, "half of 0.1 m, found {dx}");
        assert!(dtheta.abs() > 0.1, "{dtheta}");
    }
}
