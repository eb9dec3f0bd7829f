//! Evaluation of a configuration on synthetic drives, kidnaps and single images against ground truth.
//!
//! Equal seeds give equal scores. The caller measures time.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use serde::Serialize;

use crate::config::LocalizeConfig;
use crate::estimate::{Estimate, Mode, Reason};
use crate::field::Field;
use crate::frames::Pose;
use crate::global_search::branch_and_bound::{BranchAndBound, HeadingPrior, half_turn};
use crate::global_search::{GlobalSearch, SearchInput};
use crate::localizer::Localizer;
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::random::standard_normal;
use crate::synthetic::drive::{
    SyntheticDrive, SyntheticDriveConfig, random_pose, simulate_line_points,
};

/// Errors of tracked drives.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct TrackingScore {
    /// Images scored, from one second after each start.
    pub frames: usize,
    /// Mean |x|, |y| (metres) and |θ| (degrees).
    pub mean_error: [f32; 3],
    /// Largest of the same.
    pub max_error: [f32; 3],
    /// Images reported as lost.
    pub lost_frames: usize,
    /// Images with an error of at least 0.5 m in mode `tracking`.
    pub undetected_failures: usize,
    /// Images in which a pose was dropped or marked suspect.
    pub alarms: usize,
    /// Mean normalised estimation error squared; 3 if the covariance is consistent.
    pub nees: f32,
}

/// Tracks `frames` images from the start of each seed, with a compass.
pub fn evaluate_tracking(
    field: &Field,
    config: &LocalizeConfig,
    drive: &SyntheticDriveConfig,
    seeds: std::ops::Range<u64>,
    frames: usize,
) -> TrackingScore {
    let mut score = TrackingScore::default();
    let mut normalised = 0.0_f64;
    let mut sums = [0.0_f64; 3];
    let warm_up = drive.frame_rate as usize;
    for seed in seeds {
        let mut localizer = Localizer::new(field, config.clone());
        let rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let drive = SyntheticDrive::new(field, drive.clone(), rng);
        for (k, frame) in drive.take(frames).enumerate() {
            localizer.add_odometry(&frame.odometry);
            localizer.add_compass(&frame.compass);
            let estimate = localizer.process_points(frame.stamp, &frame.points);
            if k < warm_up {
                continue;
            }
            score.frames += 1;
            score.alarms += usize::from(is_alarm(&estimate));
            let Some(pose) = estimate.pose else {
                score.lost_frames += 1;
                continue;
            };
            let off = pose.difference(frame.true_pose);
            score.undetected_failures +=
                usize::from(estimate.mode == Mode::Tracking && math::hypot(off[0], off[1]) >= 0.5);
            for (i, value) in [off[0], off[1], off[2].to_degrees()]
                .into_iter()
                .enumerate()
            {
                sums[i] += f64::from(value.abs());
                score.max_error[i] = score.max_error[i].max(value.abs());
            }
            normalised += f64::from(normalized_error_squared(&estimate, &off));
        }
    }
    let located = (score.frames - score.lost_frames).max(1) as f64;
    score.mean_error = sums.map(|sum| (sum / located) as f32);
    score.nees = (normalised / located) as f32;
    score
}

fn is_alarm(estimate: &Estimate) -> bool {
    estimate.mode == Mode::Lost || estimate.reason == Some(Reason::BetterAlternative)
}

fn normalized_error_squared(estimate: &Estimate, off: &Vector3<f32>) -> f32 {
    estimate
        .covariance
        .try_inverse()
        .map_or(0.0, |inverse| off.dot(&(inverse * off)))
}

/// Errors of global localization from single images.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct GlobalSearchScore {
    /// Images.
    pub frames: usize,
    /// The first hypothesis is correct: within 0.25 m and 5° of the truth, modulo the half turn without a compass.
    pub top_1: usize,
    /// One of the first five hypotheses is correct; half turns count once.
    pub top_5: usize,
}

