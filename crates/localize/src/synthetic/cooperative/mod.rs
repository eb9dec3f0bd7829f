//! Experiment: how well do team-mates locate a robot that sees no line points?
//!
//! Equal seeds give equal scores. The robot drives with wheels of unequal radius that slip, sees markings for some
//! seconds and then none. Its mates' errors are correlated in time, half of them constant, their mirrors have errors that
//! nobody states, messages are late and lost, and opponents may be taken for team-mates.

mod mate;
mod settings;
mod sight;
#[cfg(test)]
mod tests;

use nalgebra::Matrix2;
use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng};
use serde::Serialize;

pub use settings::CooperativeExperiment;

use super::rough_drive::{RoughDrive, RoughDriveConfig, RoughSample, WheelErrors};
use crate::config::LocalizeConfig;
use crate::estimate::Estimate;
use crate::field::Field;
use crate::frames::{At, FieldFrame, Pose};
use crate::localizer::{Localizer, SightingOutcome};
use crate::math;
use crate::stamp::Stamp;
use crate::team::{TeamConfig, TeamModel, TeamReport};
use crate::world::{WorldConfig, WorldModel};

use mate::{Companion, Mate};
use sight::{HEIGHT, Mirror, RATE};

/// Time with line points before the robot is blind, seconds.
const SIGHTED: f64 = 4.0;
/// Time at the end over which the figures are means, seconds.
const SCORED: f64 = 1.0;

/// Figures of one drive, over the last second without line points.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct CooperativeScore {
    /// Error of the position, root of the mean square, metres. None if the robot was lost.
    pub position_error: Option<f64>,
    /// Error of the heading, root of the mean square, radians.
    pub heading_error: Option<f64>,
    /// Normalised estimation error squared of the position. 2 is consistent.
    pub nees: Option<f64>,
    /// Stated standard deviation of the position, metres: the larger axis.
    pub stated_std: Option<f64>,
    /// Sightings that corrected the pose, in the whole drive.
    pub used: usize,
    /// Sightings that were refused because of another robot.
    pub ambiguous: usize,
    /// Sightings of no robot where it had to be.
    pub not_seen: usize,
}

/// A message in transit to the blind robot.
struct PendingMessage {
    arrival: f64,
    report: TeamReport,
}

/// A localizer for the experiment's drives. Building its tables takes a moment; drives may share it.
pub fn cooperative_localizer(field: &Field) -> Localizer {
    Localizer::new(field, LocalizeConfig::default())
}

/// Drives once. `localizer`: as [`cooperative_localizer`] builds it.
pub fn evaluate_cooperative(
    field: &Field,
    localizer: &Localizer,
    seed: u64,
    trial: &CooperativeExperiment,
) -> CooperativeScore {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let drive_rng = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(31_000_000));
    let end = SIGHTED + trial.blind;
    let mut drive = RoughDrive::new(field, drive_config(trial, end), drive_rng);
    let mut team = Team::new(localizer, trial, &mut rng);
    let mut sums = Sums::default();
    for image in 0..(end * f64::from(RATE)) as usize - 1 {
        let Some(sample) = drive.next() else {
            break;
        };
        let seconds = sample.stamp.seconds();
        let estimate = team.process(image, &sample, trial, &mut rng, &mut sums.score);
        if seconds > end - SCORED {
            sums.add(sample.true_pose, &estimate);
        }
    }
    sums.finish()
}

fn drive_config(trial: &CooperativeExperiment, end: f64) -> RoughDriveConfig {
    RoughDriveConfig {
        frame_rate: f64::from(RATE),
        speed_max: [trial.speed_max, 1.5],
        wheels: WheelErrors {
            scale: 1.01,
            radius_ratio: [1.03, 1.02, 1.04],
            white_share: 0.03,
            white_position: 0.0005,
            white_heading: 0.0005,
            slow_share: 0.05,
            known: false,
        },
        blind: Some((end, trial.blind)),
        ..RoughDriveConfig::default()
    }
}

/// The blind robot and those around it.
struct Team {
    localizer: Localizer,
    world: WorldModel,
    team: TeamModel,
    mirror: Mirror,
    mates: Vec<Mate>,
    opponents: Vec<Companion>,
    messages: Vec<PendingMessage>,
}

impl Team {
    fn new(localizer: &Localizer, trial: &CooperativeExperiment, rng: &mut impl Rng) -> Self {
        let others = trial.mates + trial.opponents;
        let start = Pose::new(0.0, 0.0, 0.0);
        let config = TeamConfig {
            number: 1,
            cooperative: trial.config.clone(),
            ..TeamConfig::default()
        };
        Team {
            localizer: localizer.clone(),
            world: WorldModel::new(WorldConfig::default(), HEIGHT),
            team: TeamModel::new(config),
            mirror: Mirror::new(others, rng),
            mates: (0..trial.mates)
                .map(|index| Mate::new(index, start, others, trial, rng))
                .collect(),
            opponents: (0..trial.opponents)
                .map(|index| {
                    let distances = if index < 2 { [0.6, 0.9] } else { [1.5, 4.0] };
                    Companion::new(start, distances, rng)
                })
                .collect(),
            messages: Vec::new(),
        }
    }

