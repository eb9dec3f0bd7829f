//! How true is a field that was mapped from a drive, and how well does the robot know its place on it? Rough drives.

use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use serde::Serialize;

use super::rough_drive::{RoughDrive, RoughDriveConfig};
use crate::config::LocalizeConfig;
use crate::estimate::Mode;
use crate::field::{Field, Marking, marking_points};
use crate::field_mapping::{
    FieldMappingConfig, FieldMappingError, MappedField, MappingImage, map_field,
};
use crate::frames::{At, FieldFrame, Pose, RobotFrame, Tf};
use crate::global_search::branch_and_bound::half_turn;
use crate::localizer::Localizer;
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::sample::LinePoint;

/// A mapped field next to the true one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct MappingScore {
    /// Root mean square distance of the mapped markings from the true ones, metres.
    pub marking_error: f32,
    /// Largest distance of the mapped markings from the true ones, metres; of those within half a metre.
    pub marking_error_max: f32,
    /// Share of the mapped markings' length farther than 15 cm from every true one.
    pub false_share: f32,
    /// Share of the true markings' length with a mapped one within 15 cm.
    pub found_share: f32,
    /// Mean square of the lines' errors across them over their stated variances; 1 if these are honest.
    pub normalized_error: f32,
    /// Lines and arcs.
    pub markings: usize,
    /// Keyframes that saw places which others had seen.
    pub revisits: usize,
    /// Position error of another drive that is localized on the mapped field, mean, metres. None if it never was.
    pub position_error: Option<f32>,
    /// The same drive on the true field.
    pub position_error_true_field: Option<f32>,
    /// Share of this drive's images after three seconds that track a pose within half a metre.
    pub tracked_share: f32,
}

/// Distance between samples of a marking, metres.
const SPACING: f32 = 0.1;
/// Distance from which a marking is another one, metres.
const SAME_MARKING: f32 = 0.15;
/// Error of the fields' alignment before it is refined, metres.
const ALIGNMENT_ERROR: f32 = 0.3;

/// Maps a field from a drive of `seconds`, compares it with the true one, and localizes a second drive on it.
pub fn evaluate_mapping(
    field: &Field,
    drive: &RoughDriveConfig,
    config: &FieldMappingConfig,
    seconds: f64,
    seed: u64,
) -> Result<MappingScore, FieldMappingError> {
    let (mapped, start) = map_drive(field, drive, config, seconds, seed)?;
    let Ok(found) = Field::new(mapped.config.clone()) else {
        return Err(FieldMappingError::NoMarkings(mapped.poses.len()));
    };
    let first = mapped.poses.first().copied().unwrap_or(start);
    let true_from_found = align(field, &found, start * first.inverse());
    let true_distances = distances(field);
    let found_distances = distances(&found);
    let [mut squares, mut most, mut near, mut wrong] = [0.0_f32; 4];
    for at in line_points(&found) {
        let at = true_from_found * at;
        let distance = true_distances.nearest(at.x, at.y).signed_distance.abs();
        if distance > SAME_MARKING {
            wrong += 1.0;
        } else {
            squares += distance * distance;
            near += 1.0;
        }
        if distance < 0.5 {
            most = most.max(distance);
        }
    }
    let found_from_true = true_from_found.inverse();
    let truth = line_points(field);
    let seen = truth.iter().filter(|&&at| {
        let at = found_from_true * at;
        found_distances.nearest(at.x, at.y).signed_distance.abs() <= SAME_MARKING
    });
    let found_share = seen.count() as f32 / truth.len().max(1) as f32;
    let localized = localize(&found, field, true_from_found, drive, seed + 1_000_000);
    let on_truth = localize(
        field,
        field,
        Tf::new(0.0, 0.0, 0.0),
        drive,
        seed + 1_000_000,
    );
    Ok(MappingScore {
        marking_error: (squares / near.max(1.0)).sqrt(),
        marking_error_max: most,
        false_share: wrong / (near + wrong).max(1.0),
        found_share,
        normalized_error: normalized_error(&found, true_from_found, &true_distances),
        markings: found.markings.len(),
        revisits: mapped.revisits,
        position_error: localized.0,
        position_error_true_field: on_truth.0,
        tracked_share: localized.1,
    })
}

/// Maps a field from a drive; also the true pose at its first image.
pub fn map_drive(
    field: &Field,
    drive: &RoughDriveConfig,
    config: &FieldMappingConfig,
    seconds: f64,
    seed: u64,
) -> Result<(MappedField, Pose), FieldMappingError> {
    let rng = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(52_000_000));
    let count = (seconds * drive.frame_rate) as usize;
    let mut images = Vec::with_capacity(count);
    let mut start = Pose::new(0.0, 0.0, 0.0);
    for (k, sample) in RoughDrive::new(field, drive.clone(), rng)
        .take(count)
        .enumerate()
    {
        if k == 0 {
            start = sample.true_pose;
        }
        let odometry = &sample.odometry;
        images.push(MappingImage {
            motion: [odometry.dx, odometry.dy, odometry.dtheta],
            points: sample.points,
        });
    }
    Ok((map_field(&images, config)?, start))
}

