//! How does the ball move among robots and goals? Rapier moves it in the plane; height, flight and impacts from above or
//! below are computed here. In the air it collides with what is as high as its centre.

use localize::field::Field;
use localize::frames::At;
use nalgebra::{Vector2, Vector3};
use rapier2d::prelude::*;

use super::contact::{
    BALL_GROUP, BARRIER_GROUP, BODY_RESTITUTION, GOAL_GROUP, NET_RESTITUTION, ROBOT_GROUP, STEP,
    WALL_THICKNESS, member_of,
};
use super::state::BallState;
use crate::ball::BallFriction;
use crate::ball_flight::{BallFlight, BallMotion, reflect};
use crate::scenario::BallConfig;

/// Height of all robots, metres: the league's largest.
pub(super) const ROBOT_HEIGHT: f32 = 0.8;
/// Tangent of the angle by which a goal's net falls off behind the crossbar, so that no ball rests on it.
const NET_SLOPE: f32 = 0.3;

/// The ball.
pub(super) struct BallBody {
    body: RigidBodyHandle,
    collider: ColliderHandle,
    radius: f32,
    friction: BallFriction,
    flight: BallFlight,
    restitution: f32,
    goals: GoalFrames,
    /// Of the lowest point above the carpet, metres.
    height: f32,
    vertical_velocity: f32,
    surface_velocity: Vector2<f32>,
}

/// Both goals' crossbars and nets; none if `width` is 0.
struct GoalFrames {
    /// x of the goal line, metres.
    line: f32,
    width: f32,
    height: f32,
    depth: f32,
    post: f32,
}

/// A robot as the ball meets it from above, field frame.
pub(super) struct RobotTop {
    pub(super) centre: Vector2<f32>,
    pub(super) velocity: Vector2<f32>,
    /// Sine and cosine of its heading, and half its side; a round robot has a radius instead.
    pub(super) footprint: Footprint,
}

/// Outline of a robot.
pub(super) enum Footprint {
    Round { radius: f32 },
    Square { half: f32, sin: f32, cos: f32 },
}

impl BallBody {
    pub(super) fn insert(physics: &mut PhysicsWorld, config: &BallConfig, field: &Field) -> Self {
        let [x, y] = config.position;
        let [vx, vy] = config.velocity;
        // `BallFriction` and `BallFlight` decelerate the ball; rapier's damping is off.
        let body = RigidBodyBuilder::dynamic()
            .translation(Vector::new(x, y))
            .linvel(Vector::new(vx, vy))
            .can_sleep(false)
            .ccd_enabled(true);
        let collider = ColliderBuilder::ball(config.diameter / 2.0)
            .mass(config.mass)
            .restitution(config.restitution)
            .collision_groups(member_of(BALL_GROUP))
            .friction(0.0);
        let (body, collider) = physics.insert(body, collider);
        let goal = &field.config.goal;
        BallBody {
            body,
            collider,
            radius: config.diameter / 2.0,
            friction: BallFriction {
                sliding_friction: config.sliding_friction,
                rolling_deceleration: config.rolling_deceleration,
            },
            flight: BallFlight::new(config),
            restitution: config.restitution,
            goals: GoalFrames {
                line: field.config.length / 2.0,
                width: goal.width,
                height: goal.height,
                depth: goal.depth,
                post: goal.post,
            },
            height: config.height,
            vertical_velocity: config.vertical_velocity,
            surface_velocity: Vector2::zeros(),
        }
    }

    pub(super) fn state(&self, physics: &PhysicsWorld) -> BallState {
        let body = &physics.bodies[self.body];
        let (at, velocity) = (body.translation(), body.linvel());
        BallState {
            at: At::new(at.x, at.y),
            velocity: [velocity.x, velocity.y],
            height: self.height,
            vertical_velocity: self.vertical_velocity,
        }
    }

    /// Sets position and velocity, without spin.
    pub(super) fn set_state(&mut self, physics: &mut PhysicsWorld, state: &BallState) {
        let body = &mut physics.bodies[self.body];
        body.set_translation(Vector::new(state.at.x, state.at.y), true);
        body.set_linvel(Vector::new(state.velocity[0], state.velocity[1]), true);
        self.height = state.height.max(0.0);
        self.vertical_velocity = state.vertical_velocity;
        self.surface_velocity = Vector2::zeros();
    }

