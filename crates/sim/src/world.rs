//! How do robots and ball move? Our robot, the others and the ball in two dimensions, simulated by rapier.

use localize::field::Field;
use localize::frames::{At, FieldFrame, Pose};
use localize::omni::{OmniError, Twist};
use localize::robot::{BaseConfig, BodyConfig};
use localize::sample::Odometry;
use localize::stamp::Stamp;
use nalgebra::Vector2;
use rapier2d::prelude::*;

use crate::ball::BallFriction;
use crate::base::SimBase;
use crate::scenario::{BallConfig, Scenario};
use localize::world::TeamColour;

/// Time step, seconds: a ball at 12 m/s moves a tenth of its diameter.
pub const STEP: f32 = (STEP_NANOSECONDS as f64 * 1e-9) as f32;
/// The time step in whole nanoseconds, so that stamps are exact.
pub(crate) const STEP_NANOSECONDS: i64 = 2_000_000;

/// Mass of each of the other robots, kilograms (the league allows 40).
const OTHER_MASS: f32 = 35.0;
/// Half the side of the other robots, metres (the league allows 0.26).
pub const OTHER_HALF_SIDE: f32 = 0.24;
/// Maximum acceleration of the other robots, m/s² and rad/s².
const OTHER_ACCELERATION: f32 = 3.5;
const OTHER_TURN_ACCELERATION: f32 = 20.0;
/// Coefficient of restitution of robots' bodies.
const BODY_RESTITUTION: f32 = 0.3;
/// Coefficient of restitution of nets, which absorb most of a ball's speed.
const NET_RESTITUTION: f32 = 0.1;
/// Thickness of nets and walls, metres: a ball at 12 m/s crosses it in four steps.
const WALL_THICKNESS: f32 = 0.1;
/// Distance from the carpet to the barrier around it, metres.
const BARRIER_GAP: f32 = 0.5;

/// The dynamics of all bodies; stamps and random numbers are the caller's.
pub struct SimWorld {
    physics: PhysicsWorld,
    robot: RigidBodyHandle,
    others: Vec<OtherRobot>,
    ball: Option<BallBody>,
    base: SimBase,
    /// Our robot's velocity at the end of the last step, so that impulses between steps count as acceleration.
    last_velocity: Vector,
    last_acceleration: Vector2<f32>,
}

/// One of the other robots.
struct OtherRobot {
    body: RigidBodyHandle,
    team: TeamColour,
    target_velocity: [f32; 3],
}

struct BallBody {
    body: RigidBodyHandle,
    friction: BallFriction,
    surface_velocity: Vector2<f32>,
}

/// Pose and velocity of a robot, field frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotState {
    /// Pose.
    pub pose: Pose,
    /// m/s along the field's x and y.
    pub velocity: [f32; 2],
    /// Yaw rate, rad/s counter-clockwise.
    pub yaw_rate: f32,
    /// The colour of its marker.
    pub team: TeamColour,
}

/// Position and velocity of the ball, field frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallState {
    /// Ground contact.
    pub at: At<FieldFrame>,
    /// m/s along the field's x and y.
    pub velocity: [f32; 2],
}

impl SimWorld {
    /// Places all bodies by the scenario; `others` are poses and teams of the other robots. Fails for wheels that cannot
    /// drive in every direction.
    pub fn new(
        field: &Field,
        base: &BaseConfig,
        body: &BodyConfig,
        scenario: &Scenario,
        others: &[(Pose, TeamColour)],
    ) -> Result<Self, OmniError> {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::ZERO;
        physics.integration_parameters.dt = STEP;
        insert_field(&mut physics, field, scenario.ball.restitution);
        let (robot, _) = physics.insert(
            dynamic(scenario.start.pose()),
            ColliderBuilder::ball(body.radius.max(0.05))
                .mass(base.mass)
                .restitution(BODY_RESTITUTION)
                .restitution_combine_rule(CoefficientCombineRule::Min)
                .friction(0.2),
        );
        let others = others
            .iter()
            .map(|&(pose, team)| {
                let collider = ColliderBuilder::cuboid(OTHER_HALF_SIDE, OTHER_HALF_SIDE)
                    .mass(OTHER_MASS)
                    .restitution(BODY_RESTITUTION)
                    .restitution_combine_rule(CoefficientCombineRule::Min)
                    .friction(0.2);
                let (body, _) = physics.insert(dynamic(pose), collider);
                OtherRobot {
                    body,
                    team,
                    target_velocity: [0.0; 3],
                }
            })
            .collect();
        let ball = scenario
            .ball
            .present
            .then(|| insert_ball(&mut physics, &scenario.ball));
        Ok(SimWorld {
            physics,
            robot,
            others,
            ball,
            base: SimBase::new(base, &scenario.wheels)?,
            last_velocity: Vector::ZERO,
            last_acceleration: Vector2::zeros(),
        })
    }

