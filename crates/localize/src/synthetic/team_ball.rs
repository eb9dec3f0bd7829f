//! Experiment: error of the team's fused ball against the best single robot, with a rolling ball and a lossy network.
//!
//! Equal seeds give equal scores. Each of five robots tracks the ball with its own [`WorldModel`]. The errors of its
//! tilt and pose are correlated in time. It sends its ball to the others at a lower rate.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng};
use serde::Serialize;

use crate::estimate::Estimate;
use crate::frames::{At, FieldFrame, Pose};
use crate::math;
use crate::random::standard_normal;
use crate::sample::Odometry;
use crate::stamp::Stamp;
use crate::team::{ReportedBall, TeamConfig, TeamModel, TeamReport};
use crate::tilt;
use crate::world::{ObjectObservation, WorldConfig, WorldModel, WorldObservation, WorldView};

/// Number of robots of a team.
pub const ROBOTS: usize = 5;
/// Height of the robots' mirrors, metres.
const HEIGHT: f32 = 0.75;
/// Images per second.
const RATE: f32 = 30.0;
/// Standard deviation of a detection (radial, tangential), share of its range: a pixel of radius at 4 m is 3 cm.
const OBSERVATION_STD: [f32; 2] = [0.01, 0.005];
/// Tilt error of a robot after the image's estimate, degrees, and its correlation time, seconds.
const TILT_STD_DEG: f32 = 0.15;
const TILT_CORRELATION_TIME: f32 = 0.5;
/// Pose error, metres and radians, and its correlation time, seconds.
const POSE_STD: [f32; 2] = [0.04, 0.01];
const POSE_CORRELATION_TIME: f32 = 2.0;

/// Errors of the ball in images in which all honest robots were farther from it than `ball_distance_min`.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct BallScore {
    /// Images scored.
    pub frames: usize,
    /// Mean error of each robot's own ball, metres.
    pub single_robot: [f32; ROBOTS],
    /// Mean error of the best robot's own ball, metres.
    pub best_robot: f32,
    /// Mean error of the fused ball over all robots, metres.
    pub fused: f32,
    /// `fused` over `best_robot`.
    pub ratio: f32,
    /// Mean normalised estimation error squared of the fused ball; 2 if its covariance is consistent.
    pub nees: f32,
}

/// Settings of the experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TeamExperiment {
    /// Images between two messages of a robot, at 30 images per second.
    pub frames_per_message: usize,
    /// Share of the messages that are lost.
    pub loss: f32,
    /// Largest delay of a message, seconds.
    pub delay_max: f32,
    /// Number of faulty robots: they report a wrong ball with a small covariance.
    pub faulty_robots: usize,
    /// Images are scored in which the ball is farther than this from every honest robot, metres.
    pub ball_distance_min: f32,
    /// Seconds of each drive.
    pub seconds: f32,
}

impl Default for TeamExperiment {
    fn default() -> Self {
        TeamExperiment {
            // 15 messages per second, the default of the team link.
            frames_per_message: 2,
            loss: 0.2,
            delay_max: 0.05,
            faulty_robots: 0,
            ball_distance_min: 4.0,
            seconds: 20.0,
        }
    }
}

/// A stationary Gauss-Markov process of standard deviation 1.
struct GaussMarkov {
    value: f32,
    /// Seconds.
    time_constant: f32,
}

impl GaussMarkov {
    fn new(time_constant: f32, rng: &mut impl Rng) -> Self {
        GaussMarkov {
            value: standard_normal(rng),
            time_constant,
        }
    }

    fn step(&mut self, rng: &mut impl Rng) -> f32 {
        let decay = math::exp(-1.0 / (RATE * self.time_constant));
        self.value = decay * self.value + (1.0 - decay * decay).sqrt() * standard_normal(rng);
        self.value
    }
}

struct ExperimentRobot {
    number: u32,
    truth: Pose,
    errors: [GaussMarkov; 5],
    world: WorldModel,
    team: TeamModel,
}

/// A message in transit to a robot.
struct PendingMessage {
    arrival: f32,
    recipient: usize,
    report: TeamReport,
}

/// Runs the experiment with each seed and scores every robot against the truth.
pub fn evaluate_team_ball(seeds: std::ops::Range<u64>, trial: &TeamExperiment) -> BallScore {
    let mut sums = ScoreSums::default();
    for seed in seeds {
        run_seed(seed, trial, &mut sums);
    }
    sums.score()
}

