//! How does an omnidirectional base drive? Wheel speeds, traction with slip, and encoder counts.

use localize::omni::{OmniError, OmniKinematics, Twist};
use localize::robot::BaseConfig;
use localize::sample::Odometry;
use localize::sensors::attitude::GRAVITY;
use localize::stamp::Stamp;
use nalgebra::Vector3;

use crate::scenario::WheelConfig;

/// Wheels, motors and encoders.
#[derive(Debug, Clone)]
pub struct SimBase {
    /// Kinematics by the robot file.
    omni: OmniKinematics,
    wheels: Vec<Wheel>,
    /// Distance of the wheels from the centre, metres.
    wheel_distance: f32,
    ticks_per_turn: f32,
    speed_max: f32,
    acceleration_max: f32,
    /// Maximum force of a wheel, N.
    traction_force_max: f32,
    slip_stiffness: f32,
    /// Velocity that the motors follow now, robot frame.
    motor_twist: Twist,
}

#[derive(Debug, Clone, Copy)]
struct Wheel {
    /// Real radius over that of the robot file.
    radius_scale: f32,
    /// Angle since the start, radians; f64, since ticks accumulate over hours.
    angle: f64,
    counted: i64,
}

impl SimBase {
    /// A base at rest (docs/methods.md 7.1). Fails for wheels that cannot drive in every direction.
    pub fn new(config: &BaseConfig, wheel_errors: &WheelConfig) -> Result<Self, OmniError> {
        let omni = config.kinematics()?;
        let last = wheel_errors.radius_scale.len().saturating_sub(1);
        let wheels = (0..omni.wheel_count())
            .map(|index| Wheel {
                radius_scale: wheel_errors
                    .radius_scale
                    .get(index.min(last))
                    .copied()
                    .unwrap_or(1.0),
                angle: 0.0,
                counted: 0,
            })
            .collect();
        let weight_each = config.mass * GRAVITY / omni.wheel_count() as f32;
        Ok(SimBase {
            omni,
            wheels,
            wheel_distance: config.wheel_distance,
            ticks_per_turn: config.ticks_per_turn,
            speed_max: config.speed_max,
            acceleration_max: config.acceleration_max,
            traction_force_max: wheel_errors.traction * weight_each,
            slip_stiffness: wheel_errors.grip,
            motor_twist: Twist::default(),
        })
    }

    /// Drives the motors towards `command` for `step` seconds while the robot moves with `actual_twist`.
    ///
    /// Returns the force (N along the robot's x and y) and torque (N m) of all wheels on the robot.
    pub fn step(&mut self, command: Twist, actual_twist: Twist, step: f32) -> [f32; 3] {
        self.ramp_motors(command, step);
        let radius = self.omni.wheel_radius();
        let speeds = self.omni.wheel_speeds(self.motor_twist);
        for (wheel, speed) in self.wheels.iter_mut().zip(speeds) {
            wheel.angle += f64::from(speed * step);
        }
        let speeds = self.omni.wheel_speeds(self.motor_twist);
        let ground_speeds = self.omni.wheel_speeds(actual_twist);
        let forces =
            self.wheels
                .iter()
                .zip(speeds.zip(ground_speeds))
                .map(|(wheel, (speed, ground))| {
                    // The controller assumes the radius of the robot file.
                    let slip = radius * (speed * wheel.radius_scale - ground);
                    (self.slip_stiffness * slip)
                        .clamp(-self.traction_force_max, self.traction_force_max)
                });
        self.omni.wrench(forces)
    }

    /// Changes the motors' velocity within the limits of acceleration and wheel speed, keeping the direction of motion.
    fn ramp_motors(&mut self, command: Twist, step: f32) {
        let target = self.omni.limit_twist(command, self.speed_max);
        let now = self.motor_twist;
        let change = Vector3::new(target.x - now.x, target.y - now.y, target.theta - now.theta);
        let size = Vector3::new(change.x, change.y, change.z * self.wheel_distance).norm();
        let size_max = self.acceleration_max * step;
        let part = if size > size_max {
            size_max / size
        } else {
            1.0
        };
        self.motor_twist = Twist {
            x: now.x + part * change.x,
            y: now.y + part * change.y,
            theta: now.theta + part * change.z,
        };
    }

    /// Odometry since the last call, by the kinematics of the robot file. `stuck` is a wheel whose encoder does not count.
    pub fn read_encoders(&mut self, stamp: Stamp, stuck: Option<usize>) -> Odometry {
        let tick = f64::from(std::f32::consts::TAU / self.ticks_per_turn);
        let increments: Vec<f32> = self
            .wheels
            .iter_mut()
            .enumerate()
            .map(|(index, wheel)| {
                let total = (wheel.angle / tick).floor() as i64;
                let ticks = total - wheel.counted;
                wheel.counted = total;
                let counted = if stuck == Some(index) { 0 } else { ticks };
                (counted as f64 * tick) as f32
            })
            .collect();
        let (motion, slip) = self.omni.twist(&increments);
        motion.integrate(stamp, slip)
    }

    /// Angle of each wheel since the start, radians.
    pub fn wheel_angles(&self) -> impl Iterator<Item = f64> + '_ {
        self.wheels.iter().map(|wheel| wheel.angle)
    }

    /// Stops the motors immediately, as for a lifted robot.
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

    /// Odometry over one second in which the robot moves exactly with its motors.
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
        // Locked wheels that slide count no ticks.
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
        // Two of three wheels measure x; without one of them odometry has half of it and a false rotation.
        let Odometry { dx, dtheta, .. } = base.read_encoders(Stamp(0), Some(0));
        assert!((dx - 0.05).abs() < 0.004, "half of 0.1 m, found {dx}");
        assert!(dtheta.abs() > 0.1, "{dtheta}");
    }
}