    /// Advances by one `STEP`; our robot's motors follow `command` (robot frame).
    pub fn step(&mut self, command: Twist) {
        self.drive_robot(command);
        for index in 0..self.others.len() {
            self.drive_other(index);
        }
        if let Some(ball) = &mut self.ball {
            let body = &mut self.physics.bodies[ball.body];
            let velocity = body.linvel();
            let (slower, surface_velocity) = ball.friction.step(
                Vector2::new(velocity.x, velocity.y),
                ball.surface_velocity,
                STEP,
            );
            ball.surface_velocity = surface_velocity;
            body.set_linvel(Vector::new(slower.x, slower.y), true);
        }
        self.physics.step();
        let velocity = self.physics.bodies[self.robot].linvel();
        let change = (velocity - self.last_velocity) / STEP;
        self.last_velocity = velocity;
        self.last_acceleration = Vector2::new(change.x, change.y);
    }

    fn drive_robot(&mut self, command: Twist) {
        let state = self.robot();
        let (sin, cos) = state.pose.theta.sin_cos();
        let [vx, vy] = state.velocity;
        let real = Twist {
            x: cos * vx + sin * vy,
            y: -sin * vx + cos * vy,
            theta: state.yaw_rate,
        };
        let [fx, fy, torque] = self.base.step(command, real, STEP);
        let body = &mut self.physics.bodies[self.robot];
        body.reset_forces(true);
        body.reset_torques(true);
        body.add_force(Vector::new(cos * fx - sin * fy, sin * fx + cos * fy), true);
        body.add_torque(torque, true);
    }

    fn drive_other(&mut self, index: usize) {
        let other = &self.others[index];
        let body = &mut self.physics.bodies[other.body];
        let velocity = body.linvel();
        let velocity_error = Vector2::new(
            other.target_velocity[0] - velocity.x,
            other.target_velocity[1] - velocity.y,
        );
        // Time constant of 0.1 s, within the limits of the motors.
        let acceleration = (velocity_error * 10.0).cap_magnitude(OTHER_ACCELERATION);
        let angular_acceleration = ((other.target_velocity[2] - body.angvel()) * 10.0)
            .clamp(-OTHER_TURN_ACCELERATION, OTHER_TURN_ACCELERATION);
        let (ax, ay) = (acceleration.x * STEP, acceleration.y * STEP);
        body.set_linvel(velocity + Vector::new(ax, ay), true);
        body.set_angvel(body.angvel() + angular_acceleration * STEP, true);
    }

    /// State of our robot.
    pub fn robot(&self) -> RobotState {
        self.state(self.robot, TeamColour::Cyan)
    }

