//! Kinematics of a base with three or more omnidirectional wheels: wheel speeds to twist, and the inverse.
//!
//! docs/methods.md 7.1, minho2016 IV.C: wheel i at angle a_i, distance L and radius r has the speed
//! ω_i = (−sin a_i·v_x + cos a_i·v_y + L·θ̇)/r. The pseudo-inverse gives the twist; the residual of the wheel speeds is
//! slip.

use nalgebra::{DMatrix, Matrix3};

use crate::math;

pub use crate::twist::{Twist, UNCORRECTED_MOTION};

/// Why a wheel layout is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum OmniError {
    /// Fewer than three wheels cannot drive three degrees of freedom.
    #[error("{0} wheels: an omnidirectional base has three or more")]
    TooFew(usize),
    /// Radius or distance is not positive, or an angle is not finite.
    #[error("wheel radius, distance and angles must be numbers, the lengths above zero")]
    InvalidSize,
    /// The wheels cannot, or hardly, drive the robot in some direction.
    #[error("the wheels' angles leave a direction in which they cannot drive")]
    Degenerate,
}

/// Kinematics of a base.
#[derive(Debug, Clone, PartialEq)]
pub struct OmniKinematics {
    /// Per wheel: rotation in radians per metre forward, per metre to the left, and per radian of the robot's yaw.
    wheel_from_robot: Vec<[f32; 3]>,
    /// The pseudo-inverse, one column per wheel.
    robot_from_wheel: Vec<[f32; 3]>,
    wheel_radius: f32,
}

impl OmniKinematics {
    /// From the wheels' angles (radians from the robot's x axis), radius and distance from the centre (metres).
    pub fn new(angles: &[f32], radius: f32, distance: f32) -> Result<Self, OmniError> {
        if angles.len() < 3 {
            return Err(OmniError::TooFew(angles.len()));
        }
        let lengths = [radius, distance];
        if !lengths
            .iter()
            .all(|length| *length > 0.0 && length.is_finite())
            || !angles.iter().all(|angle| angle.is_finite())
        {
            return Err(OmniError::InvalidSize);
        }
        // Columns in units of a wheel's rim: the conditioning does not depend on the robot's size.
        let rim = DMatrix::from_fn(angles.len(), 3, |wheel, axis| {
            let (sin, cos) = math::sin_cos(f64::from(angles[wheel]));
            [-sin, cos, 1.0][axis]
        });
        let normal: Matrix3<f64> = (rim.transpose() * &rim).fixed_view::<3, 3>(0, 0).into();
        // The smallest eigenvalue is the share of the wheels that drives the weakest direction. Below a hundredth of a
        // wheel (all three wheels within about 6° of parallel) encoder noise is amplified tenfold or more.
        if normal.symmetric_eigenvalues().min() < 0.01 {
            return Err(OmniError::Degenerate);
        }
        let inverse = normal.try_inverse().ok_or(OmniError::Degenerate)?;
        let (radius_m, distance_m) = (f64::from(radius), f64::from(distance));
        let scale = [1.0, 1.0, distance_m];
        let rim_row = |wheel: usize| [0, 1, 2].map(|axis| rim[(wheel, axis)]);
        let wheel_from_robot = (0..angles.len())
            .map(|wheel| {
                [0, 1, 2].map(|axis| (rim_row(wheel)[axis] * scale[axis] / radius_m) as f32)
            })
            .collect();
        let robot_from_wheel = (0..angles.len())
            .map(|wheel| {
                let row = rim_row(wheel);
                [0, 1, 2].map(|axis| {
                    let sum: f64 = (0..3).map(|k| inverse[(axis, k)] * row[k]).sum();
                    (sum * radius_m / scale[axis]) as f32
                })
            })
            .collect();
        Ok(OmniKinematics {
            wheel_from_robot,
            robot_from_wheel,
            wheel_radius: radius,
        })
    }

