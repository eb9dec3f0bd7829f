//! How much better does the team know the ball than its best robot? Five robots, a rolling ball, a lossy network.
//!
//! The same seeds give the same score. Each robot follows the ball by its own [`WorldModel`] from sightings whose
//! errors last (its lean and its pose are wrong for a while, not anew in each frame), and shares at a lower rate.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng};
use serde::Serialize;

use crate::estimate::{Estimate, Mode};
use crate::frames::{At, FieldFrame, Pose};
use crate::random::standard_normal;
use crate::sample::Odometry;
use crate::stamp::Stamp;
use crate::team::{ReportedBall, TeamConfig, TeamModel, TeamReport};
use crate::tilt;
use crate::world::{ObjectObservation, WorldConfig, WorldModel, WorldObservation, WorldView};

/// Robots of a team.
pub const ROBOTS: usize = 5;
/// Height of their mirrors, metres.
const HEIGHT: f32 = 0.75;
/// Frames per second.
const RATE: f32 = 30.0;
/// Error of a sighting from frame to frame, share of its distance: a pixel in radius at 4 m is 3 cm, half of it across.
const OBSERVATION_STD: [f32; 2] = [0.01, 0.005];
/// Lean of a robot that its frames' estimates leave, degrees, and how long it lasts, seconds.
const TILT_STD_DEG: f32 = 0.15;
const TILT_CORRELATION_TIME: f32 = 0.5;
/// Error of its pose, metres and radians, and how long it lasts, seconds.
const POSE_STD: [f32; 2] = [0.04, 0.01];
const POSE_CORRELATION_TIME: f32 = 2.0;

/// How well the ball was known where every robot was beyond the distance asked for.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct BallScore {
    /// Frames scored.
    pub frames: usize,
    /// Mean error of each robot by itself, metres.
    pub single_robot: [f32; ROBOTS],
    /// Mean error of the best of them.
    pub best_robot: f32,
    /// Mean error of the merged ball as the robots have it, metres.
    pub fused: f32,
    /// `merged` over `best_single`.
    pub ratio: f32,
    /// Mean squared error of the merged ball in its own standard deviations; 2 is honest.
    pub nees: f32,
}

/// What the network and the team do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TeamExperiment {
    /// Frames between two words of a robot, at 30 frames a second.
    pub frames_per_message: usize,
    /// Share of the words that are lost.
    pub loss: f32,
    /// Longest time that a word is under way, seconds.
    pub delay_max: f32,
    /// Robots that lie: they claim, and very surely, a ball elsewhere.
    pub faulty_robots: usize,
    /// Frames are scored where the ball is farther than this from every honest robot, metres.
    pub ball_distance_min: f32,
    /// Seconds of each drive.
    pub seconds: f32,
}

impl Default for TeamExperiment {
    fn default() -> Self {
        TeamExperiment {
            // 15 words a second, the default of the link.
            frames_per_message: 2,
            loss: 0.2,
            delay_max: 0.05,
            faulty_robots: 0,
            ball_distance_min: 4.0,
            seconds: 20.0,
        }
    }
}

/// An error that lasts: stationary, of standard deviation 1, forgotten after `lasts` seconds.
struct GaussMarkov {
    value: f32,
    time_constant: f32,
}

impl GaussMarkov {
    fn new(lasts: f32, rng: &mut impl Rng) -> Self {
        GaussMarkov {
            value: standard_normal(rng),
            time_constant: lasts,
        }
    }

    fn step(&mut self, rng: &mut impl Rng) -> f32 {
        let kept = (-1.0 / (RATE * self.time_constant)).exp();
        self.value = kept * self.value + (1.0 - kept * kept).sqrt() * standard_normal(rng);
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

/// A word that is under way to a player.
struct PendingMessage {
    arrival: f32,
    recipient: usize,
    report: TeamReport,
}

/// Plays with each seed and scores every robot against the truth.
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
        let heard = single.iter().copied().filter(|error| *error > 0.0);
        let best_single = heard.fold(f32::INFINITY, f32::min);
        let merges = self.fused_frames.max(1) as f64;
        let merged = (self.fused / merges) as f32;
        BallScore {
            frames: self.frames,
            single_robot: single,
            best_robot: best_single,
            fused: merged,
            ratio: merged / best_single,
            nees: (self.nees / merges) as f32,
        }
    }
}