    fn process(
        &mut self,
        image: usize,
        sample: &RoughSample,
        trial: &CooperativeExperiment,
        rng: &mut impl Rng,
        score: &mut CooperativeScore,
    ) -> Estimate {
        let (stamp, seconds) = (sample.stamp, sample.stamp.seconds());
        let truth = sample.true_pose;
        let blind_for = sample.blind_for as f32;
        self.move_others(image, stamp, truth, blind_for, trial, rng);
        self.messages.retain(|message| {
            let due = message.arrival <= seconds;
            if due {
                self.team.receive(&message.report);
            }
            !due
        });
        self.localizer.add_odometry(&sample.odometry);
        self.world.add_odometry(&sample.odometry);
        self.localizer.add_compass(&sample.compass);
        let estimate = self.localizer.process_points(stamp, &sample.points);
        let others = self.others(None);
        let mut observation = self.mirror.see(truth, &others, rng);
        if !trial.sees_robots {
            observation.robots.clear();
        }
        let motion = self.localizer.image_motion();
        let world = (self.world).update(stamp, Some(&observation), &estimate, motion);
        self.team.update(stamp, &world, &estimate);
        let sightings = self.team.take_sightings(&estimate);
        let outcomes = self
            .localizer
            .apply_team_sightings(&sightings, &trial.config);
        self.team.judge_sightings(&sightings, &outcomes);
        for outcome in outcomes {
            match outcome {
                SightingOutcome::Used => score.used += 1,
                SightingOutcome::Ambiguous => score.ambiguous += 1,
                SightingOutcome::NotSeen => score.not_seen += 1,
                _ => {}
            }
        }
        estimate
    }

    /// The mates and opponents. `without`: index of a mate that is left out.
    fn others(&self, without: Option<usize>) -> Vec<At<FieldFrame>> {
        let mates = self
            .mates
            .iter()
            .enumerate()
            .filter(|(index, _)| Some(*index) != without)
            .map(|(_, mate)| mate.companion.pose.origin());
        let opponents = self.opponents.iter().map(|opponent| opponent.pose.origin());
        mates.chain(opponents).collect()
    }

    /// Mates and opponents move, and mates send what they see.
    fn move_others(
        &mut self,
        image: usize,
        stamp: Stamp,
        truth: Pose,
        blind_for: f32,
        trial: &CooperativeExperiment,
        rng: &mut impl Rng,
    ) {
        if image == 0 {
            // They start around the robot, whose place is known with the first sample.
            let moved = |companion: &mut Companion| {
                let Pose { x, y, theta, .. } = companion.pose;
                companion.pose = Pose::new(x + truth.x, y + truth.y, theta);
            };
            self.mates
                .iter_mut()
                .for_each(|mate| moved(&mut mate.companion));
            self.opponents.iter_mut().for_each(moved);
        }
        for opponent in &mut self.opponents {
            opponent.step(truth);
        }
        for index in 0..self.mates.len() {
            let motion = self.mates[index].companion.step(truth);
            let mut others = self.others(Some(index));
            // The blind robot has the place of the mate itself in the order of robots.
            others.insert(index, truth.origin());
            let mate = &mut self.mates[index];
            let report = mate.report(stamp, motion, &others, blind_for, trial, rng);
            let is_due = (image + index).is_multiple_of(trial.images_per_message.max(1));
            if is_due && rng.random::<f32>() >= trial.loss {
                let delay = mate.delay * (0.5 + rng.random::<f32>());
                self.messages.push(PendingMessage {
                    arrival: stamp.seconds() + f64::from(delay),
                    report,
                });
            }
        }
    }
}

/// Sums over the last second.
#[derive(Default)]
struct Sums {
    score: CooperativeScore,
    images: usize,
    lost: bool,
    position_squared: f64,
    heading_squared: f64,
    nees: f64,
    variance: f64,
}

impl Sums {
    fn add(&mut self, truth: Pose, estimate: &Estimate) {
        let Some(pose) = estimate.pose else {
            self.lost = true;
            return;
        };
        let off = pose.difference(truth);
        let position = off.fixed_rows::<2>(0).into_owned();
        let covariance = estimate.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let inverse = covariance.try_inverse().unwrap_or_else(Matrix2::zeros);
        self.images += 1;
        self.position_squared += f64::from(position.norm_squared());
        self.heading_squared += f64::from(off[2] * off[2]);
        self.nees += f64::from(position.dot(&(inverse * position)));
        let [xx, xy, yy] = [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]];
        let largest = 0.5 * (xx + yy) + math::hypot(0.5 * (xx - yy), xy);
        self.variance += f64::from(largest);
    }

    fn finish(self) -> CooperativeScore {
        let count = self.images as f64;
        let mean = |sum: f64| (self.images > 0 && !self.lost).then(|| sum / count);
        CooperativeScore {
            position_error: mean(self.position_squared).map(f64::sqrt),
            heading_error: mean(self.heading_squared).map(f64::sqrt),
            nees: mean(self.nees),
            stated_std: mean(self.variance).map(f64::sqrt),
            ..self.score
        }
    }
}
