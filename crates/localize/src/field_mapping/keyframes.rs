//! Which images stand for the drive? Keyframes a short distance apart, each with the points of the images up to the next.

use super::FieldMappingConfig;
use super::error::FieldMappingError;
use crate::frames::{At, Pose, RobotFrame, Tf};
use crate::sample::LinePoint;

/// One image of a drive.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MappingImage {
    /// Motion since the previous image by the wheels: x, y (metres) and θ (radians) in the robot frame of that image.
    pub motion: [f32; 3],
    /// Line points, robot frame.
    pub points: Vec<LinePoint>,
}

/// A line point of a keyframe.
#[derive(Debug, Clone, Copy)]
pub(super) struct KeyframePoint {
    /// In the keyframe's robot frame.
    pub(super) at: At<RobotFrame>,
    /// Variance, m².
    pub(super) variance: f32,
    /// Weight in means, at most 1.
    pub(super) weight: f32,
}

/// A part of the drive.
#[derive(Debug, Clone)]
pub(super) struct Keyframe {
    pub(super) first_image: usize,
    /// Motion since the previous keyframe by the wheels, in its robot frame; zero for the first.
    pub(super) motion: Pose,
    pub(super) points: Vec<KeyframePoint>,
    /// On the map.
    pub(super) pose: Pose,
}

/// Images with points that a map needs.
const IMAGES_MIN: usize = 5;
/// Variance from which a point weighs half, m².
const FULL_VARIANCE: f32 = 0.0036;
/// Largest number of points of a keyframe.
const POINTS_MAX: usize = 400;

/// The keyframes of a drive.
pub(super) fn select(
    images: &[MappingImage],
    config: &FieldMappingConfig,
) -> Result<Vec<Keyframe>, FieldMappingError> {
    let usable = images
        .iter()
        .filter(|image| image.points.iter().any(|point| is_usable(point, config)))
        .count();
    if usable < IMAGES_MIN {
        return Err(FieldMappingError::FewImages(usable, IMAGES_MIN));
    }
    let mut keyframes: Vec<Keyframe> = Vec::new();
    let mut since: Tf<RobotFrame, RobotFrame> = Tf::new(0.0, 0.0, 0.0);
    for (number, image) in images.iter().enumerate() {
        let [x, y, theta] = image.motion;
        if number > 0 && image.motion.iter().all(|value| value.is_finite()) {
            since = since * Tf::new(x, y, theta);
        }
        let is_next = since.origin().distance() >= config.keyframe_distance
            || since.theta.abs() >= config.keyframe_turn;
        if keyframes.is_empty() || is_next {
            keyframes.push(Keyframe {
                first_image: number,
                motion: Pose::new(since.x, since.y, since.theta),
                points: Vec::new(),
                pose: Pose::new(0.0, 0.0, 0.0),
            });
            since = Tf::new(0.0, 0.0, 0.0);
        }
        let Some(keyframe) = keyframes.last_mut() else {
            continue;
        };
        let usable = image.points.iter().filter(|point| is_usable(point, config));
        keyframe.points.extend(usable.map(|point| {
            let variance = variance(point, config);
            KeyframePoint {
                at: since * point.at,
                variance,
                weight: FULL_VARIANCE / (FULL_VARIANCE + variance),
            }
        }));
    }
    for keyframe in &mut keyframes {
        let (count, step) = (
            keyframe.points.len(),
            keyframe.points.len().div_ceil(POINTS_MAX),
        );
        if count > POINTS_MAX {
            let thinned = keyframe.points.iter().step_by(step).copied().collect();
            keyframe.points = thinned;
        }
    }
    if keyframes.len() < 3 {
        return Err(FieldMappingError::NoMotion);
    }
    Ok(keyframes)
}

/// Mean variance over all directions, with the displacement by the robot's tilt (docs/methods.md 3.4).
fn variance(point: &LinePoint, config: &FieldMappingConfig) -> f32 {
    let sum = point.std_radial * point.std_radial + point.std_tangential * point.std_tangential;
    let (range, height) = (point.at.distance(), config.viewpoint_height.max(0.05));
    let displaced = config.tilt_std_deg.to_radians() * (height * height + range * range) / height;
    (0.5 * sum + displaced * displaced).max(1e-4)
}

/// Is a point fit for mapping?
fn is_usable(point: &LinePoint, config: &FieldMappingConfig) -> bool {
    let range = point.at.distance();
    point.at.x.is_finite()
        && point.at.y.is_finite()
        && range <= config.range_max
        && point.std_radial.is_finite()
        && point.std_tangential.is_finite()
}