fn distances(field: &Field) -> DistanceField {
    DistanceField::new(field, &Default::default())
}

/// The motion from the found field to the true one that brings their markings together.
fn align(
    field: &Field,
    found: &Field,
    start: Tf<FieldFrame, FieldFrame>,
) -> Tf<FieldFrame, FieldFrame> {
    let points: Vec<LinePoint> = line_points(found)
        .iter()
        .map(|at| LinePoint {
            at: At::<RobotFrame>::new(at.x, at.y),
            std_radial: 0.03,
            std_tangential: 0.03,
        })
        .collect();
    let mut matcher = Matcher::new(crate::matching::MatchConfig {
        // The markings of a map lean nowhere.
        tilt_std_deg: 0.0,
        ..Default::default()
    });
    let start = Pose::new(start.x, start.y, start.theta);
    let pose = matcher
        .refine(&distances(field), &points, start, ALIGNMENT_ERROR)
        .pose;
    Tf::new(pose.x, pose.y, pose.theta)
}

/// Mean square of the lines' errors across them at their middle, over their stated variances.
fn normalized_error(
    found: &Field,
    true_from_found: Tf<FieldFrame, FieldFrame>,
    truth: &DistanceField,
) -> f32 {
    let [mut sum, mut count] = [0.0_f32; 2];
    let lines = found
        .config
        .extra_lines
        .iter()
        .zip(&found.config.extra_lines_std);
    for (&[x0, y0, x1, y1], &[std_x, std_y, ..]) in lines {
        let length = math::hypot(x1 - x0, y1 - y0).max(1e-6);
        let at = true_from_found * At::new(0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let distance = truth.nearest(at.x, at.y).signed_distance.abs();
        if distance > SAME_MARKING {
            continue;
        }
        // The stated deviations are those of the ends, twice those of the middle.
        let across = math::hypot(std_x * (y1 - y0) / length, std_y * (x1 - x0) / length) / 2.0;
        sum += (distance / across.max(1e-4)).powi(2);
        count += 1.0;
    }
    sum / f32::max(count, 1.0)
}

/// Seconds of the drive that is localized, and after which it counts.
const LOCALIZED_SECONDS: f64 = 20.0;
const SETTLED_SECONDS: f64 = 3.0;

/// Localizes a drive over the true field on the found one: mean position error, and share of images within half a metre.
fn localize(
    found: &Field,
    field: &Field,
    true_from_found: Tf<FieldFrame, FieldFrame>,
    drive: &RoughDriveConfig,
    seed: u64,
) -> (Option<f32>, f32) {
    let mut localizer = Localizer::new(found, LocalizeConfig::default());
    let symmetric = is_symmetric(field);
    let rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let images = (LOCALIZED_SECONDS * drive.frame_rate) as usize;
    let [mut sum, mut near, mut count] = [0.0_f32; 3];
    for (k, sample) in RoughDrive::new(field, drive.clone(), rng)
        .take(images)
        .enumerate()
    {
        localizer.add_odometry(&sample.odometry);
        let estimate = localizer.process_points(sample.stamp, &sample.points);
        if (k as f64) < SETTLED_SECONDS * drive.frame_rate {
            continue;
        }
        count += 1.0;
        let Some(pose) = estimate.pose.filter(|_| estimate.mode != Mode::Lost) else {
            continue;
        };
        let at = (true_from_found * pose).origin();
        let off = |pose: Pose| at.distance_to(pose.origin());
        let mut error = off(sample.true_pose);
        if symmetric {
            error = error.min(off(half_turn(sample.true_pose)));
        }
        if error < 0.5 {
            near += 1.0;
            sum += error;
        }
    }
    ((near > 0.0).then(|| sum / near), near / count.max(1.0))
}

/// Does a half turn leave the true field as it is?
fn is_symmetric(field: &Field) -> bool {
    crate::global_search::branch_and_bound::is_half_turn_symmetric(field, &distances(field))
}

/// Points along all lines and arcs. Spots are not mapped.
fn line_points(field: &Field) -> Vec<At<FieldFrame>> {
    let is_line = |marking: &&Marking| !matches!(marking, Marking::Spot { .. });
    let lines: Vec<Marking> = field.markings.iter().filter(is_line).copied().collect();
    marking_points(&lines, SPACING)
}
