//! What do the other robots do? Something that looks like play: chase, support, keep the goal, and stay clear.

use std::f32::consts::{FRAC_PI_2, TAU};

use localize::field::Field;
use localize::frames::{At, FieldFrame, Pose, wrap_angle};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::scenario::OthersConfig;
use crate::world::{BallState, RobotState, SimWorld};
use localize::world::TeamColour;

/// How often they think, seconds.
pub(crate) const DECISION_PERIOD: f32 = 0.05;
/// Distance of robots' centres below which they turn away from each other, metres.
const AVOIDANCE_DISTANCE: f32 = 1.1;
/// Distance of a robot's centre from the ball at which it can kick, metres.
const KICK_REACH: f32 = 0.42;
/// Time after a kick in which the same robot does not kick again, seconds.
const KICK_PAUSE: f32 = 1.0;
/// Spread of a kick's direction, radians (one sigma of a triangular spread).
const KICK_SPREAD: f32 = 0.25;
/// How far outside the lines the ball is given back, metres.
const THROW_IN_DISTANCE: f32 = 0.6;
/// Distance of a keeper from its goal line, metres.
const KEEPER_AHEAD: f32 = 0.45;

/// The other robots' minds, one a robot.
pub(crate) struct TeamBehaviour {
    robots: Vec<RobotBehaviour>,
    speed: f32,
    kick_speed: f32,
    half_length: f32,
    half_width: f32,
    goal_half_width: f32,
}

struct RobotBehaviour {
    stationary: bool,
    keeper: bool,
    /// Where it strolls when it has nothing better to do.
    home_position: Vector2<f32>,
    home_time_left: f32,
    kick_cooldown: f32,
}

impl TeamBehaviour {
    /// Sends the robots to their places: those listed, then mates and opponents at seeded ones.
    pub(crate) fn new(
        field: &Field,
        config: &OthersConfig,
        robot: Pose,
        rng: &mut ChaCha8Rng,
    ) -> (Self, Vec<(Pose, TeamColour)>) {
        let (half_length, half_width) = (field.length / 2.0, field.width / 2.0);
        let mut places: Vec<(Pose, TeamColour)> = Vec::new();
        let mut minds = Vec::new();
        for placed in &config.placed {
            let pose = Pose::new(placed.x, placed.y, placed.theta_deg.to_radians());
            places.push((pose, placed.team));
            minds.push(RobotBehaviour::new(placed.stands, false));
        }
        for (team, count) in [
            (TeamColour::Cyan, config.mates),
            (TeamColour::Magenta, config.opponents),
        ] {
            for index in 0..count {
                // The opponents' first robot keeps its goal; ours may be the one we simulate.
                let keeper = index == 0 && (team == TeamColour::Magenta || count > 2);
                let pose = if keeper {
                    Pose::new(own_goal_sign(team) * (half_length - KEEPER_AHEAD), 0.0, 0.0)
                } else {
                    free_place(half_length, half_width, robot, &places, rng)
                };
                places.push((pose, team));
                minds.push(RobotBehaviour::new(false, keeper));
            }
        }
        let play = TeamBehaviour {
            robots: minds,
            speed: config.speed,
            kick_speed: config.kick_speed,
            half_length,
            half_width,
            goal_half_width: field.config.goal.width / 2.0,
        };
        (play, places)
    }

    /// Looks at the world and steers everybody; kicks and throw-ins move the ball.
    pub(crate) fn update(&mut self, world: &mut SimWorld, rng: &mut ChaCha8Rng) {
        let robot = world.robot();
        let others: Vec<RobotState> = world.others().collect();
        if let Some(back) = world.ball().and_then(|ball| self.throw_in(&ball)) {
            world.place_ball(back, [0.0; 2]);
        }
        let ball = world.ball();
        for index in 0..others.len() {
            let me = others[index];
            let chases =
                !self.robots[index].keeper && is_nearest(&ball, &others, index, &self.robots);
            let kick = ball.and_then(|ball| self.kick(index, &me, &ball, rng));
            if let (Some(velocity), Some(ball)) = (kick, ball) {
                world.place_ball(ball.at, velocity);
            }
            let mind = &mut self.robots[index];
            mind.kick_cooldown = (mind.kick_cooldown - DECISION_PERIOD).max(0.0);
            mind.home_time_left -= DECISION_PERIOD;
            if mind.home_time_left <= 0.0 {
                mind.home_time_left = 2.0 + 4.0 * rng.random::<f32>();
                mind.home_position = Vector2::new(
                    (rng.random::<f32>() * 2.0 - 1.0) * self.half_length * 0.85,
                    (rng.random::<f32>() * 2.0 - 1.0) * self.half_width * 0.85,
                );
            }
            let wanted = if self.robots[index].stationary {
                [0.0; 3]
            } else {
                let target = self.target(index, &me, ball.as_ref(), chases);
                let near = others
                    .iter()
                    .enumerate()
                    .filter(|(other, _)| *other != index);
                let near = near.map(|(_, state)| state.pose).chain([robot.pose]);
                self.steer(&me, target, ball.as_ref(), near, chases)
            };
            world.set_other_velocity(index, wanted);
        }
    }

