//! How often does an unknown start end at a wrong place, and how long does it take to say a place? Starts of rough drives.

use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use serde::Serialize;

use super::rough_drive::{RoughDrive, RoughDriveConfig};
use crate::config::LocalizeConfig;
use crate::estimate::Mode;
use crate::field::Field;
use crate::localizer::Localizer;
use crate::math;

/// Starts of one condition.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct StartScore {
    /// Starts.
    pub starts: usize,
    /// Starts in which an image claimed a wrong place: half a metre off and beyond ten standard deviations.
    pub wrong: usize,
    /// Starts whose last image claimed a wrong place.
    pub wrong_at_end: usize,
    /// Starts that tracked no pose at any time.
    pub undecided: usize,
    /// Images that claimed a wrong place.
    pub wrong_images: usize,
    /// Median and 95th percentile of the time until a pose is tracked, seconds.
    pub time_to_pose: [f64; 2],
    /// Largest of these times, seconds.
    pub time_to_pose_max: f64,
}

/// Position error from which a place is wrong, metres.
const WRONG_DISTANCE: f32 = 0.5;
/// Squared error in standard deviations from which a claim is wrong.
const WRONG_SQUARED: f32 = 100.0;

/// Starts the localizer at a random pose for each seed, and follows it for `seconds`.
pub fn evaluate_starts(
    field: &Field,
    config: &LocalizeConfig,
    drive: &RoughDriveConfig,
    seeds: std::ops::Range<u64>,
    seconds: f64,
) -> StartScore {
    let mut score = StartScore::default();
    let mut times = Vec::new();
    let base = Localizer::new(field, config.clone());
    for seed in seeds {
        let mut localizer = base.clone();
        let rng = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(8_000_000));
        let images = (seconds * drive.frame_rate) as usize;
        let mut tracked_at = None;
        let mut wrong_images = 0;
        let mut is_wrong = false;
        for (k, sample) in RoughDrive::new(field, drive.clone(), rng)
            .take(images)
            .enumerate()
        {
            localizer.add_odometry(&sample.odometry);
            localizer.add_compass(&sample.compass);
            let estimate = localizer.process_points(sample.stamp, &sample.points);
            if estimate.mode == Mode::Tracking {
                tracked_at.get_or_insert(k);
            }
            is_wrong = estimate.pose.is_some_and(|pose| {
                let off = pose.difference(sample.true_pose);
                let inverse = estimate.covariance.try_inverse();
                math::hypot(off[0], off[1]) > WRONG_DISTANCE
                    && inverse.is_some_and(|inverse| off.dot(&(inverse * off)) > WRONG_SQUARED)
            });
            wrong_images += usize::from(is_wrong);
        }
        score.starts += 1;
        score.wrong += usize::from(wrong_images > 0);
        score.wrong_images += wrong_images;
        score.wrong_at_end += usize::from(is_wrong);
        match tracked_at {
            Some(image) => times.push((image + 1) as f64 / drive.frame_rate),
            None => score.undecided += 1,
        }
    }
    times.sort_by(f64::total_cmp);
    if let Some(last) = times.len().checked_sub(1) {
        score.time_to_pose = [0.5, 0.95].map(|share| times[(share * last as f64) as usize]);
        score.time_to_pose_max = times[last];
    }
    score
}
