//! How do the other robots behave? A simple game: chase the ball, support, keep the goal, avoid collisions.

use std::f32::consts::{FRAC_PI_2, TAU};

use localize::field::Field;
use localize::frames::{At, FieldFrame, Pose, wrap_angle};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::scenario::OthersConfig;
use crate::world::{BallState, RobotState, SimWorld};
use localize::world::TeamColour;

/// Time between decisions, seconds.
pub(crate) const DECISION_PERIOD: f32 = 0.05;
/// Distance between robots' centres below which they evade each other, metres.
const AVOIDANCE_DISTANCE: f32 = 1.1;
/// Distance between a robot's centre and the ball at which it can kick, metres.
const KICK_REACH: f32 = 0.42;
/// Shortest time between two kicks of a robot, seconds.
const KICK_PAUSE: f32 = 1.0;
/// Standard deviation of a kick's direction, radians (triangular distribution).
const KICK_SPREAD: f32 = 0.25;
/// Height of the ball's lowest point above which a kicker does not reach it, metres.
const KICK_HEIGHT_MAX: f32 = 0.2;
/// Angle from a robot's heading within which it can kick, radians.
const KICK_HALF_ANGLE: f32 = 0.5;
/// Distance outside the lines beyond which the ball is returned, metres.
const THROW_IN_DISTANCE: f32 = 0.6;
/// Distance between two robots' centres at which their bodies are apart at any headings, metres.
const BODIES_DISTANCE: f32 = 0.7;
/// Distance of a goalkeeper from its goal line, metres.
const KEEPER_AHEAD: f32 = 0.45;

/// Behaviour of all other robots.
pub(crate) struct TeamBehaviour {
    robots: Vec<RobotBehaviour>,
    speed: f32,
    kick_speed: f32,
    lofted_share: f32,
    loft: f32,
    half_length: f32,
    half_width: f32,
    goal_half_width: f32,
}

struct RobotBehaviour {
    stationary: bool,
    keeper: bool,
    /// Where it drives without another task.
    home_position: Vector2<f32>,
    home_time_left: f32,
    kick_cooldown: f32,
}

impl TeamBehaviour {
    /// Initial poses of the robots: those listed, then teammates and opponents at random poses.
    pub(crate) fn new(
        field: &Field,
        config: &OthersConfig,
        robot: Pose,
        rng: &mut ChaCha8Rng,
    ) -> (Self, Vec<(Pose, TeamColour)>) {
        let (half_length, half_width) = (field.length / 2.0, field.width / 2.0);
        let mut placed_robots: Vec<(Pose, TeamColour)> = Vec::new();
        let mut robots = Vec::new();
        for placed in &config.placed {
            placed_robots.push((placed.pose(), placed.team));
            robots.push(RobotBehaviour::new(placed.stands, false));
        }
        for (team, count) in [
            (TeamColour::Cyan, config.mates),
            (TeamColour::Magenta, config.opponents),
        ] {
            for index in 0..count {
                // The opponents' first robot is a goalkeeper; ours may be the simulated robot.
                let keeper = index == 0 && (team == TeamColour::Magenta || count > 2);
                let goal = Pose::new(own_goal_sign(team) * (half_length - KEEPER_AHEAD), 0.0, 0.0);
                let pose = if keeper && is_clear(goal, BODIES_DISTANCE, robot, &placed_robots) {
                    goal
                } else {
                    free_place(half_length, half_width, robot, &placed_robots, rng)
                };
                placed_robots.push((pose, team));
                robots.push(RobotBehaviour::new(false, keeper));
            }
        }
        let behaviour = TeamBehaviour {
            robots,
            speed: config.speed,
            kick_speed: config.kick_speed,
            lofted_share: config.lofted_share,
            loft: config.loft_deg.to_radians(),
            half_length,
            half_width,
            goal_half_width: field.config.goal.width / 2.0,
        };
        (behaviour, placed_robots)
    }

    /// Sets the velocities of all robots; kicks and throw-ins move the ball.
    pub(crate) fn update(&mut self, field: &Field, world: &mut SimWorld, rng: &mut ChaCha8Rng) {
        let robot = world.robot();
        let others: Vec<RobotState> = world.others().collect();
        if let Some(position) = world.ball().and_then(|ball| throw_in(field, &ball)) {
            world.place_ball(position, [0.0; 2]);
        }
        let ball = world.ball();
        for index in 0..others.len() {
            let own = others[index];
            let chases =
                !self.robots[index].keeper && is_nearest(&ball, &others, index, &self.robots);
            let kick = ball.and_then(|ball| self.kick(index, &own, &ball, rng));
            if let (Some(velocity), Some(ball)) = (kick, ball) {
                world.set_ball_state(&BallState {
                    velocity: [velocity[0], velocity[1]],
                    vertical_velocity: velocity[2],
                    ..ball
                });
            }
            let behaviour = &mut self.robots[index];
            behaviour.kick_cooldown = (behaviour.kick_cooldown - DECISION_PERIOD).max(0.0);
            behaviour.home_time_left -= DECISION_PERIOD;
            if behaviour.home_time_left <= 0.0 {
                behaviour.home_time_left = 2.0 + 4.0 * rng.random::<f32>();
                behaviour.home_position = Vector2::new(
                    (rng.random::<f32>() * 2.0 - 1.0) * self.half_length * 0.85,
                    (rng.random::<f32>() * 2.0 - 1.0) * self.half_width * 0.85,
                );
            }
            let velocity = if self.robots[index].stationary {
                [0.0; 3]
            } else {
                let target = self.target(index, &own, ball.as_ref(), chases);
                let near = others
                    .iter()
                    .enumerate()
                    .filter(|(other, _)| *other != index);
                let near = near.map(|(_, state)| state.pose).chain([robot.pose]);
                self.steer(&own, target, ball.as_ref(), near, chases)
            };
            world.set_other_velocity(index, velocity);
        }
    }

