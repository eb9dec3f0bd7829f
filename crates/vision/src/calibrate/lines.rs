//! Calibration of the ground map from the field's own lines: no strip, poses unknown.
//!
//! An initial map (or a radial guess) is corrected by a smooth function of range and bearing. The line points of all
//! images then fall on the field's markings, each image with its own unknown pose and tilt. Initial poses come from a
//! global search under several scales, since a guess may be a fifth too long or too short.

use localize::frames::At;
use localize::global_search::branch_and_bound::{BranchAndBound, BranchAndBoundConfig};
use localize::matching::distance_field::DistanceField;
use localize::matching::{MatchConfig, Matcher};
use localize::math;
use localize::sample::LinePoint;
use localize::{Field, Pose};
use rayon::prelude::*;

use crate::calibrate::joint_fit::{CORRECTION_SCHEDULE, FitImage, JointFit, Markings};
use crate::calibrate::map_correction::{BasisValues, CorrectionPoint, MapCorrection};
use crate::calibrate::repeated_images::repeated_images;
use crate::calibrate::{CalibrationError, Disagreement, ImageResidual, listed_reasons};
use crate::config::VisionConfig;
use crate::error::VisionError;
use crate::image::Image;
use crate::lines::detection::LinePointDetection;
use crate::optics::ground_map::GroundMap;
use crate::process::Vision;
use localize::robot::CameraConfig;

/// One image with its name.
#[derive(Debug, Clone)]
pub struct NamedImage {
    /// Its file, for messages.
    pub name: String,
    /// The image.
    pub image: Image,
}

/// The corrected map and its residuals.
#[derive(Debug, Clone)]
pub struct LinesCalibration {
    /// The ground map.
    pub map: GroundMap,
    /// One per image; `rms_px` is of its inliers, in pixels on the ground.
    pub images: Vec<ImageResidual>,
    /// Pose of each used image (ambiguous by half a turn, since the markings are symmetric).
    pub poses: Vec<Option<Pose>>,
    /// Root mean square of the inliers' distances from the markings, metres.
    pub rms: f64,
    /// Fraction of the used images' points that lie on markings.
    pub inlier_share: f64,
    /// As `inlier_share`, of the points inside the boundary lines: beside the field there is clutter.
    pub on_field_share: f64,
    /// Distance up to which the images show lines: 95 % of the used line points are nearer, metres. Beyond it the map continues the shape
    /// within it.
    pub reach: f64,
    /// Disagreement of the maps of two halves of the images. None for fewer than eight used images.
    pub disagreement: Option<Disagreement>,
    /// A size of the field by which the images fit better, as an edit of its file. None if no other size does.
    pub better_size: Option<String>,
    /// Mean cost of the points of each image. NaN if it has no pose.
    pub(super) costs: Vec<f64>,
}

impl LinesCalibration {
    /// Number of the images that were used.
    pub(super) fn used_count(&self) -> usize {
        let used = self.images.iter().filter(|image| image.left_out.is_none());
        used.count()
    }

    /// Those of the calibrated images that were used.
    pub(super) fn used<'a>(&self, images: &'a [NamedImage]) -> Vec<&'a NamedImage> {
        let residuals = images.iter().zip(&self.images);
        residuals
            .filter(|(_, residual)| residual.left_out.is_none())
            .map(|(image, _)| image)
            .collect()
    }
}

/// Scales and powers of the initial search: a guess may be 30 % off and have the wrong curvature.
const SCALES: [f64; 9] = [0.7, 0.77, 0.83, 0.9, 1.0, 1.1, 1.2, 1.3, 1.42];
const POWERS: [f64; 3] = [-0.15, 0.0, 0.15];

/// Part of the least width of a line that is still accepted if the map is a guess.
pub(super) const GUESS_WIDTH_SLACK: f32 = 0.6;

/// Fewest line points of an image.
const POINTS_MIN: usize = 25;

/// Fewest images that separate the map from the poses.
pub(super) const IMAGES_MIN: usize = 4;

/// Most images that a calibration by lines uses; more are subsampled evenly.
pub const LINES_IMAGES_MAX: usize = 60;

/// Share of the line points that are nearer than the reach of the images.
const REACH_SHARE: f64 = 0.95;

/// An image with a smaller fraction of points on markings is excluded in the end.
const INLIER_SHARE_MIN: f64 = 0.6;

/// The map that puts the line points of images anywhere on the field on its markings, from a guess.
pub(super) fn fit_guess(
    camera: &CameraConfig,
    start: &GroundMap,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
) -> Result<LinesCalibration, CalibrationError> {
    // The second round detects lines with the corrected map: widths are correct and reject no valid point.
    fit_rounds(camera, start, field, images, vision_config, &[true, false])
}

/// As [`fit_guess`], from a map that is already good to a few percent.
pub(super) fn refine_map(
    camera: &CameraConfig,
    start: &GroundMap,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
) -> Result<LinesCalibration, CalibrationError> {
    fit_rounds(camera, start, field, images, vision_config, &[false, false])
}