#[derive(Default)]
struct ScoreSums {
    frames: usize,
    single_robot: [f64; ROBOTS],
    fused: f64,
    fused_frames: usize,
    nees: f64,
}

impl ScoreSums {
    fn score(&self) -> BallScore {
        let frames = self.frames.max(1) as f64;
        let single = self.single_robot.map(|sum| (sum / frames) as f32);
        let scored = single.iter().copied().filter(|error| *error > 0.0);
        let best_robot = scored.fold(f32::INFINITY, f32::min);
        let fused_frames = self.fused_frames.max(1) as f64;
        let fused = (self.fused / fused_frames) as f32;
        BallScore {
            frames: self.frames,
            single_robot: single,
            best_robot,
            fused,
            ratio: fused / best_robot,
            nees: (self.nees / fused_frames) as f32,
        }
    }
}

fn run_seed(seed: u64, trial: &TeamExperiment, sums: &mut ScoreSums) {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut robots: Vec<ExperimentRobot> = (0..ROBOTS).map(|i| new_robot(i, &mut rng)).collect();
    let mut messages: Vec<PendingMessage> = Vec::new();
    let mut ball = RollingBall::new(&mut rng);
    for frame in 0..(trial.seconds * RATE) as usize {
        let time = frame as f32 / RATE;
        let stamp = Stamp::from_seconds(f64::from(time));
        ball.step(&mut rng);
        messages.retain(|message| {
            let due = message.arrival <= time;
            if due {
                robots[message.recipient].team.receive(&message.report);
            }
            !due
        });
        let scored = frame > RATE as usize
            && robots[trial.faulty_robots..]
                .iter()
                .all(|robot| robot.truth.origin().distance_to(ball.at) > trial.ball_distance_min);
        sums.frames += usize::from(scored);
        for (i, robot) in robots.iter_mut().enumerate() {
            let (world, estimate) = robot.observe(stamp, ball.at, &mut rng);
            let view = robot.team.update(stamp, &world, &estimate);
            let is_faulty = i < trial.faulty_robots;
            if (frame + i).is_multiple_of(trial.frames_per_message) {
                let report = report(robot.number, stamp, &world, &estimate, is_faulty);
                for to in (0..ROBOTS).filter(|&to| to != i) {
                    if rng.random::<f32>() >= trial.loss {
                        let arrival = time + trial.delay_max * rng.random::<f32>();
                        let report = report.clone();
                        messages.push(PendingMessage {
                            arrival,
                            recipient: to,
                            report,
                        });
                    }
                }
            }
            if scored && !is_faulty {
                let own = world.ball.and_then(|ball| ball.on_field);
                sums.single_robot[i] += own.map_or(f64::from(trial.ball_distance_min), |own| {
                    f64::from(own.at.distance_to(ball.at))
                });
                if let Some(fused) = view.ball {
                    sums.fused_frames += 1;
                    sums.fused += f64::from(fused.at.distance_to(ball.at));
                    let [xx, xy, yy] = fused.covariance;
                    let (dx, dy) = (fused.at.x - ball.at.x, fused.at.y - ball.at.y);
                    let squared = yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy;
                    sums.nees += f64::from(squared / (xx * yy - xy * xy));
                }
            }
        }
    }
}

/// A ball that rolls around the centre of the field.
struct RollingBall {
    at: At<FieldFrame>,
    velocity: [f32; 2],
}

impl RollingBall {
    fn new(rng: &mut impl Rng) -> Self {
        RollingBall {
            at: At::new(standard_normal(rng), standard_normal(rng)),
            velocity: [0.5 * standard_normal(rng), 0.5 * standard_normal(rng)],
        }
    }

    /// Random walk of the velocity by 0.5 m/s per square root of a second; it is reflected at 2 m.
    fn step(&mut self, rng: &mut impl Rng) {
        let step = 1.0 / RATE;
        for (speed, position) in self.velocity.iter_mut().zip([self.at.x, self.at.y]) {
            *speed += 0.5 * step.sqrt() * standard_normal(rng);
            if position.abs() > 2.0 {
                *speed = -position.signum() * speed.abs();
            }
            *speed = speed.clamp(-1.5, 1.5);
        }
        self.at = At::new(
            self.at.x + step * self.velocity[0],
            self.at.y + step * self.velocity[1],
        );
    }
}

