//! Which bodies collide, how elastic are they, and how long is a time step?

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
