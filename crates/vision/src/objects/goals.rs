//! Goal detection: coloured walls beyond the carpet's boundary, and white posts.

use localize::frames::{At, RobotFrame};
use localize::math;

use crate::colour::class_bits::{class_bits, count_class};
use crate::colour::lookup_table::ColourClass;
use crate::config::ObjectDetectionConfig;
use crate::objects::carpet_end::{CarpetEnd, occludes_carpet_end};
use crate::objects::covariance::covariance_from_polar;
use crate::objects::radial_scan::RadialScan;

/// Kind of a goal detection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalKind {
    /// A blue goal of 2001.
    Blue,
    /// A yellow goal of 2001.
    Yellow,
    /// One white post.
    Post,
}

/// A goal or one of its posts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalDetection {
    /// Kind.
    pub kind: GoalKind,
    /// Its centre on the ground, metres.
    pub at: At<RobotFrame>,
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Visible width, metres.
    pub width: f32,
    /// Confidence, 0 to 1: mean fraction of its colour beyond the carpet along its rays.
    pub score: f32,
    /// Image position where its middle meets the carpet: column, row, pixels.
    pub position_px: [f32; 2],
}

/// Widest post, metres: the diagonal of its 0.125 m side, blurred.
const POST_WIDTH_MAX: f32 = 0.35;

/// Side of a post, metres.
const POST_SIDE: f32 = 0.125;

/// Narrowest goal, metres: part of the goal of 2001 may be hidden.
const GOAL_WIDTH_MIN: f32 = 0.5;

/// Groups adjacent rays that end at a goal's colour.
pub(crate) fn detect_goals(
    scan: &RadialScan,
    carpet_ends: &[CarpetEnd],
    config: &ObjectDetectionConfig,
) -> Vec<GoalDetection> {
    let mut found = Vec::new();
    for (kind, class) in [
        (GoalKind::Blue, ColourClass::BLUE),
        (GoalKind::Yellow, ColourClass::YELLOW),
        (GoalKind::Post, ColourClass::WHITE),
    ] {
        // Most halls have no coloured goals.
        if class_bits(&scan.classes, 0..scan.classes.len(), class).all(|bits| bits == 0) {
            continue;
        }
        let share: Vec<f32> = (0..scan.count())
            .map(|ray| goal_colour_share(scan, ray, &carpet_ends[ray], class))
            .collect();
        let joined = |a: usize, b: usize| {
            let (a_end, b_end) = (carpet_ends[a].range, carpet_ends[b].range);
            share[a] > 0.0
                && share[b] > 0.0
                && (a_end - b_end).abs() < 0.2 + 0.15 * a_end.min(b_end)
        };
        let count = scan.count();
        let Some(first) = (0..count).find(|&ray| !joined((ray + count - 1) % count, ray)) else {
            continue;
        };
        let mut group: Vec<usize> = Vec::new();
        for step in 0..=count {
            let ray = (first + step) % count;
            let follows = group.last().is_some_and(|&last| joined(last, ray)) && step < count;
            if !follows {
                found.extend(build_goal(scan, carpet_ends, &share, &group, kind, config));
                group.clear();
            }
            if share[ray] > 0.0 {
                group.push(ray);
            }
        }
    }
    found
}

/// Fraction of the samples beyond the carpet that have a colour; zero below 0.6.
///
/// For a goal's wall only samples next to the carpet count. A post is higher than the mirror and covers its direction up
/// to the horizon, unlike stickers on robots, glare or lines.
fn goal_colour_share(
    scan: &RadialScan,
    ray: usize,
    carpet_end: &CarpetEnd,
    class: ColourClass,
) -> f32 {
    if !(carpet_end.carpet_seen && carpet_end.range.is_finite()) {
        return 0.0;
    }
    let far = if class == ColourClass::WHITE {
        scan.first_above_horizon(ray, carpet_end.first_beyond)
    } else {
        scan.starts[ray + 1].min(carpet_end.first_beyond + 16)
    };
    let beyond = carpet_end.first_beyond..far;
    let samples = beyond.len().max(1) as f32;
    let share = count_class(&scan.classes, beyond, class) as f32 / samples;
    if share >= 0.6 { share } else { 0.0 }
}

fn build_goal(
    scan: &RadialScan,
    carpet_ends: &[CarpetEnd],
    share: &[f32],
    group: &[usize],
    kind: GoalKind,
    config: &ObjectDetectionConfig,
) -> Option<GoalDetection> {
    let ends: Vec<[f32; 2]> = group
        .iter()
        .map(|&ray| scan.samples[carpet_ends[ray].first_beyond.saturating_sub(1)].ground)
        .collect();
    let count = ends.len() as f32;
    let [x, y] = ends.iter().fold([0.0, 0.0], |[x, y], end| {
        [x + end[0] / count, y + end[1] / count]
    });
    let range = math::hypot(x, y);
    let ray_angle = std::f32::consts::TAU / share.len() as f32;
    let width = match (ends.first(), ends.last()) {
        (Some(a), Some(b)) => math::hypot(a[0] - b[0], a[1] - b[1]) + ray_angle * range,
        _ => return None,
    };
    match kind {
        GoalKind::Post if width > POST_WIDTH_MAX || range > 6.0 => return None,
        // Half of its side may be hidden; rays resolve half a ray's spacing.
        GoalKind::Post if width + 0.5 * ray_angle * range < 0.5 * POST_SIDE => return None,
        // A wall or a window at the carpet's boundary has the same boundary next to it.
        GoalKind::Post
            if !occludes_carpet_end(carpet_ends, group, range, config.post_depth_step_min) =>
        {
            return None;
        }
        GoalKind::Blue | GoalKind::Yellow if width < GOAL_WIDTH_MIN => return None,
        _ => {}
    }
    let [ex, ey] = [x / range, y / range];
    let (along, across) = (0.05 + 0.05 * range, ray_angle * range);
    let sample = scan.samples[carpet_ends[group[group.len() / 2]]
        .first_beyond
        .saturating_sub(1)];
    Some(GoalDetection {
        kind,
        at: At::new(x, y),
        covariance: covariance_from_polar([ex, ey], along, across),
        width,
        score: group.iter().map(|&ray| share[ray]).sum::<f32>() / count,
        position_px: [f32::from(sample.u), f32::from(sample.v)],
    })
}
