//! Coordinate frames: points and rigid motions of the plane, with their frames in the types.
//!
//! Field: origin at the field's centre, x along its length, y to the left of x. Robot: origin on the ground below
//! the mirror's axis, x forward, y left. Angles counter-clockwise, radians (nubot2013 eq. 1).

use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::Vector3;

use crate::math;

/// The field's frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldFrame {}

/// The robot's frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RobotFrame {}

/// A point on the ground in the coordinates of frame `F`.
#[derive(Debug, PartialEq)]
pub struct At<F> {
    /// Metres.
    pub x: f32,
    /// Metres.
    pub y: f32,
    frame: PhantomData<F>,
}

impl<F> Clone for At<F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<F> Copy for At<F> {}

impl<F> At<F> {
    /// A point at (x, y), metres.
    pub const fn new(x: f32, y: f32) -> Self {
        At {
            x,
            y,
            frame: PhantomData,
        }
    }

    /// Distance from the frame's origin.
    pub fn distance(self) -> f32 {
        math::hypot(self.x, self.y)
    }

    /// Distance between two points of one frame.
    pub fn distance_to(self, other: At<F>) -> f32 {
        math::hypot(self.x - other.x, self.y - other.y)
    }

    /// Direction from the frame's origin, radians.
    pub fn bearing(self) -> f32 {
        math::atan2(self.y, self.x)
    }
}

/// The rigid motion that takes coordinates of frame `B` to frame `A`: `a = a_from_b * b`.
///
/// ```
/// use localize::{At, Pose};
///
/// // One metre left of the field's centre, looking along y; a ball 2 m ahead of the robot.
/// let field_from_robot = Pose::new(0.0, 1.0, std::f32::consts::FRAC_PI_2);
/// let ball = field_from_robot * At::new(2.0, 0.0);
/// assert!(ball.distance_to(At::new(0.0, 3.0)) < 1e-6);
/// let seen_again = field_from_robot.inverse() * ball;
/// assert!(seen_again.distance_to(At::new(2.0, 0.0)) < 1e-6);
/// ```
#[derive(Debug, PartialEq)]
pub struct Tf<A, B> {
    /// B's origin in A, metres.
    pub x: f32,
    /// B's origin in A, metres.
    pub y: f32,
    /// Direction of B's x axis in A, radians in (−π, π].
    pub theta: f32,
    frames: PhantomData<(A, B)>,
}

impl<A, B> Clone for Tf<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, B> Copy for Tf<A, B> {}

impl<A, B> Tf<A, B> {
    /// From the origin (metres) and heading (radians, wrapped here) of B in A.
    pub fn new(x: f32, y: f32, theta: f32) -> Self {
        Tf {
            x,
            y,
            theta: wrap_angle(theta),
            frames: PhantomData,
        }
    }

    /// The motion that takes coordinates of A to B.
    pub fn inverse(self) -> Tf<B, A> {
        let (sin, cos) = math::sin_cos(self.theta);
        Tf::new(
            -cos * self.x - sin * self.y,
            sin * self.x - cos * self.y,
            -self.theta,
        )
    }

    /// Components of `self` − `reference`: (x, y, θ), metres and radians, θ wrapped.
    pub fn difference(self, reference: Self) -> Vector3<f32> {
        Vector3::new(
            self.x - reference.x,
            self.y - reference.y,
            wrap_angle(self.theta - reference.theta),
        )
    }

    /// B's origin as a point of A.
    pub fn origin(self) -> At<A> {
        At::new(self.x, self.y)
    }
}

impl<A, B> Mul<At<B>> for Tf<A, B> {
    type Output = At<A>;

    fn mul(self, point: At<B>) -> At<A> {
        let (sin, cos) = math::sin_cos(self.theta);
        At::new(
            self.x + cos * point.x - sin * point.y,
            self.y + sin * point.x + cos * point.y,
        )
    }
}

impl<A, B, C> Mul<Tf<B, C>> for Tf<A, B> {
    type Output = Tf<A, C>;

    fn mul(self, other: Tf<B, C>) -> Tf<A, C> {
        let (sin, cos) = math::sin_cos(self.theta);
        Tf::new(
            self.x + cos * other.x - sin * other.y,
            self.y + sin * other.x + cos * other.y,
            self.theta + other.theta,
        )
    }
}

/// The robot's pose on the field: field_from_robot.
pub type Pose = Tf<FieldFrame, RobotFrame>;

/// The angle in (−π, π] that equals `angle` modulo 2π.
pub fn wrap_angle(angle: f32) -> f32 {
    use std::f32::consts::{PI, TAU};
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn pose_times_inverse_is_identity() {
        let pose = Pose::new(3.0, -2.0, 2.5);
        let back = pose.inverse() * (pose * At::<RobotFrame>::new(0.7, -1.1));
        assert!((back.x - 0.7).abs() < 1e-5 && (back.y + 1.1).abs() < 1e-5);
    }

    #[test]
    fn angles_wrap_to_minus_pi_exclusive_pi_inclusive() {
        assert_eq!(wrap_angle(PI), PI);
        assert!((wrap_angle(-PI) - PI).abs() < 1e-6);
        assert!((wrap_angle(7.0 * PI + 0.1) - (-PI + 0.1)).abs() < 1e-5);
    }
}