/// One joint fit per round; true: the map is a guess.
fn fit_rounds(
    camera: &CameraConfig,
    start: &GroundMap,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
    rounds: &[bool],
) -> Result<LinesCalibration, CalibrationError> {
    let height = f64::from(vision_config.objects.viewpoint_height);
    let markings = Markings::new(field);
    let mut map = start.clone();
    let mut result = None;
    for &is_guess in rounds {
        let image_points =
            detect_line_points(camera, &map, field, images, vision_config, is_guess)?;
        let (correction, fit_images) =
            search_initial_poses(field, &markings.distances, &image_points, height, is_guess);
        let mut fit = JointFit::new(&markings, correction, fit_images);
        fit.optimize(&CORRECTION_SCHEDULE);
        map = fit.model.correct_map(&map);
        result = Some(summarize_fit(map.clone(), images, &image_points, &fit)?);
    }
    result.ok_or_else(|| CalibrationError::NoConvergence("no round was run".into()))
}

/// Where the joint fit of images starts under a map that is good to a few percent: its correction, and their points with poses.
pub(super) fn start_refinement(
    camera: &CameraConfig,
    map: &GroundMap,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
) -> Result<(MapCorrection, Vec<FitImage<CorrectionPoint>>), CalibrationError> {
    let height = f64::from(vision_config.objects.viewpoint_height);
    let points = detect_line_points(camera, map, field, images, vision_config, false)?;
    let markings = Markings::new(field);
    Ok(search_initial_poses(
        field,
        &markings.distances,
        &points,
        height,
        false,
    ))
}

/// A line point of one image, metres.
#[derive(Debug, Clone, Copy)]
struct CalibrationPoint {
    /// Its ground point in the start map, robot frame.
    start: [f64; 2],
    std_radial: f64,
    std_tangential: f64,
}

/// Line points of one image in the initial map.
struct ImageLinePoints {
    index: usize,
    points: Vec<CalibrationPoint>,
    /// Reason for having none.
    refused: Option<String>,
}

fn detect_line_points(
    camera: &CameraConfig,
    map: &GroundMap,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
    is_guess: bool,
) -> Result<Vec<ImageLinePoints>, CalibrationError> {
    let mut config = vision_config.clone();
    if is_guess {
        // With a map that is a third off, lines appear a third too narrow or too wide.
        config.lines.width_ratio_min *= GUESS_WIDTH_SLACK;
        config.lines.width_ratio_max *= 1.4;
    }
    let named = |name: &str| {
        let name = name.to_owned();
        move |source| CalibrationError::Image { name, source }
    };
    let vision = Vision::new(map, camera, field.config.line_width, config)
        .map_err(named("the initial map"))?;
    let repeated = repeated_images(images.iter().map(|image| &image.image));
    let step = images.len().div_ceil(LINES_IMAGES_MAX).max(1);
    let sampled: Vec<usize> = (0..images.len()).step_by(step).collect();
    sampled
        .into_par_iter()
        .map_init(
            || vision.clone(),
            |vision, index| {
                let image = &images[index];
                if let Some(first) = repeated[index] {
                    return Ok(ImageLinePoints {
                        index,
                        points: Vec::new(),
                        refused: Some(format!("the same picture as {}", images[first].name)),
                    });
                }
                vision.reset_colour_model();
                let (points, refused) = match vision.process_lines(&image.image.view()) {
                    Ok(found) => (
                        found.line_points.iter().map(calibration_point).collect(),
                        None,
                    ),
                    Err(error @ VisionError::ImageSize { .. }) => {
                        return Err(named(&image.name)(error));
                    }
                    Err(error) => (Vec::new(), Some(error.to_string())),
                };
                Ok(ImageLinePoints {
                    index,
                    points,
                    refused,
                })
            },
        )
        .collect()
}

/// The range that most line points do not exceed, metres.
fn reach_of(mut ranges: Vec<f64>) -> f64 {
    ranges.sort_by(f64::total_cmp);
    let rank = (REACH_SHARE * ranges.len() as f64) as usize;
    ranges.get(rank).copied().unwrap_or(0.0)
}

fn calibration_point(detection: &LinePointDetection) -> CalibrationPoint {
    let point = &detection.point;
    CalibrationPoint {
        start: [f64::from(point.at.x), f64::from(point.at.y)],
        std_radial: f64::from(point.std_radial),
        std_tangential: f64::from(point.std_tangential),
    }
}