    /// Target position of a robot.
    fn target(
        &self,
        index: usize,
        own: &RobotState,
        ball: Option<&BallState>,
        chases: bool,
    ) -> Vector2<f32> {
        let behaviour = &self.robots[index];
        let ball = ball.map(|ball| Vector2::new(ball.at.x, ball.at.y));
        match ball {
            Some(ball) if behaviour.keeper => {
                let reach = self.goal_half_width * 0.8;
                let x = own_goal_sign(own.team) * (self.half_length - KEEPER_AHEAD);
                Vector2::new(x, (ball.y * 0.3).clamp(-reach, reach))
            }
            Some(ball) if chases => {
                // Approach the ball from the side away from the opponents' goal.
                let goal = Vector2::new(-own_goal_sign(own.team) * self.half_length, 0.0);
                let away = (ball - goal).try_normalize(1e-3).unwrap_or_else(Vector2::x);
                let at = Vector2::new(own.pose.x, own.pose.y);
                let behind = (at - ball).dot(&away) > 0.1;
                if behind { ball } else { ball + away * 0.7 }
            }
            // The others shift with the ball, each about its home position.
            Some(ball) => behaviour.home_position * 0.6 + ball * 0.4,
            None => behaviour.home_position,
        }
    }

    /// The velocity (field frame) towards a target, evading robots nearby.
    fn steer(
        &self,
        own: &RobotState,
        target: Vector2<f32>,
        ball: Option<&BallState>,
        near: impl Iterator<Item = Pose>,
        chases: bool,
    ) -> [f32; 3] {
        let at = Vector2::new(own.pose.x, own.pose.y);
        let mut velocity = ((target - at) * 2.0).cap_magnitude(self.speed);
        for pose in near {
            let away = at - Vector2::new(pose.x, pose.y);
            let distance = away.norm();
            if distance < AVOIDANCE_DISTANCE && distance > 1e-3 {
                let push = (AVOIDANCE_DISTANCE - distance) / AVOIDANCE_DISTANCE
                    * self.speed
                    * if chases { 1.0 } else { 2.0 };
                // The sideways part prevents two robots from blocking each other forever.
                let side = Vector2::new(-away.y, away.x);
                velocity += (away + side * 0.5) / distance * push;
            }
        }
        let velocity = velocity.cap_magnitude(self.speed);
        let facing = ball.map_or(target, |ball| Vector2::new(ball.at.x, ball.at.y)) - at;
        let yaw_rate = wrap_angle(facing.y.atan2(facing.x) - own.pose.theta) * 3.0;
        [velocity.x, velocity.y, yaw_rate.clamp(-4.0, 4.0)]
    }

    /// The ball's velocity after a kick, if this robot kicks it now.
    fn kick(
        &mut self,
        index: usize,
        own: &RobotState,
        ball: &BallState,
        rng: &mut ChaCha8Rng,
    ) -> Option<[f32; 3]> {
        let behaviour = &mut self.robots[index];
        if behaviour.stationary || behaviour.kick_cooldown > 0.0 || !is_kickable(ball, own) {
            return None;
        }
        behaviour.kick_cooldown = KICK_PAUSE;
        let goal = At::<FieldFrame>::new(-own_goal_sign(own.team) * self.half_length, 0.0);
        let towards = (goal.y - ball.at.y).atan2(goal.x - ball.at.x);
        // Kicks go at most 45° to either side of the robot's heading.
        let off = wrap_angle(towards - own.pose.theta).clamp(-FRAC_PI_2 / 2.0, FRAC_PI_2 / 2.0);
        let deviation = (rng.random::<f32>() - rng.random::<f32>()) * KICK_SPREAD * 2.4;
        let direction = own.pose.theta + off + deviation;
        let speed = self.kick_speed * (0.4 + 0.6 * rng.random::<f32>());
        // No number is drawn where all kicks stay on the ground.
        let lofted = self.lofted_share > 0.0 && rng.random::<f32>() < self.lofted_share;
        Some(kick_velocity(
            speed,
            direction,
            if lofted { self.loft } else { 0.0 },
        ))
    }
}