    /// States of the other robots, in the order of `new`.
    pub fn others(&self) -> impl Iterator<Item = RobotState> + '_ {
        self.others
            .iter()
            .map(|other| self.state(other.body, other.team))
    }

    /// State of the ball, if there is one.
    pub fn ball(&self) -> Option<BallState> {
        let body = &self.physics.bodies[self.ball.as_ref()?.body];
        let (at, velocity) = (body.translation(), body.linvel());
        Some(BallState {
            at: At::new(at.x, at.y),
            velocity: [velocity.x, velocity.y],
        })
    }

    /// Mean acceleration of our robot over the last step, field frame, m/s².
    pub fn acceleration(&self) -> [f32; 2] {
        [self.last_acceleration.x, self.last_acceleration.y]
    }

    /// Odometry since the last call; `stuck` is a wheel whose encoder does not count.
    pub fn read_encoders(&mut self, stamp: Stamp, stuck: Option<usize>) -> Odometry {
        self.base.read_encoders(stamp, stuck)
    }

    /// Angle of each wheel of our robot since the start, radians.
    pub fn wheel_angles(&self) -> impl Iterator<Item = f64> + '_ {
        self.base.wheel_angles()
    }

    /// Target velocity of another robot, field frame (m/s, m/s, rad/s).
    pub fn set_other_velocity(&mut self, index: usize, target: [f32; 3]) {
        if let Some(other) = self.others.get_mut(index) {
            other.target_velocity = target;
        }
    }

    /// Copies the state of another robot from another world; its velocity becomes its target velocity.
    pub fn set_other_state(&mut self, index: usize, state: &RobotState) {
        if let Some(other) = self.others.get_mut(index) {
            let ([vx, vy], pose) = (state.velocity, state.pose);
            other.target_velocity = [vx, vy, state.yaw_rate];
            let body = &mut self.physics.bodies[other.body];
            body.set_translation(Vector::new(pose.x, pose.y), true);
            body.set_rotation(Rotation::from_angle(pose.theta), true);
            body.set_linvel(Vector::new(vx, vy), true);
            body.set_angvel(state.yaw_rate, true);
        }
    }

    /// Moves our robot to a pose, at rest; nothing else changes.
    pub fn kidnap(&mut self, pose: Pose) {
        let body = &mut self.physics.bodies[self.robot];
        body.set_translation(Vector::new(pose.x, pose.y), true);
        body.set_rotation(Rotation::from_angle(pose.theta), true);
        body.set_linvel(Vector::ZERO, true);
        body.set_angvel(0.0, true);
        self.base.stop_motors();
        self.last_velocity = Vector::ZERO;
    }

    /// Moves another robot to a pose, at rest; ignores an index out of range.
    pub fn place_other(&mut self, index: usize, pose: Pose) {
        if let Some(other) = self.others.get(index) {
            let body = &mut self.physics.bodies[other.body];
            body.set_translation(Vector::new(pose.x, pose.y), true);
            body.set_rotation(Rotation::from_angle(pose.theta), true);
            body.set_linvel(Vector::ZERO, true);
            body.set_angvel(0.0, true);
        }
    }

    /// Applies an impulse to our robot (N s, field frame).
    pub fn apply_impulse(&mut self, impulse: [f32; 2]) {
        self.physics.bodies[self.robot].apply_impulse(Vector::new(impulse[0], impulse[1]), true);
    }

    /// Places the ball with a velocity (m/s, field frame), sliding without spin.
    pub fn place_ball(&mut self, at: At<FieldFrame>, velocity: [f32; 2]) {
        if let Some(ball) = &mut self.ball {
            let body = &mut self.physics.bodies[ball.body];
            body.set_translation(Vector::new(at.x, at.y), true);
            body.set_linvel(Vector::new(velocity[0], velocity[1]), true);
            ball.surface_velocity = Vector2::zeros();
        }
    }

    fn state(&self, handle: RigidBodyHandle, team: TeamColour) -> RobotState {
        let body = &self.physics.bodies[handle];
        let (at, velocity) = (body.translation(), body.linvel());
        RobotState {
            pose: Pose::new(at.x, at.y, body.rotation().angle()),
            velocity: [velocity.x, velocity.y],
            yaw_rate: body.angvel(),
            team,
        }
    }
}

fn dynamic(pose: Pose) -> RigidBodyBuilder {
    RigidBodyBuilder::dynamic()
        .translation(Vector::new(pose.x, pose.y))
        .rotation(pose.theta)
        .can_sleep(false)
}

fn insert_ball(physics: &mut PhysicsWorld, config: &BallConfig) -> BallBody {
    let [x, y] = config.position;
    let [vx, vy] = config.velocity;
    // `BallFriction` decelerates the ball; rapier's damping is off.
    let body = RigidBodyBuilder::dynamic()
        .translation(Vector::new(x, y))
        .linvel(Vector::new(vx, vy))
        .can_sleep(false)
        .ccd_enabled(true);
    let collider = ColliderBuilder::ball(config.diameter / 2.0)
        .mass(config.mass)
        .restitution(config.restitution)
        .friction(0.0);
    let (body, _) = physics.insert(body, collider);
    BallBody {
        body,
        friction: BallFriction {
            sliding_friction: config.sliding_friction,
            rolling_deceleration: config.rolling_deceleration,
        },
        surface_velocity: Vector2::zeros(),
    }
}

/// Goal posts, nets (or goal walls), and the barrier around the carpet.
fn insert_field(physics: &mut PhysicsWorld, field: &Field, restitution: f32) {
    let mut wall = |x: f32, y: f32, half_x: f32, half_y: f32, restitution: f32| {
        let collider = ColliderBuilder::cuboid(half_x, half_y)
            .translation(Vector::new(x, y))
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
                wall(line, post, half_post, half_post, restitution);
                if goal.depth > 0.0 {
                    let net = across * (goal.width / 2.0 + half_wall);
                    wall(middle, net, goal.depth / 2.0, half_wall, NET_RESTITUTION);
                }
            }
            if goal.depth > 0.0 {
                let back = line + side * (goal.depth + half_wall);
                wall(back, 0.0, half_wall, goal.width / 2.0, NET_RESTITUTION);
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
        wall(0.0, side * y, x + thick, thick, restitution);
        for end in [1.0, -1.0] {
            wall(
                end * x,
                side * (mouth + half_end),
                thick,
                half_end,
                restitution,
            );
        }
    }
}

#[cfg(test)]
mod tests;