    /// Number of wheels.
    pub fn wheel_count(&self) -> usize {
        self.wheel_from_robot.len()
    }

    /// Speed of each wheel (rad/s, in the order of the angles) for `twist`.
    pub fn wheel_speeds(&self, twist: Twist) -> impl Iterator<Item = f32> + '_ {
        self.wheel_from_robot
            .iter()
            .map(move |row| row[0] * twist.x + row[1] * twist.y + row[2] * twist.theta)
    }

    /// The least-squares twist of the wheel speeds, and the slip.
    ///
    /// `wheels`: rad/s (or radians), one per wheel. Slip is the root mean square residual of the rim speeds, m/s (or
    /// metres). Three wheels have no residual, so that their slip is zero.
    pub fn twist(&self, wheels: &[f32]) -> (Twist, f32) {
        let mut sum = [0.0_f32; 3];
        for (column, speed) in self.robot_from_wheel.iter().zip(wheels) {
            for (sum, part) in sum.iter_mut().zip(column) {
                *sum += part * speed;
            }
        }
        let [x, y, theta] = sum;
        let twist = Twist { x, y, theta };
        if self.wheel_count() == 3 {
            return (twist, 0.0);
        }
        let square: f32 = self
            .wheel_speeds(twist)
            .zip(wheels)
            .map(|(predicted, speed)| (speed - predicted) * (speed - predicted))
            .sum();
        (
            twist,
            self.wheel_radius * (square / self.wheel_count() as f32).sqrt(),
        )
    }

    /// The twist, scaled down so that no wheel's rim is faster than `rim_speed_max` (m/s).
    pub fn limit_twist(&self, twist: Twist, rim_speed_max: f32) -> Twist {
        let fastest = self
            .wheel_speeds(twist)
            .fold(0.0, |fastest: f32, speed| fastest.max(speed.abs()));
        let share = (rim_speed_max / (fastest * self.wheel_radius)).min(1.0);
        if !(share < 1.0) {
            return twist;
        }
        twist.scaled(share)
    }

    /// For each wheel: the part of a motion (x, y, θ) that this wheel's rolling contributes to the motion measured. Their sum
    /// is the identity.
    pub fn motion_by_wheel(&self) -> impl Iterator<Item = Matrix3<f32>> + '_ {
        self.robot_from_wheel
            .iter()
            .zip(&self.wheel_from_robot)
            .map(|(column, row)| Matrix3::from_fn(|i, j| column[i] * row[j]))
    }

    /// Force (N along x and y) and torque (N m) on the robot from the forces of the wheels' rims on the ground (N).
    pub fn wrench(&self, rim_forces: impl Iterator<Item = f32>) -> [f32; 3] {
        let mut sum = [0.0_f32; 3];
        for (row, force) in self.wheel_from_robot.iter().zip(rim_forces) {
            for (sum, part) in sum.iter_mut().zip(row) {
                *sum += self.wheel_radius * part * force;
            }
        }
        sum
    }

    /// Radius of the wheels, metres.
    pub fn wheel_radius(&self) -> f32 {
        self.wheel_radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn omni(angles_deg: &[f32]) -> Result<OmniKinematics, OmniError> {
        let angles: Vec<_> = angles_deg.iter().map(|angle| angle.to_radians()).collect();
        OmniKinematics::new(&angles, 0.05, 0.2)
    }

    fn twist_difference(a: Twist, b: Twist) -> f32 {
        (a.x - b.x).abs() + (a.y - b.y).abs() + (a.theta - b.theta).abs()
    }

    #[test]
    fn front_wheel_responds_to_lateral_motion_and_rotation() {
        let base = omni(&[0.0, 90.0, 180.0, 270.0]).expect("a base");
        let turn = Twist {
            theta: 1.0,
            ..Twist::default()
        };
        assert!(
            base.wheel_speeds(turn)
                .all(|speed| (speed - 4.0).abs() < 1e-5)
        );
        let left = Twist {
            y: 1.0,
            ..Twist::default()
        };
        let speeds: Vec<_> = base.wheel_speeds(left).collect();
        for (speed, wanted) in speeds.iter().zip([20.0, 0.0, -20.0, 0.0]) {
            assert!((speed - wanted).abs() < 1e-4, "{speeds:?}");
        }
    }

    #[test]
    fn single_spinning_wheel_is_reported_as_slip() {
        let base = omni(&[45.0, 135.0, 225.0, 315.0]).expect("a base");
        let twist = Twist {
            x: 1.0,
            y: 0.5,
            theta: -2.0,
        };
        let mut speeds: Vec<_> = base.wheel_speeds(twist).collect();
        assert!(base.twist(&speeds).1 < 1e-5);
        // The twist fits three quarters of one wheel's 10 rad/s; the residual is spread evenly over four wheels.
        speeds[2] += 10.0;
        assert!((base.twist(&speeds).1 - 0.05 * 10.0 / 4.0).abs() < 1e-4);
    }

    #[test]
    fn wheel_forces_and_wrench_do_equal_work() {
        let base = omni(&[60.0, 180.0, 300.0]).expect("a base");
        let twist = Twist {
            x: 0.7,
            y: -0.4,
            theta: 1.5,
        };
        let forces = [10.0, -4.0, 7.0];
        let rim_speeds = base.wheel_speeds(twist).map(|speed| 0.05 * speed);
        let wheels: f32 = rim_speeds
            .zip(forces)
            .map(|(speed, force)| speed * force)
            .sum();
        let [fx, fy, torque] = base.wrench(forces.into_iter());
        let body = fx * twist.x + fy * twist.y + torque * twist.theta;
        assert!((wheels - body).abs() < 1e-4, "{wheels} {body}");
    }

    #[test]
    fn degenerate_wheel_layouts_are_refused() {
        assert_eq!(omni(&[0.0, 120.0]), Err(OmniError::TooFew(2)));
        assert_eq!(omni(&[0.0, 0.0, 0.0]), Err(OmniError::Degenerate));
        assert_eq!(omni(&[0.0, 180.0, 0.0]), Err(OmniError::Degenerate));
        assert_eq!(omni(&[0.0, f32::NAN, 90.0]), Err(OmniError::InvalidSize));
        assert_eq!(
            OmniKinematics::new(&[0.0, 2.0, 4.0], 0.0, 0.2),
            Err(OmniError::InvalidSize)
        );
    }

    #[test]
    fn a_limited_twist_keeps_its_direction() {
        let base = omni(&[60.0, 180.0, 300.0]).expect("a base");
        let twist = Twist {
            x: 6.0,
            y: -3.0,
            theta: 8.0,
        };
        let limited = base.limit_twist(twist, 2.0);
        let fastest = base
            .wheel_speeds(limited)
            .fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!((fastest * 0.05 - 2.0).abs() < 1e-4);
        assert!((limited.x / limited.theta - twist.x / twist.theta).abs() < 1e-5);
        assert_eq!(base.limit_twist(Twist::default(), 2.0), Twist::default());
    }

    proptest! {
        #[test]
        fn forward_kinematics_inverts_inverse_kinematics(
            angles in prop::collection::vec(0.0f32..360.0, 3..=4),
            x in -5.0f32..5.0, y in -5.0f32..5.0, theta in -10.0f32..10.0,
        ) {
            let Ok(base) = omni(&angles) else { return Ok(()) };
            let twist = Twist { x, y, theta };
            let speeds: Vec<_> = base.wheel_speeds(twist).collect();
            let (back, slip) = base.twist(&speeds);
            prop_assert!(twist_difference(back, twist) < 0.01, "{:?} {:?}", back, twist);
            prop_assert!(slip < 1e-3);
        }
    }
}
