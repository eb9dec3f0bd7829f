//! Is the stated covariance right, and how large is the error, on rough drives? One score per condition.
//!
//! NEES is divided by the three degrees of freedom: 1 if the covariance is consistent.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use serde::Serialize;

use super::rough_drive::{RoughDrive, RoughDriveConfig, RoughSample, wheels_as_described};
use crate::config::LocalizeConfig;
use crate::estimate::{Estimate, Mode};
use crate::field::Field;
use crate::localizer::Localizer;
use crate::math;

/// Errors of the estimates on the drives of one condition.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct ConsistencyScore {
    /// Images scored, from three seconds after each start.
    pub images: usize,
    /// Mean |x|, |y| (metres) and |θ| (degrees).
    pub mean_error: [f64; 3],
    /// Largest position error, metres.
    pub max_error: f64,
    /// Normalised estimation error squared over its degrees of freedom, images with points.
    pub nees: f64,
    /// Interval of `nees` in which its value over many drives lies (95 %, bootstrap over the drives).
    pub nees_interval: [f64; 2],
    /// The same as `nees`, images without points.
    pub blind_nees: f64,
    /// Share of the images without points whose position and heading errors are within three standard deviations.
    pub blind_within_3_sigma: f64,
    /// Root mean square position error of the last image of each blind interval, metres.
    pub blind_end_error: f64,
    /// Its mean.
    pub blind_end_mean: f64,
    /// Largest position error within five images after each blind interval, metres.
    pub reacquisition_error_max: f64,
    /// Images without a pose.
    pub lost: usize,
    /// NEES of x, y and θ, each alone.
    pub marginal_nees: [f64; 3],
    /// NEES of the second before the score begins, and of each third of the drive.
    pub nees_over_time: [f64; 4],
}

/// Sums over the images of a condition.
#[derive(Default)]
struct Sums {
    score: ConsistencyScore,
    located: usize,
    seen: usize,
    /// Sum of the squared errors and number of images, of each drive.
    drives: Vec<(f64, usize)>,
    blind: usize,
    blind_within: usize,
    blind_ends: usize,
    course: [f64; 4],
    course_count: [usize; 4],
}

/// Time from the start of a drive from which it is scored, seconds.
const WARM_UP: f64 = 3.0;

/// Localizes a drive of `seconds` for each seed.
pub fn evaluate_consistency(
    field: &Field,
    config: &LocalizeConfig,
    drive: &RoughDriveConfig,
    seeds: std::ops::Range<u64>,
    seconds: f64,
) -> ConsistencyScore {
    let mut sums = Sums::default();
    let mut base = Localizer::new(field, config.clone());
    if let (true, Ok(wheels)) = (drive.wheels.known, wheels_as_described()) {
        base.set_wheels(&wheels, None);
    }
    for seed in seeds {
        let mut localizer = base.clone();
        let rng = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(7_000_000));
        let images = (seconds * drive.frame_rate) as usize;
        let mut samples = RoughDrive::new(field, drive.clone(), rng)
            .take(images)
            .peekable();
        let mut since_blind = usize::MAX;
        sums.drives.push((0.0, 0));
        while let Some(sample) = samples.next() {
            localizer.add_odometry(&sample.odometry);
            localizer.add_compass(&sample.compass);
            let estimate = localizer.process_points(sample.stamp, &sample.points);
            since_blind = if sample.blind_for > 0.0 {
                0
            } else {
                since_blind.saturating_add(1)
            };
            let ends_blind =
                sample.blind_for > 0.0 && samples.peek().is_some_and(|next| next.blind_for == 0.0);
            let time = sample.stamp.0 as f64 * 1e-9;
            sums.add_to_course(&sample, &estimate, time, seconds);
            if time >= WARM_UP {
                sums.add(&sample, &estimate, since_blind, ends_blind);
            }
        }
    }
    sums.finish()
}

impl Sums {
    fn add(
        &mut self,
        sample: &RoughSample,
        estimate: &Estimate,
        since_blind: usize,
        ends_blind: bool,
    ) {
        let score = &mut self.score;
        score.images += 1;
        let Some(pose) = estimate.pose.filter(|_| estimate.mode != Mode::Lost) else {
            score.lost += 1;
            return;
        };
        self.located += 1;
        let off = pose.difference(sample.true_pose);
        let position = f64::from(math::hypot(off[0], off[1]));
        let values = [off[0], off[1], off[2].to_degrees()];
        for (sum, value) in score.mean_error.iter_mut().zip(values) {
            *sum += f64::from(value.abs());
        }
        score.max_error = score.max_error.max(position);
        let normalised = estimate
            .covariance
            .try_inverse()
            .map_or(0.0, |inverse| f64::from(off.dot(&(inverse * off))));
        if sample.blind_for == 0.0 {
            self.seen += 1;
            score.nees += normalised / 3.0;
            if let Some((sum, images)) = self.drives.last_mut() {
                *sum += normalised / 3.0;
                *images += 1;
            }
            for k in 0..3 {
                score.marginal_nees[k] += f64::from(off[k] * off[k] / estimate.covariance[(k, k)]);
            }
            if since_blind <= 5 {
                score.reacquisition_error_max = score.reacquisition_error_max.max(position);
            }
        } else {
            self.blind += 1;
            score.blind_nees += normalised / 3.0;
            let within = (0..3).all(|k| off[k].powi(2) <= 9.0 * estimate.covariance[(k, k)]);
            self.blind_within += usize::from(within);
            if ends_blind {
                self.blind_ends += 1;
                score.blind_end_error += position * position;
                score.blind_end_mean += position;
            }
        }
    }