    /// Applies friction or flight to the velocities of this time step; rapier then moves the ball in the plane.
    pub(super) fn step(&mut self, physics: &mut PhysicsWorld, robots: &[RobotTop]) {
        let body = &mut physics.bodies[self.body];
        let (at, linvel) = (body.translation(), body.linvel());
        let velocity = Vector2::new(linvel.x, linvel.y);
        let mut motion = BallMotion {
            height: self.height,
            velocity: Vector3::new(velocity.x, velocity.y, self.vertical_velocity),
            surface_velocity: self.surface_velocity,
        };
        if motion.is_on_ground() {
            let (slower, spin) = self.friction.step(velocity, self.surface_velocity, STEP);
            motion = BallMotion {
                height: 0.0,
                velocity: Vector3::new(slower.x, slower.y, 0.0),
                surface_velocity: spin,
            };
        } else {
            motion = self.flight.step(motion, STEP);
            let at = Vector2::new(at.x, at.y);
            for robot in robots {
                self.bounce_off_robot(&mut motion, at, robot);
            }
            self.bounce_off_goals(&mut motion, at);
        }
        body.set_linvel(Vector::new(motion.velocity.x, motion.velocity.y), true);
        self.height = motion.height;
        self.vertical_velocity = motion.velocity.z;
        self.surface_velocity = motion.surface_velocity;
        let groups = self.groups_at(motion.height + self.radius);
        physics.colliders[self.collider].set_collision_groups(groups);
    }

    /// What is as high as the ball's centre, metres.
    fn groups_at(&self, centre: f32) -> InteractionGroups {
        let mut met = BARRIER_GROUP;
        if centre < ROBOT_HEIGHT {
            met |= ROBOT_GROUP;
        }
        if centre < self.goals.height {
            met |= GOAL_GROUP;
        }
        InteractionGroups::new(BALL_GROUP, met, InteractionTestMode::And)
    }

    /// The flat top of a robot and its rim.
    fn bounce_off_robot(&self, motion: &mut BallMotion, at: Vector2<f32>, robot: &RobotTop) {
        let above = motion.height + self.radius - ROBOT_HEIGHT;
        if !(0.0..self.radius).contains(&above) {
            return;
        }
        let outside = robot.footprint.offset(at - robot.centre);
        let distance = outside.norm();
        if distance * distance + above * above >= self.radius * self.radius {
            return;
        }
        // Camera and mirror make the top uneven: it sheds the ball away from its centre.
        let away = (at - robot.centre).try_normalize(1e-6);
        let shed = away.unwrap_or_else(Vector2::x) * NET_SLOPE * above.max(0.01);
        let normal = Vector3::new(outside.x + shed.x, outside.y + shed.y, above.max(0.01));
        let surface = Vector3::new(robot.velocity.x, robot.velocity.y, 0.0);
        let normal = normal.normalize();
        if let Some(velocity) = reflect(motion.velocity, surface, normal, BODY_RESTITUTION) {
            motion.velocity = velocity;
        }
        let clear = (self.radius * self.radius - distance * distance).max(0.0);
        motion.height = ROBOT_HEIGHT - self.radius + clear.sqrt();
    }

    /// Crossbars, and the nets above and behind them.
    fn bounce_off_goals(&self, motion: &mut BallMotion, at: Vector2<f32>) {
        let goals = &self.goals;
        let centre = motion.height + self.radius;
        let side = at.x.signum();
        // Positive behind the goal line.
        let behind = side * at.x - goals.line;
        if goals.width <= 0.0 || at.y.abs() > goals.width / 2.0 + goals.post {
            return;
        }
        if goals.post > 0.0 {
            let half = goals.post / 2.0;
            let up = centre - (goals.height + half);
            let (dx, dz) = (
                behind - behind.clamp(-half, half),
                up - up.clamp(-half, half),
            );
            let distance = dx.hypot(dz);
            if distance < self.radius && distance > 0.0 {
                let normal = Vector3::new(side * dx, 0.0, dz) / distance;
                if let Some(velocity) =
                    reflect(motion.velocity, Vector3::zeros(), normal, self.restitution)
                {
                    motion.velocity = velocity;
                }
                return;
            }
        }
        // The net on top ends behind the one at the back, so that a ball falls outside.
        if goals.depth <= 0.0 || !(0.0..goals.depth + WALL_THICKNESS).contains(&behind) {
            return;
        }
        let net = goals.height;
        let normal = if centre < net && centre + self.radius > net && behind < goals.depth {
            -Vector3::z()
        } else if centre >= net && motion.height < net {
            Vector3::new(side * NET_SLOPE, 0.0, 1.0).normalize()
        } else {
            return;
        };
        if let Some(velocity) = reflect(motion.velocity, Vector3::zeros(), normal, NET_RESTITUTION)
        {
            motion.velocity = velocity;
        }
        if normal.z > 0.0 {
            motion.height = net;
        }
    }
}

impl Footprint {
    /// Vector from the nearest point of the outline's inside to a point relative to its centre; zero inside.
    fn offset(&self, point: Vector2<f32>) -> Vector2<f32> {
        match *self {
            Footprint::Round { radius } => {
                let distance = point.norm();
                if distance <= radius {
                    Vector2::zeros()
                } else {
                    point * (1.0 - radius / distance)
                }
            }
            Footprint::Square { half, sin, cos } => {
                let (along, across) =
                    (cos * point.x + sin * point.y, cos * point.y - sin * point.x);
                let (dx, dy) = (
                    along - along.clamp(-half, half),
                    across - across.clamp(-half, half),
                );
                Vector2::new(cos * dx - sin * dy, sin * dx + cos * dy)
            }
        }
    }
}
