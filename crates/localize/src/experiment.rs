//! How well does a configuration find its place? Drives, kidnaps and single frames of `drive`, scored against truth.
//!
//! The same seeds give the same scores; time is for the caller to measure.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use serde::Serialize;

use crate::candidates::apart;
use crate::config::LocalizeConfig;
use crate::distance::DistanceField;
use crate::drive::{Drive, DriveConfig, anywhere, normal, see};
use crate::estimate::{Estimate, Mode, Reason};
use crate::field::Field;
use crate::frame::Pose;
use crate::localizer::Localizer;
use crate::matching::Matcher;
use crate::relocalise::{Relocaliser, Sight};
use crate::search::{HeadingPrior, Search, half_turn};

/// Errors of tracked drives.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct TrackScore {
    /// Frames scored (a second after each start).
    pub frames: usize,
    /// Mean |x|, |y| (metres) and |θ| (degrees).
    pub mean: [f32; 3],
    /// Largest of the same.
    pub max: [f32; 3],
    /// Frames that were said to be lost.
    pub lost: usize,
    /// Frames half a metre or more off while the mode was `tracking`.
    pub silently_wrong: usize,
    /// Frames in which a right pose was given up or suspected of being wrong.
    pub alarms: usize,
    /// Mean normalised error squared; 3 is honest.
    pub nees: f32,
}

/// Drives `frames` frames from each of `seeds` starts, compass given.
pub fn track(
    field: &Field,
    config: &LocalizeConfig,
    drive: &DriveConfig,
    seeds: std::ops::Range<u64>,
    frames: usize,
) -> TrackScore {
    let mut score = TrackScore::default();
    let mut normalised = 0.0_f64;
    let mut sums = [0.0_f64; 3];
    let begun = drive.rate as usize;
    for seed in seeds {
        let mut localizer = Localizer::new(field, config.clone());
        let rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let drive = Drive::new(field, drive.clone(), rng);
        for (k, frame) in drive.take(frames).enumerate() {
            localizer.odometry(&frame.odometry);
            localizer.compass(&frame.compass);
            let estimate = localizer.see(frame.stamp, &frame.points);
            if k < begun {
                continue;
            }
            score.frames += 1;
            score.alarms += usize::from(alarm(&estimate));
            let Some(pose) = estimate.pose else {
                score.lost += 1;
                continue;
            };
            let off = apart(pose, frame.truth);
            score.silently_wrong +=
                usize::from(estimate.mode == Mode::Tracking && off[0].hypot(off[1]) >= 0.5);
            for (i, value) in [off[0], off[1], off[2].to_degrees()]
                .into_iter()
                .enumerate()
            {
                sums[i] += f64::from(value.abs());
                score.max[i] = score.max[i].max(value.abs());
            }
            normalised += f64::from(normalised_error(&estimate, &off));
        }
    }
    let located = (score.frames - score.lost).max(1) as f64;
    score.mean = sums.map(|sum| (sum / located) as f32);
    score.nees = (normalised / located) as f32;
    score
}

fn alarm(estimate: &Estimate) -> bool {
    estimate.mode == Mode::Lost || estimate.reason == Some(Reason::Rival)
}

fn normalised_error(estimate: &Estimate, off: &Vector3<f32>) -> f32 {
    estimate
        .covariance
        .try_inverse()
        .map_or(0.0, |inverse| off.dot(&(inverse * off)))
}

/// How single frames are found on the whole field.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct FindScore {
    /// Frames.
    pub frames: usize,
    /// The truth (up to the half turn without a compass; 0.25 m, 5°) is the first hypothesis.
    pub first: usize,
    /// It is among the first five, half turns counted once.
    pub first_five: usize,
}