/// Locates `count` random poses from one image each, with or without a compass of the drive's noise.
pub fn evaluate_global_search(
    field: &Field,
    config: &LocalizeConfig,
    drive: &SyntheticDriveConfig,
    compass: bool,
    seed: u64,
    count: usize,
) -> GlobalSearchScore {
    let distances = DistanceField::new(field, &config.distance_field);
    let mut search = BranchAndBound::new(field, &distances, config.branch_and_bound.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut global_search = GlobalSearch::new(field, &distances, &config.global_search);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let std = drive.compass_std_deg.to_radians();
    let mut score = GlobalSearchScore::default();
    for _ in 0..count {
        let truth = random_pose(field, &mut rng);
        let points = simulate_line_points(field, drive, truth, &mut rng);
        let heading = truth.theta + std * standard_normal(&mut rng);
        global_search.reset();
        let input = SearchInput {
            distances: &distances,
            points: &points,
            heading_prior: compass.then_some(HeadingPrior { heading, std }),
            goals: &[],
            single_image: true,
        };
        let hypotheses = global_search
            .find_hypotheses(&mut search, &mut matcher, &input)
            .hypotheses;
        let is_hit =
            |pose: Pose| is_correct(pose, truth) || !compass && is_correct(half_turn(pose), truth);
        // Without a compass each pose is followed by its half turn.
        let step = if !compass && search.is_half_turn_symmetric() {
            2
        } else {
            1
        };
        let rank = hypotheses
            .iter()
            .step_by(step)
            .position(|hypothesis| is_hit(hypothesis.pose));
        score.frames += 1;
        score.top_1 += usize::from(rank == Some(0));
        score.top_5 += usize::from(rank.is_some_and(|rank| rank < 5));
    }
    score
}

fn is_correct(pose: Pose, truth: Pose) -> bool {
    let off = pose.difference(truth);
    math::hypot(off[0], off[1]) < 0.25 && off[2].abs() < 5.0_f32.to_radians()
}

/// Detection of and recovery from kidnaps.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct KidnapScore {
    /// Kidnaps.
    pub kidnaps: usize,
    /// Within 0.4 s the mode was no longer `tracking`, or the pose was correct.
    pub detected: usize,
    /// Within 0.4 s after the detection the pose was correct (0.15 m, 3°).
    pub recovered: usize,
}

/// Kidnaps the robot `count` times to a random pose, three seconds apart, with a compass.
pub fn evaluate_kidnaps(
    field: &Field,
    config: &LocalizeConfig,
    drive: &SyntheticDriveConfig,
    seed: u64,
    count: usize,
) -> KidnapScore {
    let mut localizer = Localizer::new(field, config.clone());
    let frames_max = (0.4 * drive.frame_rate) as usize;
    let interval = (3.0 * drive.frame_rate) as usize;
    let rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut drive = SyntheticDrive::new(field, drive.clone(), rng);
    let mut score = KidnapScore::default();
    for kidnap in 0..=count {
        let (mut detected_at, mut recovered_at) = (None, None);
        for (k, frame) in drive.by_ref().take(interval).enumerate() {
            localizer.add_odometry(&frame.odometry);
            localizer.add_compass(&frame.compass);
            let estimate = localizer.process_points(frame.stamp, &frame.points);
            let is_correct = estimate.pose.is_some_and(|pose| {
                let off = pose.difference(frame.true_pose);
                math::hypot(off[0], off[1]) < 0.15 && off[2].abs() < 3.0_f32.to_radians()
            });
            if estimate.mode != Mode::Tracking || is_correct {
                detected_at = detected_at.or(Some(k));
            }
            if is_correct && detected_at.is_some() {
                recovered_at = recovered_at.or(Some(k));
            }
        }
        drive.kidnap();
        // The first interval starts without a kidnap.
        if kidnap == 0 {
            continue;
        }
        score.kidnaps += 1;
        score.detected += usize::from(detected_at.is_some_and(|k| k <= frames_max));
        let in_time = detected_at
            .zip(recovered_at)
            .is_some_and(|(detected, recovered)| recovered <= detected + frames_max);
        score.recovered += usize::from(in_time);
    }
    score
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;

    #[test]
    fn equal_seeds_give_equal_scores() {
        let field = league_18x12("outer_edges");
        let (config, drive) = (LocalizeConfig::default(), SyntheticDriveConfig::default());
        let score = evaluate_tracking(&field, &config, &drive, 0..2, 150);
        assert_eq!(score, evaluate_tracking(&field, &config, &drive, 0..2, 150));
        assert_eq!(
            (score.frames, score.lost_frames, score.undetected_failures),
            (240, 0, 0)
        );
        assert!(
            score.mean_error[0] < 0.01 && score.mean_error[1] < 0.01 && score.mean_error[2] < 0.15
        );
        let found = evaluate_global_search(&field, &config, &drive, false, 1, 40);
        assert!(found.top_1 >= 39 && found.top_5 >= found.top_1);
        let kidnapped = evaluate_kidnaps(&field, &config, &drive, 1, 5);
        assert_eq!((kidnapped.detected, kidnapped.recovered), (5, 5));
    }
}