/// New position of a ball that left the field: on the line, or at the centre after a goal.
pub(crate) fn throw_in(field: &Field, ball: &BallState) -> Option<At<FieldFrame>> {
    let (half_length, half_width) = (field.length / 2.0, field.width / 2.0);
    let (x, y) = (ball.at.x, ball.at.y);
    let out =
        x.abs() > half_length + THROW_IN_DISTANCE / 2.0 || y.abs() > half_width + THROW_IN_DISTANCE;
    let slow = ball.velocity[0].hypot(ball.velocity[1]) < 0.3;
    if !(out && slow && ball.height <= 0.0) {
        return None;
    }
    if y.abs() < field.config.goal.width / 2.0 && x.abs() > half_length {
        return Some(At::new(0.0, 0.0));
    }
    Some(At::new(
        x.clamp(-half_length + 0.3, half_length - 0.3),
        y.clamp(-half_width, half_width),
    ))
}

impl RobotBehaviour {
    fn new(stationary: bool, keeper: bool) -> Self {
        RobotBehaviour {
            stationary,
            keeper,
            home_position: Vector2::zeros(),
            home_time_left: 0.0,
            kick_cooldown: 0.0,
        }
    }
}

/// True if the ball lies before a robot's kicker.
pub(crate) fn is_kickable(ball: &BallState, robot: &RobotState) -> bool {
    let bearing = (ball.at.y - robot.pose.y).atan2(ball.at.x - robot.pose.x);
    ball.at.distance_to(robot.pose.origin()) <= KICK_REACH
        && ball.height <= KICK_HEIGHT_MAX
        && wrap_angle(bearing - robot.pose.theta).abs() < KICK_HALF_ANGLE
}

/// Velocity (x, y, up) of a ball that is kicked in a direction, at an angle above the carpet, m/s.
pub(crate) fn kick_velocity(speed: f32, direction: f32, loft: f32) -> [f32; 3] {
    if loft <= 0.0 {
        return [speed * direction.cos(), speed * direction.sin(), 0.0];
    }
    let level = speed * loft.cos();
    [
        level * direction.cos(),
        level * direction.sin(),
        speed * loft.sin(),
    ]
}

/// Sign of x of a team's own goal: cyan defends −x.
fn own_goal_sign(team: TeamColour) -> f32 {
    match team {
        TeamColour::Cyan => -1.0,
        TeamColour::Magenta => 1.0,
    }
}

fn is_nearest(
    ball: &Option<BallState>,
    others: &[RobotState],
    index: usize,
    robots: &[RobotBehaviour],
) -> bool {
    let Some(ball) = ball else { return false };
    let distance = |state: &RobotState| ball.at.distance_to(state.pose.origin());
    let mine = distance(&others[index]);
    others.iter().enumerate().all(|(other, state)| {
        let rival =
            state.team == others[index].team && !robots[other].keeper && !robots[other].stationary;
        other == index
            || !rival
            || distance(state) > mine
            || (distance(state) == mine && other > index)
    })
}

/// True if all robots are farther away than a distance, metres.
fn is_clear(pose: Pose, distance: f32, robot: Pose, taken: &[(Pose, TeamColour)]) -> bool {
    let clear = |other: Pose| other.origin().distance_to(pose.origin()) > distance;
    clear(robot) && taken.iter().all(|&(other, _)| clear(other))
}

/// A random pose at least 1.2 m from all robots; after 200 attempts the last one drawn.
fn free_place(
    half_length: f32,
    half_width: f32,
    robot: Pose,
    taken: &[(Pose, TeamColour)],
    rng: &mut ChaCha8Rng,
) -> Pose {
    let mut pose = Pose::new(0.0, 0.0, 0.0);
    for _ in 0..200 {
        let x = (rng.random::<f32>() * 2.0 - 1.0) * half_length * 0.9;
        let y = (rng.random::<f32>() * 2.0 - 1.0) * half_width * 0.9;
        pose = Pose::new(x, y, rng.random::<f32>() * TAU);
        if is_clear(pose, 1.2, robot, taken) {
            break;
        }
    }
    pose
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use rand::SeedableRng;

    use super::*;

    #[test]
    fn goalkeeper_whose_place_is_taken_starts_elsewhere() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
        let field = Field::load(&path).expect("a field");
        let config = OthersConfig {
            opponents: 1,
            ..OthersConfig::default()
        };
        let keeper = |robot: Pose| {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            TeamBehaviour::new(&field, &config, robot, &mut rng).1[0].0
        };
        let in_goal = keeper(Pose::new(0.0, 0.0, 0.0));
        assert_eq!(in_goal.x, field.length / 2.0 - KEEPER_AHEAD);
        let beside = keeper(in_goal);
        assert!(beside.origin().distance_to(in_goal.origin()) > BODIES_DISTANCE);
    }
}
