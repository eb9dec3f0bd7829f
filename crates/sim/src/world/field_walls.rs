//! What encloses the field? Goal posts, nets, and the barrier around the carpet.

use localize::field::Field;
use rapier2d::prelude::*;

use super::contact::{BARRIER_GROUP, GOAL_GROUP, NET_RESTITUTION, WALL_THICKNESS, member_of};

/// Distance from the carpet to the barrier around it, metres.
const BARRIER_GAP: f32 = 0.5;

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
    // Walls stand on the boundary of a field that has them; other fields have a barrier outside the carpet.
    let (gap, (half_x, half_y)) = match field.config.walls {
        true => (0.0, (field.config.length / 2.0, field.config.width / 2.0)),
        false => (BARRIER_GAP, field.carpet_half_extent()),
    };
    // Thick, so that nothing is ever squeezed through.
    let (x, y, thick) = (half_x + gap + 0.5, half_y + gap + 0.5, 0.5);
    // Walls that are closer to the goal line than the goal's depth leave the goal's mouth open.
    let mouth = if goal.depth > 0.0 && half_x + gap < field.config.length / 2.0 + goal.depth {
        goal.width / 2.0
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