/// Locates `count` random poses, each by one frame; with a compass of the drive's noise, or without.
pub fn find(
    field: &Field,
    config: &LocalizeConfig,
    drive: &DriveConfig,
    compass: bool,
    seed: u64,
    count: usize,
) -> FindScore {
    let distances = DistanceField::new(field, &config.distance);
    let mut search = Search::new(field, &distances, config.search.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut relocaliser = Relocaliser::new(field, &distances, &config.relocalise);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let std = drive.compass_std_deg.to_radians();
    let mut score = FindScore::default();
    for _ in 0..count {
        let truth = anywhere(field, &mut rng);
        let points = see(field, drive, truth, &mut rng);
        let heading = truth.theta + std * normal(&mut rng);
        relocaliser.restart();
        let sight = Sight {
            distances: &distances,
            points: &points,
            prior: compass.then_some(HeadingPrior { heading, std }),
            goals: &[],
            alone: true,
        };
        let found = relocaliser.find(&mut search, &mut matcher, &sight);
        let right =
            |pose: Pose| is_right(pose, truth) || !compass && is_right(half_turn(pose), truth);
        // Without a compass each pose is followed by its half turn.
        let step = if !compass && search.symmetric() { 2 } else { 1 };
        let place = found.iter().step_by(step).position(|one| right(one.pose));
        score.frames += 1;
        score.first += usize::from(place == Some(0));
        score.first_five += usize::from(place.is_some_and(|place| place < 5));
    }
    score
}

fn is_right(pose: Pose, truth: Pose) -> bool {
    let off = apart(pose, truth);
    off[0].hypot(off[1]) < 0.25 && off[2].abs() < 5.0_f32.to_radians()
}

/// How kidnaps end.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct KidnapScore {
    /// Kidnaps.
    pub kidnaps: usize,
    /// Within 0.4 s the pose was no longer called tracked (or was right already).
    pub said: usize,
    /// Within 0.4 s after that the pose was right (0.15 m, 3°).
    pub back: usize,
}

/// Carries the robot `count` times to a random place, three seconds apart, compass given.
pub fn kidnap(
    field: &Field,
    config: &LocalizeConfig,
    drive: &DriveConfig,
    seed: u64,
    count: usize,
) -> KidnapScore {
    let mut localizer = Localizer::new(field, config.clone());
    let within = (0.4 * drive.rate) as usize;
    let between = (3.0 * drive.rate) as usize;
    let rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut drive = Drive::new(field, drive.clone(), rng);
    let mut score = KidnapScore::default();
    for carried in 0..=count {
        let (mut said, mut back) = (None, None);
        for (k, frame) in drive.by_ref().take(between).enumerate() {
            localizer.odometry(&frame.odometry);
            localizer.compass(&frame.compass);
            let estimate = localizer.see(frame.stamp, &frame.points);
            let right = estimate.pose.is_some_and(|pose| {
                let off = apart(pose, frame.truth);
                off[0].hypot(off[1]) < 0.15 && off[2].abs() < 3.0_f32.to_radians()
            });
            if estimate.mode != Mode::Tracking || right {
                said = said.or(Some(k));
            }
            if right && said.is_some() {
                back = back.or(Some(k));
            }
        }
        drive.kidnap();
        if carried == 0 {
            continue;
        }
        score.kidnaps += 1;
        score.said += usize::from(said.is_some_and(|k| k <= within));
        let soon = said
            .zip(back)
            .is_some_and(|(said, back)| back <= said + within);
        score.back += usize::from(soon);
    }
    score
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;

    #[test]
    fn the_same_seeds_give_the_same_scores_and_good_ones() {
        let field = league_18x12("outer_edges");
        let (config, drive) = (LocalizeConfig::default(), DriveConfig::default());
        let score = track(&field, &config, &drive, 0..2, 150);
        assert_eq!(score, track(&field, &config, &drive, 0..2, 150));
        assert_eq!(
            (score.frames, score.lost, score.silently_wrong),
            (240, 0, 0)
        );
        assert!(score.mean[0] < 0.01 && score.mean[1] < 0.01 && score.mean[2] < 0.15);
        let found = find(&field, &config, &drive, false, 1, 40);
        assert!(found.first >= 39 && found.first_five >= found.first);
        let kidnapped = kidnap(&field, &config, &drive, 1, 5);
        assert_eq!((kidnapped.said, kidnapped.back), (5, 5));
    }
}