    /// Where a robot wants to be now.
    fn target(
        &self,
        index: usize,
        me: &RobotState,
        ball: Option<&BallState>,
        chases: bool,
    ) -> Vector2<f32> {
        let mind = &self.robots[index];
        let ball = ball.map(|ball| Vector2::new(ball.at.x, ball.at.y));
        match ball {
            Some(ball) if mind.keeper => {
                let reach = self.goal_half_width * 0.8;
                let x = own_goal_sign(me.team) * (self.half_length - KEEPER_AHEAD);
                Vector2::new(x, (ball.y * 0.3).clamp(-reach, reach))
            }
            Some(ball) if chases => {
                // Come from behind the ball, as seen towards the other goal.
                let goal = Vector2::new(-own_goal_sign(me.team) * self.half_length, 0.0);
                let away = (ball - goal).try_normalize(1e-3).unwrap_or_else(Vector2::x);
                let at = Vector2::new(me.pose.x, me.pose.y);
                let behind = (at - ball).dot(&away) > 0.1;
                if behind { ball } else { ball + away * 0.7 }
            }
            // The others move with the ball, each about its own place.
            Some(ball) => mind.home_position * 0.6 + ball * 0.4,
            None => mind.home_position,
        }
    }

    /// The velocity (field frame) towards a target, around whoever is near.
    fn steer(
        &self,
        me: &RobotState,
        target: Vector2<f32>,
        ball: Option<&BallState>,
        near: impl Iterator<Item = Pose>,
        chases: bool,
    ) -> [f32; 3] {
        let at = Vector2::new(me.pose.x, me.pose.y);
        let mut wanted = ((target - at) * 2.0).cap_magnitude(self.speed);
        for pose in near {
            let away = at - Vector2::new(pose.x, pose.y);
            let distance = away.norm();
            if distance < AVOIDANCE_DISTANCE && distance > 1e-3 {
                let push = (AVOIDANCE_DISTANCE - distance) / AVOIDANCE_DISTANCE
                    * self.speed
                    * if chases { 1.0 } else { 2.0 };
                // Turn aside as well as back, or two robots face each other for ever.
                let side = Vector2::new(-away.y, away.x);
                wanted += (away + side * 0.5) / distance * push;
            }
        }
        let wanted = wanted.cap_magnitude(self.speed);
        let look = ball.map_or(target, |ball| Vector2::new(ball.at.x, ball.at.y)) - at;
        let turn = wrap_angle(look.y.atan2(look.x) - me.pose.theta) * 3.0;
        [wanted.x, wanted.y, turn.clamp(-4.0, 4.0)]
    }

    /// The ball's velocity after a kick, if this robot kicks it now.
    fn kick(
        &mut self,
        index: usize,
        me: &RobotState,
        ball: &BallState,
        rng: &mut ChaCha8Rng,
    ) -> Option<[f32; 2]> {
        let mind = &mut self.robots[index];
        let reach = ball.at.distance_to(me.pose.origin());
        let bearing = (ball.at.y - me.pose.y).atan2(ball.at.x - me.pose.x);
        let faces = wrap_angle(bearing - me.pose.theta).abs() < 0.5;
        if mind.stationary || mind.kick_cooldown > 0.0 || reach > KICK_REACH || !faces {
            return None;
        }
        mind.kick_cooldown = KICK_PAUSE;
        let goal = At::<FieldFrame>::new(-own_goal_sign(me.team) * self.half_length, 0.0);
        let towards = (goal.y - ball.at.y).atan2(goal.x - ball.at.x);
        // Never backwards through itself: at most a right angle from where it faces.
        let off = wrap_angle(towards - me.pose.theta).clamp(-FRAC_PI_2 / 2.0, FRAC_PI_2 / 2.0);
        let spread = (rng.random::<f32>() - rng.random::<f32>()) * KICK_SPREAD * 2.4;
        let direction = me.pose.theta + off + spread;
        let speed = self.kick_speed * (0.4 + 0.6 * rng.random::<f32>());
        Some([speed * direction.cos(), speed * direction.sin()])
    }

    /// Where a ball that left the field is put: on the line, or at the centre after a goal.
    fn throw_in(&self, ball: &BallState) -> Option<At<FieldFrame>> {
        let (x, y) = (ball.at.x, ball.at.y);
        let out = x.abs() > self.half_length + THROW_IN_DISTANCE / 2.0
            || y.abs() > self.half_width + THROW_IN_DISTANCE;
        let slow = ball.velocity[0].hypot(ball.velocity[1]) < 0.3;
        if !(out && slow) {
            return None;
        }
        if y.abs() < self.goal_half_width && x.abs() > self.half_length {
            return Some(At::new(0.0, 0.0));
        }
        Some(At::new(
            x.clamp(-self.half_length + 0.3, self.half_length - 0.3),
            y.clamp(-self.half_width, self.half_width),
        ))
    }
}

impl RobotBehaviour {
    fn new(stands: bool, keeper: bool) -> Self {
        RobotBehaviour {
            stationary: stands,
            keeper,
            home_position: Vector2::zeros(),
            home_time_left: 0.0,
            kick_cooldown: 0.0,
        }
    }
}

/// Cyan keeps the goal at −x.
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
    minds: &[RobotBehaviour],
) -> bool {
    let Some(ball) = ball else { return false };
    let distance = |state: &RobotState| ball.at.distance_to(state.pose.origin());
    let mine = distance(&others[index]);
    others.iter().enumerate().all(|(other, state)| {
        let rival =
            state.team == others[index].team && !minds[other].keeper && !minds[other].stationary;
        other == index
            || !rival
            || distance(state) > mine
            || (distance(state) == mine && other > index)
    })
}

/// A place clear of everybody; after many tries the last one drawn, however near.
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
        let clear = |other: Pose| other.origin().distance_to(pose.origin()) > 1.2;
        if clear(robot) && taken.iter().all(|&(other, _)| clear(other)) {
            break;
        }
    }
    pose
}