fn run_seed(seed: u64, trial: &TeamExperiment, sums: &mut ScoreSums) {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut players: Vec<ExperimentRobot> = (0..ROBOTS).map(|i| player(i, &mut rng)).collect();
    let mut words: Vec<PendingMessage> = Vec::new();
    let mut ball = RollingBall::new(&mut rng);
    for frame in 0..(trial.seconds * RATE) as usize {
        let time = frame as f32 / RATE;
        let stamp = Stamp::from_seconds(f64::from(time));
        ball.step(&mut rng);
        words.retain(|word| {
            let due = word.arrival <= time;
            if due {
                players[word.recipient].team.receive(&word.report);
            }
            !due
        });
        let scored = frame > RATE as usize
            && players[trial.faulty_robots..]
                .iter()
                .all(|player| player.truth.origin().distance_to(ball.at) > trial.ball_distance_min);
        sums.frames += usize::from(scored);
        for (i, player) in players.iter_mut().enumerate() {
            let (world, estimate) = player.observe(stamp, ball.at, &mut rng);
            let view = player.team.update(stamp, &world, &estimate);
            let liar = i < trial.faulty_robots;
            if (frame + i).is_multiple_of(trial.frames_per_message) {
                let report = report(player.number, stamp, &world, &estimate, liar);
                for to in (0..ROBOTS).filter(|&to| to != i) {
                    if rng.random::<f32>() >= trial.loss {
                        let arrives = time + trial.delay_max * rng.random::<f32>();
                        let report = report.clone();
                        words.push(PendingMessage {
                            arrival: arrives,
                            recipient: to,
                            report,
                        });
                    }
                }
            }
            if scored && !liar {
                let own = world.ball.and_then(|ball| ball.on_field);
                sums.single_robot[i] += own.map_or(f64::from(trial.ball_distance_min), |own| {
                    f64::from(own.at.distance_to(ball.at))
                });
                if let Some(shared) = view.ball {
                    sums.fused_frames += 1;
                    sums.fused += f64::from(shared.at.distance_to(ball.at));
                    let [xx, xy, yy] = shared.covariance;
                    let (dx, dy) = (shared.at.x - ball.at.x, shared.at.y - ball.at.y);
                    let squared = yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy;
                    sums.nees += f64::from(squared / (xx * yy - xy * xy));
                }
            }
        }
    }
}

/// A ball that rolls about the middle of the field.
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

    /// Velocity wanders by half a metre per second in a second; it turns back to the middle at 2 m.
    fn step(&mut self, rng: &mut impl Rng) {
        let step = 1.0 / RATE;
        for (speed, place) in self.velocity.iter_mut().zip([self.at.x, self.at.y]) {
            *speed += 0.5 * step.sqrt() * standard_normal(rng);
            if place.abs() > 2.0 {
                *speed = -place.signum() * speed.abs();
            }
            *speed = speed.clamp(-1.5, 1.5);
        }
        self.at = At::new(
            self.at.x + step * self.velocity[0],
            self.at.y + step * self.velocity[1],
        );
    }
}

/// Players stand around the middle, 5.5 m from it; they turn on the spot.
fn player(i: usize, rng: &mut impl Rng) -> ExperimentRobot {
    let angle = std::f32::consts::TAU * (i as f32 + 0.3 * rng.random::<f32>()) / ROBOTS as f32;
    let (sin, cos) = angle.sin_cos();
    let number = i as u32 + 1;
    let lasts = [
        TILT_CORRELATION_TIME,
        TILT_CORRELATION_TIME,
        POSE_CORRELATION_TIME,
        POSE_CORRELATION_TIME,
        POSE_CORRELATION_TIME,
    ];
    ExperimentRobot {
        number,
        truth: Pose::new(5.5 * cos, 5.5 * sin, angle * 2.0),
        errors: lasts.map(|lasts| GaussMarkov::new(lasts, rng)),
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
        let turn = 0.5 / RATE;
        self.truth = Pose::new(self.truth.x, self.truth.y, self.truth.theta + turn);
        self.world.add_odometry(&Odometry {
            stamp,
            dtheta: turn,
            ..STATIONARY
        });
        let [a, b, x, y, heading] = self.errors.each_mut().map(|error| error.step(rng));
        let [position_std, heading_std] = POSE_STD;
        let believed = Pose::new(
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
        let sighting = ObjectObservation {
            at,
            covariance: [
                r * cos * cos + t * sin * sin,
                (r - t) * cos * sin,
                r * sin * sin + t * cos * cos,
            ],
            score: 0.8,
            airborne: false,
            team: None,
        };
        let sight = WorldObservation {
            ball: Some(sighting),
            robots: Vec::new(),
        };
        let estimate = estimate(stamp, believed);
        let world = self.world.update(stamp, Some(&sight), &estimate);
        (world, estimate)
    }
}

/// An odometry report of a robot that stands.
const STATIONARY: Odometry = Odometry {
    stamp: Stamp(0),
    dx: 0.0,
    dy: 0.0,
    dtheta: 0.0,
    slip: 0.0,
};

fn estimate(stamp: Stamp, pose: Pose) -> Estimate {
    let [position, heading] = POSE_STD.map(|std| std * std);
    Estimate {
        stamp,
        pose: Some(pose),
        covariance: nalgebra::Matrix3::from_diagonal(&[position, position, heading].into()),
        mode: Mode::Tracking,
        reason: None,
        residual: 0.0,
        inlier_share: 1.0,
        line_points: 50,
        tilt: [0.0; 2],
        half_known: true,
        odometry_scales: [1.0; 2],
        twist: None,
        collision: false,
        gyro_bias: 0.0,
        latency: 0.0,
        runners_up: Vec::new(),
    }
}

fn report(
    number: u32,
    stamp: Stamp,
    world: &WorldView,
    estimate: &Estimate,
    liar: bool,
) -> TeamReport {
    let ball = world.ball.and_then(|ball| {
        let on_field = ball.on_field?;
        let p = on_field.covariance;
        let (at, covariance) = if liar {
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
        stamp,
        pose: estimate.pose,
        pose_std: [POSE_STD[0], POSE_STD[0], POSE_STD[1]],
        half_known: true,
        ball,
        obstacles: Vec::new(),
    }
}
