//! How soon does a robot at an ambiguous place know where it is, and how does that depend on how it moves?

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};

use super::drive::{SyntheticDriveConfig, random_pose, simulate_line_points};
use crate::advice::{Advice, MotionAdvice};
use crate::estimate::Estimate;
use crate::field::Field;
use crate::frames::Pose;
use crate::global_search::branch_and_bound::half_turn;
use crate::localizer::Localizer;
use crate::math;
use crate::random::standard_normal;
use crate::sample::{LinePoint, Odometry};
use crate::stamp::Stamp;

/// How the robot moves while its pose is ambiguous.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Behaviour {
    /// Stands.
    Stand,
    /// Turns on the spot.
    Turn,
    /// Drives straight on, and turns away at the carpet's edge.
    Straight,
    /// Drives in a random direction for a second at a time.
    Random,
    /// Follows the advice, and drives straight on without one.
    Advice,
}

/// Conditions of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct CertaintyExperiment {
    /// Sensors; `frame_rate`, points and odometry errors are used.
    pub drive: SyntheticDriveConfig,
    /// Speed of the robot, m/s.
    pub speed: f32,
    /// Longest time of a run, seconds.
    pub seconds: f32,
    /// The robot stands for this time first; only places that are ambiguous at its end count, seconds.
    pub standing: f32,
}

/// Result of one run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CertaintyRun {
    /// Time after the robot may move from which on the right pose is tracked to the end, apart from the half turn. None: it
    /// is not at the end.
    pub seconds: Option<f32>,
    /// Way driven until then, metres.
    pub distance: f32,
    /// Share of all images in which one wrong pose was tracked.
    pub wrong_share: f32,
}

/// Position error from which a place is wrong, metres.
const WRONG_DISTANCE: f32 = 0.5;
/// Distance kept from the carpet's edge, metres.
const EDGE_DISTANCE: f32 = 0.3;
/// Yaw rate of turns on the spot, rad/s.
const TURN_RATE: f32 = 1.57;
/// Images between an estimate and the motion that follows from it.
const DELAY_IMAGES: usize = 2;

/// A robot that drives by commands in its own frame.
struct Robot<'a> {
    field: &'a Field,
    experiment: &'a CertaintyExperiment,
    pose: Pose,
    rng: Xoshiro256PlusPlus,
    localizer: Localizer,
    images: i64,
    distance: f32,
}

/// Runs a behaviour at the place of one seed. None if the place is not ambiguous: its first images decide.
pub fn run_certainty(
    field: &Field,
    base: &Localizer,
    experiment: &CertaintyExperiment,
    behaviour: Behaviour,
    seed: u64,
) -> Option<CertaintyRun> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(77_000_000));
    let pose = random_pose(field, &mut rng);
    let mut robot = Robot {
        field,
        experiment,
        pose,
        rng,
        localizer: base.clone(),
        images: 0,
        distance: 0.0,
    };
    let rate = experiment.drive.frame_rate;
    for _ in 0..(experiment.standing * rate) as usize {
        robot.step([0.0; 3]);
    }
    if !robot.localizer.has_several_hypotheses() {
        return None;
    }
    robot.distance = 0.0;
    let mut course = Course::new(behaviour, &mut robot.rng);
    let count = ((experiment.seconds * rate) as usize).max(1);
    let mut right_since = None;
    let mut wrong = 0;
    for k in 1..=count {
        // The robot does not know whether its pose is right: what it does depends on the estimate alone.
        let command = course.command(&mut robot, k);
        let estimate = robot.step(command);
        course.note(&estimate);
        let decided = !robot.localizer.has_several_hypotheses();
        let off = |pose: Pose| pose.origin().distance_to(robot.pose.origin());
        let is_right = estimate
            .pose
            .filter(|_| decided)
            .map(|pose| off(pose).min(off(half_turn(pose))) <= WRONG_DISTANCE);
        match is_right {
            Some(true) => {
                right_since.get_or_insert((k, robot.distance));
            }
            Some(false) => {
                right_since = None;
                wrong += 1;
            }
            None => right_since = None,
        }
    }
    Some(CertaintyRun {
        seconds: right_since.map(|(k, _)| k as f32 / rate),
        distance: right_since.map_or(robot.distance, |(_, distance)| distance),
        wrong_share: wrong as f32 / count as f32,
    })
}