/// Robots stand on a circle of 5.5 m around the centre and rotate in place.
fn new_robot(i: usize, rng: &mut impl Rng) -> ExperimentRobot {
    let angle = std::f32::consts::TAU * (i as f32 + 0.3 * rng.random::<f32>()) / ROBOTS as f32;
    let (sin, cos) = math::sin_cos(angle);
    let number = i as u32 + 1;
    let time_constants = [
        TILT_CORRELATION_TIME,
        TILT_CORRELATION_TIME,
        POSE_CORRELATION_TIME,
        POSE_CORRELATION_TIME,
        POSE_CORRELATION_TIME,
    ];
    ExperimentRobot {
        number,
        truth: Pose::new(5.5 * cos, 5.5 * sin, angle * 2.0),
        errors: time_constants.map(|time_constant| GaussMarkov::new(time_constant, rng)),
        world: WorldModel::new(WorldConfig::default(), HEIGHT),
        team: TeamModel::new(TeamConfig {
            number,
            ..TeamConfig::default()
        }),
    }
}

impl ExperimentRobot {
    fn observe(
        &mut self,
        stamp: Stamp,
        ball: At<FieldFrame>,
        rng: &mut impl Rng,
    ) -> (WorldView, Estimate) {
        let dtheta = 0.5 / RATE;
        self.truth = Pose::new(self.truth.x, self.truth.y, self.truth.theta + dtheta);
        self.world.add_odometry(&Odometry {
            stamp,
            dtheta,
            ..STATIONARY
        });
        let [a, b, x, y, heading] = self.errors.each_mut().map(|error| error.step(rng));
        let [position_std, heading_std] = POSE_STD;
        let estimated = Pose::new(
            self.truth.x + position_std * x,
            self.truth.y + position_std * y,
            self.truth.theta + heading_std * heading,
        );
        let truth = self.truth.inverse() * ball;
        let range = truth.distance();
        let std = TILT_STD_DEG.to_radians();
        let [map_x, map_y] = tilt::map_from_ground([truth.x, truth.y], [std * a, std * b], HEIGHT)
            .unwrap_or([truth.x, truth.y]);
        let [radial, tangential] = OBSERVATION_STD.map(|share| share * range);
        let (along, across) = (
            radial * standard_normal(rng),
            tangential * standard_normal(rng),
        );
        let (cos, sin) = (truth.x / range, truth.y / range);
        let at = At::new(
            map_x + cos * along - sin * across,
            map_y + sin * along + cos * across,
        );
        let (r, t) = (radial * radial, tangential * tangential);
        let detection = ObjectObservation {
            at,
            covariance: [
                r * cos * cos + t * sin * sin,
                (r - t) * cos * sin,
                r * sin * sin + t * cos * cos,
            ],
            score: 0.8,
            airborne: false,
            team: None,
            distance: None,
        };
        let observation = WorldObservation {
            ball: Some(detection),
            robots: Vec::new(),
        };
        let estimate = estimate(stamp, estimated);
        let world = self
            .world
            .update(stamp, Some(&observation), &estimate, None);
        (world, estimate)
    }
}

/// An odometry increment of a stationary robot.
const STATIONARY: Odometry = Odometry {
    stamp: Stamp(0),
    dx: 0.0,
    dy: 0.0,
    dtheta: 0.0,
    slip: 0.0,
};

fn estimate(stamp: Stamp, pose: Pose) -> Estimate {
    let [position, heading] = POSE_STD.map(|std| std * std);
    let covariance = nalgebra::Matrix3::from_diagonal(&[position, position, heading].into());
    Estimate::tracked(stamp, pose, covariance)
}

fn report(
    number: u32,
    stamp: Stamp,
    world: &WorldView,
    estimate: &Estimate,
    is_faulty: bool,
) -> TeamReport {
    let ball = world.ball.and_then(|ball| {
        let on_field = ball.on_field?;
        let p = on_field.covariance;
        let (at, covariance) = if is_faulty {
            (At::new(-on_field.at.x + 3.0, 2.5), [1e-4, 0.0, 1e-4])
        } else {
            (on_field.at, [p[(0, 0)], p[(0, 1)], p[(1, 1)]])
        };
        Some(ReportedBall {
            at,
            velocity: on_field.velocity,
            covariance,
            last_seen: ball.last_seen,
        })
    });
    TeamReport {
        robot: number,
        is_member: true,
        stamp,
        pose: estimate.pose,
        pose_std: [POSE_STD[0], POSE_STD[0], POSE_STD[1]],
        half_known: true,
        pose_by_markings: false,
        ball,
        obstacles: Vec::new(),
        ball_sighting: None,
    }
}