    fn add_to_course(
        &mut self,
        sample: &RoughSample,
        estimate: &Estimate,
        time: f64,
        duration: f64,
    ) {
        let Some(pose) = estimate.pose.filter(|_| time > WARM_UP - 1.0) else {
            return;
        };
        let third = if time < WARM_UP {
            0
        } else {
            1 + (3.0 * (time - WARM_UP) / (duration - WARM_UP)).clamp(0.0, 2.0) as usize
        };
        let off = pose.difference(sample.true_pose);
        let inverse = estimate.covariance.try_inverse();
        let normalised = inverse.map_or(0.0, |inverse| f64::from(off.dot(&(inverse * off))));
        self.course[third] += normalised / 3.0;
        self.course_count[third] += 1;
    }

    fn finish(self) -> ConsistencyScore {
        let mut score = self.score;
        let per = |sum: f64, count: usize| sum / count.max(1) as f64;
        score.mean_error = score.mean_error.map(|sum| per(sum, self.located));
        score.nees = per(score.nees, self.seen);
        score.nees_interval = bootstrap_interval(&self.drives);
        score.marginal_nees = score.marginal_nees.map(|sum| per(sum, self.seen));
        score.nees_over_time = std::array::from_fn(|k| per(self.course[k], self.course_count[k]));
        score.blind_nees = per(score.blind_nees, self.blind);
        score.blind_within_3_sigma = per(self.blind_within as f64, self.blind);
        score.blind_end_error = per(score.blind_end_error, self.blind_ends).sqrt();
        score.blind_end_mean = per(score.blind_end_mean, self.blind_ends);
        score
    }
}

/// Interval of 95 % of the ratio of the sums, from drives drawn with replacement. Images of one drive are not independent,
/// its start and its path least of all.
fn bootstrap_interval(drives: &[(f64, usize)]) -> [f64; 2] {
    const RESAMPLINGS: usize = 1000;
    if drives.is_empty() {
        return [0.0; 2];
    }
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut means: Vec<f64> = (0..RESAMPLINGS)
        .map(|_| {
            let drawn = (0..drives.len()).map(|_| drives[rng.random_range(0..drives.len())]);
            let (sum, images) = drawn.fold((0.0, 0), |(sum, count), (more, images)| {
                (sum + more, count + images)
            });
            sum / images.max(1) as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    [RESAMPLINGS / 40, RESAMPLINGS - RESAMPLINGS / 40 - 1].map(|k| means[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::league_18x12;

    #[test]
    fn covariance_is_consistent_whatever_the_noise_is() {
        let field = league_18x12("outer_edges");
        // The map is exact here: its own uncertainty would hide that of the noise.
        let mut config = LocalizeConfig::default();
        config.map_correction.enabled = false;
        for (wheels, tilt_deg, points) in [(0.25, 0.0, 2.0), (1.0, 0.45, 1.0), (4.0, 1.0, 0.5)] {
            let drive = RoughDriveConfig::with_scaled_errors(wheels, tilt_deg, points);
            let score = evaluate_consistency(&field, &config, &drive, 0..3, 30.0);
            assert_eq!(score.lost, 0);
            // Errors of consecutive images are correlated: the bounds are wider than those of many drives.
            assert!(
                (0.5..1.8).contains(&score.nees),
                "{wheels} {tilt_deg} {points}: {score:?}"
            );
        }
    }

    #[test]
    fn every_filter_knows_how_far_it_is_off_after_half_a_minute_without_sight() {
        let field = league_18x12("outer_edges");
        let drive = RoughDriveConfig {
            blind: Some((40.0, 30.0)),
            ..RoughDriveConfig::default()
        };
        for preset in ["default", "nubot2013"] {
            let config = LocalizeConfig::preset(preset).expect("a preset");
            let score = evaluate_consistency(&field, &config, &drive, 0..4, 40.0);
            assert!(score.blind_within_3_sigma > 0.9, "{preset}: {score:?}");
        }
    }
}