impl Robot<'_> {
    /// Moves by a velocity (robot frame: m/s, m/s, rad/s) for one image, as far as the carpet reaches, and takes it.
    fn step(&mut self, [vx, vy, yaw_rate]: [f32; 3]) -> Estimate {
        let drive = &self.experiment.drive;
        let dt = 1.0 / drive.frame_rate;
        let mut motion = [vx * dt, vy * dt, yaw_rate * dt];
        if !self.is_free(motion) {
            motion = [0.0, 0.0, motion[2]];
        }
        let [dx, dy, turn] = motion;
        self.pose = self.pose * crate::frames::Tf::new(dx, dy, turn);
        self.distance += math::hypot(dx, dy);
        let stamp = Stamp::from_seconds(self.images as f64 * f64::from(dt));
        self.images += 1;
        let mut measured = |value: f32| {
            let noise = drive.odometry_noise * standard_normal(&mut self.rng);
            value * (1.0 + drive.odometry_scale_error + noise)
        };
        let odometry = Odometry {
            stamp,
            dx: measured(dx),
            dy: measured(dy),
            dtheta: measured(turn),
            slip: 0.0,
        };
        self.localizer.add_odometry(&odometry);
        let points: Vec<LinePoint> =
            simulate_line_points(self.field, drive, self.pose, &mut self.rng);
        self.localizer.process_points(stamp, &points)
    }

    /// Does the robot stay on the carpet?
    fn is_free(&self, [dx, dy, turn]: [f32; 3]) -> bool {
        let next: Pose = self.pose * crate::frames::Tf::new(dx, dy, turn);
        let (half_x, half_y) = self.field.carpet_half_extent();
        next.x.abs() < half_x - EDGE_DISTANCE && next.y.abs() < half_y - EDGE_DISTANCE
    }
}

/// The path that a robot takes.
struct Course {
    behaviour: Behaviour,
    /// Direction of straight drives in the robot frame, radians.
    direction: f32,
    /// Newest advice last.
    advice: Vec<Option<Advice>>,
}

impl Course {
    fn new(behaviour: Behaviour, rng: &mut Xoshiro256PlusPlus) -> Self {
        Course {
            behaviour,
            direction: std::f32::consts::TAU * rng.random::<f32>(),
            advice: Vec::new(),
        }
    }

    fn note(&mut self, estimate: &Estimate) {
        self.advice.push(estimate.advice);
    }

    /// Velocity in the robot frame before image `k`.
    fn command(&mut self, robot: &mut Robot, k: usize) -> [f32; 3] {
        let speed = robot.experiment.speed;
        match self.behaviour {
            Behaviour::Stand => return [0.0; 3],
            Behaviour::Turn => return [0.0, 0.0, TURN_RATE],
            Behaviour::Straight => {}
            Behaviour::Random => {
                if k.is_multiple_of(robot.experiment.drive.frame_rate as usize) {
                    self.direction = std::f32::consts::TAU * robot.rng.random::<f32>();
                }
            }
            Behaviour::Advice => {
                let known = self.advice.len().checked_sub(DELAY_IMAGES);
                let advice = known.and_then(|index| self.advice.get(index).copied().flatten());
                if let Some(Advice::Move(MotionAdvice {
                    motion: [x, y, turn],
                    ..
                })) = advice
                {
                    let distance = math::hypot(x, y);
                    if distance < 1e-3 {
                        return [0.0, 0.0, TURN_RATE.copysign(turn)];
                    }
                    return [x * speed / distance, y * speed / distance, 0.0];
                }
            }
        }
        let dt = 1.0 / robot.experiment.drive.frame_rate;
        for _ in 0..12 {
            let (sin, cos) = math::sin_cos(self.direction);
            if robot.is_free([cos * speed * dt, sin * speed * dt, 0.0]) {
                return [cos * speed, sin * speed, 0.0];
            }
            self.direction = std::f32::consts::TAU * robot.rng.random::<f32>();
        }
        [0.0; 3]
    }
}
