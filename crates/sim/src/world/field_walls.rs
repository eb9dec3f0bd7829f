//! What encloses the field? Goal posts, nets, and the barrier around the carpet.

use std::fmt;

use localize::field::Field;
use localize::frames::Pose;
use rapier2d::prelude::*;

use super::contact::{
    BARRIER_GROUP, DEPTH_MAX, GOAL_GROUP, NET_RESTITUTION, WALL_THICKNESS, member_of, physics_pose,
};

/// Distance from the carpet to the barrier around it, metres.
const BARRIER_GAP: f32 = 0.5;

/// The area inside the barrier, and the goals where they stand behind it; metres.
pub(crate) struct Room {
    half_x: f32,
    half_y: f32,
    /// x of the end of a goal, and half its width.
    goal: [f32; 2],
}

impl Room {
    pub(crate) fn of(field: &Field) -> Self {
        // Walls stand on the boundary of a field that has them; other fields have a barrier outside the carpet.
        let (gap, (half_x, half_y)) = match field.config.walls {
            true => (0.0, (field.config.length / 2.0, field.config.width / 2.0)),
            false => (BARRIER_GAP, field.carpet_half_extent()),
        };
        let goal = &field.config.goal;
        Room {
            half_x: half_x + gap,
            half_y: half_y + gap,
            goal: [field.config.length / 2.0 + goal.depth, goal.width / 2.0],
        }
    }

    /// True if a body at a pose is inside, up to rounding.
    pub(crate) fn contains(&self, shape: &SharedShape, pose: Pose) -> bool {
        let bounds = shape.compute_aabb(&physics_pose(pose));
        let reach = bounds.mins.abs().max(bounds.maxs.abs()) - Vector::splat(DEPTH_MAX);
        let within = |[x, y]: [f32; 2]| reach.x <= x && reach.y <= y;
        within([self.half_x, self.half_y]) || within(self.goal)
    }
}

impl fmt::Display for Room {
    fn fmt(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            text,
            "a whole body within ±{:.2} and ±{:.2}",
            self.half_x, self.half_y
        )
    }
}

/// Goal posts, nets (or goal walls), and the barrier around the carpet.
pub(super) fn insert(physics: &mut PhysicsWorld, field: &Field, restitution: f32) {
    let mut wall =
        |group: Group, [x, y]: [f32; 2], [half_x, half_y]: [f32; 2], restitution: f32| {
            let collider = ColliderBuilder::cuboid(half_x, half_y)
                .translation(Vector::new(x, y))
                .collision_groups(member_of(group))
                .restitution(restitution)
                .restitution_combine_rule(CoefficientCombineRule::Min)
                .friction(0.3);
            physics.insert_collider(collider, None);
        };
    let goal = &field.config.goal;
    let half_post = (goal.post / 2.0).max(0.01);
    let half_wall = WALL_THICKNESS / 2.0;
    if goal.width > 0.0 {
        for side in [1.0, -1.0] {
            let line = side * field.config.length / 2.0;
            let middle = line + side * goal.depth / 2.0;
            for across in [1.0, -1.0] {
                let post = across * (goal.width / 2.0 + half_post);
                wall(GOAL_GROUP, [line, post], [half_post; 2], restitution);
                if goal.depth > 0.0 {
                    let net = across * (goal.width / 2.0 + half_wall);
                    wall(
                        GOAL_GROUP,
                        [middle, net],
                        [goal.depth / 2.0, half_wall],
                        NET_RESTITUTION,
                    );
                }
            }
            if goal.depth > 0.0 {
                let back = line + side * (goal.depth + half_wall);
                wall(
                    GOAL_GROUP,
                    [back, 0.0],
                    [half_wall, goal.width / 2.0],
                    NET_RESTITUTION,
                );
            }
        }
    }
    let room = Room::of(field);
    // Thick, so that nothing is ever squeezed through.
    let (x, y, thick) = (room.half_x + 0.5, room.half_y + 0.5, 0.5);
    // Walls that are closer to the goal line than the goal's depth leave the goal's mouth open.
    let [goal_end, goal_half_width] = room.goal;
    let mouth = if goal.depth > 0.0 && room.half_x < goal_end {
        goal_half_width
    } else {
        0.0
    };
    let half_end = (y + thick - mouth) / 2.0;
    for side in [1.0, -1.0] {
        wall(
            BARRIER_GROUP,
            [0.0, side * y],
            [x + thick, thick],
            restitution,
        );
        for end in [1.0, -1.0] {
            let at = [end * x, side * (mouth + half_end)];
            wall(BARRIER_GROUP, at, [thick, half_end], restitution);
        }
    }
}
