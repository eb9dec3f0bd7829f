//! How do robots and ball move? Robots in two dimensions, simulated by rapier; the ball in three.

mod ball_body;
mod contact;
mod field_walls;
mod state;

pub use contact::{OTHER_HALF_SIDE, STEP};
pub(crate) use contact::{STEP_NANOSECONDS, other_shape, overlap, own_shape};
pub(crate) use field_walls::Room;
pub use state::{BallState, RobotState};

use localize::field::Field;
use localize::frames::{At, FieldFrame, Pose};
use localize::omni::{OmniError, Twist};
use localize::robot::{BaseConfig, BodyConfig};
use localize::sample::Odometry;
use localize::stamp::Stamp;
use nalgebra::Vector2;
use rapier2d::prelude::*;

use crate::base::SimBase;
use crate::scenario::Scenario;
use ball_body::{BallBody, Footprint, RobotTop};
use contact::{BODY_RESTITUTION, ROBOT_GROUP, member_of, own_radius};
use localize::world::TeamColour;

/// Mass of each of the other robots, kilograms (the league allows 40).
const OTHER_MASS: f32 = 35.0;
/// Maximum acceleration of the other robots, m/s² and rad/s².
const OTHER_ACCELERATION: f32 = 3.5;
const OTHER_TURN_ACCELERATION: f32 = 20.0;
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
    robot_radius: f32,
}

/// One of the other robots.
struct OtherRobot {
    body: RigidBodyHandle,
    team: TeamColour,
    target_velocity: [f32; 3],
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
        field_walls::insert(&mut physics, field, scenario.ball.restitution);
        let (robot, _) = physics.insert(
            dynamic(scenario.start.pose()),
            ColliderBuilder::new(own_shape(body))
                .collision_groups(member_of(ROBOT_GROUP))
                .mass(base.mass)
                .restitution(BODY_RESTITUTION)
                .restitution_combine_rule(CoefficientCombineRule::Min)
                .friction(0.2),
        );
        let others = others
            .iter()
            .map(|&(pose, team)| {
                let collider = ColliderBuilder::new(other_shape())
                    .collision_groups(member_of(ROBOT_GROUP))
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
            .then(|| BallBody::insert(&mut physics, &scenario.ball, field));
        Ok(SimWorld {
            physics,
            robot,
            others,
            ball,
            base: SimBase::new(base, &scenario.wheels)?,
            last_velocity: Vector::ZERO,
            last_acceleration: Vector2::zeros(),
            robot_radius: own_radius(body),
        })
    }

    /// Advances by one `STEP`; our robot's motors follow `command` (robot frame).
    pub fn step(&mut self, command: Twist) {
        self.drive_robot(command);
        for index in 0..self.others.len() {
            self.drive_other(index);
        }
        let robots = self.robot_tops();
        if let Some(ball) = &mut self.ball {
            ball.step(&mut self.physics, &robots);
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
        Some(self.ball.as_ref()?.state(&self.physics))
    }

    /// What a ball in the air meets from above; none while it is on the ground.
    fn robot_tops(&self) -> Vec<RobotTop> {
        let is_low = |ball: BallState| ball.height <= 0.0;
        if self.ball().is_none_or(is_low) {
            return Vec::new();
        }
        let top = |state: RobotState, footprint| RobotTop {
            centre: Vector2::new(state.pose.x, state.pose.y),
            velocity: state.velocity.into(),
            footprint,
        };
        let radius = self.robot_radius;
        let others = self.others().map(|state| {
            let (sin, cos) = state.pose.theta.sin_cos();
            let half = OTHER_HALF_SIDE;
            top(state, Footprint::Square { half, sin, cos })
        });
        let own = top(self.robot(), Footprint::Round { radius });
        others.chain([own]).collect()
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

    /// Places the ball on the ground with a velocity (m/s, field frame), sliding without spin.
    pub fn place_ball(&mut self, at: At<FieldFrame>, velocity: [f32; 2]) {
        self.set_ball_state(&BallState::on_ground(at, velocity));
    }

    /// Places the ball anywhere with a velocity, without spin.
    pub fn set_ball_state(&mut self, state: &BallState) {
        if let Some(ball) = &mut self.ball {
            ball.set_state(&mut self.physics, state);
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

#[cfg(test)]
mod flight_tests;
#[cfg(test)]
mod tests;