/// The scale with the best total score, and each image's pose under it.
fn search_initial_poses(
    field: &Field,
    distances: &DistanceField,
    image_points: &[ImageLinePoints],
    height: f64,
    is_guess: bool,
) -> (MapCorrection, Vec<FitImage<CorrectionPoint>>) {
    let mut search = BranchAndBound::new(field, distances, BranchAndBoundConfig::default());
    // A guess is off by more than a tilt could compensate: assume upright images.
    let mut matcher = Matcher::new(MatchConfig {
        tilt_std_deg: 0.0,
        map_std: if is_guess { 0.08 } else { 0.02 },
        ..MatchConfig::default()
    });
    let mut best: Option<(f64, MapCorrection, Vec<Option<Pose>>)> = None;
    let grid = SCALES
        .iter()
        .flat_map(|&scale| POWERS.iter().map(move |&power| (scale, power)));
    for (scale, power) in grid.filter(|&(scale, power)| is_guess || scale == 1.0 && power == 0.0) {
        let correction = MapCorrection::scaled(height, scale, power);
        let (mut sum, mut poses) = (0.0, Vec::new());
        for image in image_points {
            let points: Vec<LinePoint> = image
                .points
                .iter()
                .map(|point| {
                    let [x, y] = correction.correct_point(&BasisValues::new(point.start), [0.0; 2]);
                    LinePoint {
                        at: At::new(x as f32, y as f32),
                        std_radial: (scale * point.std_radial) as f32,
                        std_tangential: (scale * point.std_tangential) as f32,
                    }
                })
                .filter(|point| point.at.x.is_finite() && point.at.y.is_finite())
                .collect();
            let found = search.find_hypotheses(distances, &mut matcher, &points, None);
            let top = found.iter().max_by(|a, b| a.score.total_cmp(&b.score));
            sum += top.map_or(0.0, |top| f64::from(top.score) * points.len() as f64);
            poses.push(top.map(|top| top.pose));
        }
        if best.as_ref().is_none_or(|(most, ..)| sum > *most) {
            best = Some((sum, correction, poses));
        }
    }
    let Some((_, correction, poses)) = best else {
        return (MapCorrection::identity(height), Vec::new());
    };
    let images = image_points
        .iter()
        .zip(poses)
        .filter(|(image, _)| image.points.len() >= POINTS_MIN)
        .filter_map(|(image, pose)| {
            let points = image.points.iter().map(|point| {
                CorrectionPoint::new(point.start, point.std_radial, point.std_tangential)
            });
            Some(FitImage::new(image.index, points.collect(), pose?))
        })
        .collect();
    (correction, images)
}

fn summarize_fit(
    map: GroundMap,
    images: &[NamedImage],
    image_points: &[ImageLinePoints],
    fit: &JointFit<'_, MapCorrection>,
) -> Result<LinesCalibration, CalibrationError> {
    let mut residuals: Vec<ImageResidual> = images
        .iter()
        .map(|image| ImageResidual {
            name: image.name.clone(),
            points: 0,
            rms_px: f64::NAN,
            left_out: Some(format!("not needed: {LINES_IMAGES_MAX} images suffice")),
        })
        .collect();
    for image in image_points {
        let residual = &mut residuals[image.index];
        residual.points = image.points.len();
        residual.left_out = Some(match &image.refused {
            Some(reason) => reason.clone(),
            None => format!(
                "too few line points: {} (expected at least {POINTS_MIN})",
                image.points.len()
            ),
        });
    }
    let mut poses = vec![None; images.len()];
    let mut costs = vec![f64::NAN; images.len()];
    let (mut squares, mut inliers, mut points, mut used) = (0.0, 0.0, 0.0, 0);
    let mut on_field = 0.0;
    let mut ranges = Vec::new();
    for image in &fit.images {
        let evaluation = fit.evaluate(image);
        let residual = &mut residuals[image.index];
        residual.points = image.points.len();
        residual.rms_px = evaluation.rms_px;
        costs[image.index] = evaluation.cost;
        let share = evaluation.inlier_count / image.points.len() as f64;
        residual.left_out = (!image.used || share < INLIER_SHARE_MIN)
            .then(|| format!("only {:.0} % of its points lie on markings", 100.0 * share));
        if residual.left_out.is_none() {
            used += 1;
            poses[image.index] = Some(image.pose());
            squares += evaluation.sum_squared;
            inliers += evaluation.inlier_count;
            on_field += evaluation.on_field_count;
            points += image.points.len() as f64;
            let shown = image_points
                .iter()
                .filter(|shown| shown.index == image.index);
            let shown = shown.flat_map(|shown| &shown.points);
            ranges.extend(shown.map(|point| math::hypot(point.start[0], point.start[1])));
        }
    }
    if used < IMAGES_MIN {
        let reasons: Vec<String> = residuals
            .iter()
            .filter_map(|image| Some(format!("{}: {}", image.name, image.left_out.as_ref()?)))
            .take(3)
            .collect();
        return Err(CalibrationError::TooFewImages {
            used,
            total: images.len(),
            required: IMAGES_MIN,
            reasons: listed_reasons(&reasons),
        });
    }
    Ok(LinesCalibration {
        map,
        images: residuals,
        poses,
        rms: (squares / f64::max(inliers, 1.0)).sqrt(),
        inlier_share: inliers / f64::max(points, 1.0),
        on_field_share: (inliers / f64::max(on_field, 1.0)).min(1.0),
        reach: reach_of(ranges),
        disagreement: None,
        better_size: None,
        costs,
    })
}
