//! Which bodies collide, what are their outlines, how elastic are they, and how long is a time step?

use localize::frames::Pose;
use localize::robot::BodyConfig;
use rapier2d::parry::query;
use rapier2d::prelude::*;

/// Time step, seconds: a ball at 12 m/s moves a tenth of its diameter.
pub const STEP: f32 = (STEP_NANOSECONDS as f64 * 1e-9) as f32;
/// The time step in whole nanoseconds, so that stamps are exact.
pub(crate) const STEP_NANOSECONDS: i64 = 2_000_000;

/// Coefficient of restitution of robots' bodies.
pub(super) const BODY_RESTITUTION: f32 = 0.3;
/// Coefficient of restitution of nets, which absorb most of a ball's speed.
pub(super) const NET_RESTITUTION: f32 = 0.1;

/// Thickness of nets and walls, metres: a ball at 12 m/s crosses it in four steps.
pub(super) const WALL_THICKNESS: f32 = 0.1;

/// Half the side of the other robots, metres (the league allows 0.26).
pub const OTHER_HALF_SIDE: f32 = 0.24;

/// Depth to which bodies may start inside one another, metres: rounding.
pub(super) const DEPTH_MAX: f32 = 1e-3;

/// Groups of bodies: the ball in the air passes over some of them.
pub(super) const ROBOT_GROUP: Group = Group::GROUP_1;
/// Posts and nets.
pub(super) const GOAL_GROUP: Group = Group::GROUP_2;
/// Walls around the field: a ball cannot pass over them.
pub(super) const BARRIER_GROUP: Group = Group::GROUP_3;
/// The ball.
pub(super) const BALL_GROUP: Group = Group::GROUP_4;

/// In one group, and colliding with every group.
pub(super) fn member_of(group: Group) -> InteractionGroups {
    InteractionGroups::new(group, Group::ALL, InteractionTestMode::And)
}

/// Outline of our robot.
pub(crate) fn own_shape(body: &BodyConfig) -> SharedShape {
    SharedShape::ball(own_radius(body))
}

/// Radius of our robot, metres.
pub(super) fn own_radius(body: &BodyConfig) -> f32 {
    body.radius.max(0.05)
}

/// Outline of each of the other robots.
pub(crate) fn other_shape() -> SharedShape {
    SharedShape::cuboid(OTHER_HALF_SIDE, OTHER_HALF_SIDE)
}

/// True if one body is inside another, by more than rounding.
pub(crate) fn overlap(
    (one, at): (&SharedShape, Pose),
    (other, other_at): (&SharedShape, Pose),
) -> bool {
    let (at, other_at) = (physics_pose(at), physics_pose(other_at));
    let contact = query::contact(&at, one.as_ref(), &other_at, other.as_ref(), 0.0);
    contact.is_ok_and(|contact| contact.is_some_and(|contact| contact.dist < -DEPTH_MAX))
}

pub(super) fn physics_pose(pose: Pose) -> rapier2d::math::Pose {
    rapier2d::math::Pose::new(Vector::new(pose.x, pose.y), pose.theta)
}
