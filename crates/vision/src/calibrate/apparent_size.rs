//! Apparent size of lines and ball in the image over distance, measured and as predicted by the map.
//!
//! minho2016 III.A: the relation between distance and size in pixels separates lines from clutter. Here it follows from
//! the map; measuring it checks map, focus and ball, and shows where blur widens objects.

use std::f32::consts::{PI, TAU};

use crate::calibrate::{CalibrationError, ImageResidual, NamedImage};
use crate::config::VisionConfig;
use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::azimuth;
use crate::process::{Detections, Vision};
use localize::math;
use localize::robot::CameraConfig;

/// Sizes at one distance; predictions by the map are without blur.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeBin {
    /// Centre of the bin, metres.
    pub distance: f32,
    /// Number of line crossings measured.
    pub lines: usize,
    /// Median width of a line along the radius, pixels. None without lines at this distance.
    pub line_px: Option<f32>,
    /// As predicted by the map, pixels.
    pub line_px_by_map: Option<f32>,
    /// Number of balls measured.
    pub balls: usize,
    /// Median diameter of a disc with as many pixels as the ball.
    pub ball_px: Option<f32>,
    /// As predicted by the map, pixels.
    pub ball_px_by_map: Option<f32>,
}

/// Sizes over distance.
#[derive(Debug, Clone, PartialEq)]
pub struct SizeCalibration {
    /// By ascending distance.
    pub rows: Vec<SizeBin>,
    /// Residual of each image; `rms_px` is 0.
    pub images: Vec<ImageResidual>,
    /// Root mean square difference of measured and predicted line width, pixels.
    pub line_rms_px: Option<f32>,
    /// Root mean square difference of measured and predicted ball diameter, pixels.
    pub ball_rms_px: Option<f32>,
}

/// Width of a bin, metres.
const BIN_WIDTH: f32 = 0.5;
/// Radial scan lines: neighbours are 14 cm apart at 4 m.
const RADIAL_LINES: usize = 180;
/// Fewest measurements for a median.
const MEASUREMENTS_MIN: usize = 3;
/// Crossings with a smaller sine of the angle are excluded.
const CROSSING_SINE_MIN: f32 = 0.5;

/// Measured and predicted size of one object.
struct SizeMeasurement {
    distance: f32,
    measured_px: f32,
    predicted_px: f32,
}

/// Measures lines and balls in independent images.
pub fn calibrate_sizes(
    camera: &CameraConfig,
    map: &GroundMap,
    line_width: f32,
    images: &[NamedImage],
    config: &VisionConfig,
) -> Result<SizeCalibration, CalibrationError> {
    let mut config = config.clone();
    config.scan.radial_lines = RADIAL_LINES;
    config.scan.spirals_each_way = 0;
    config.scan.circles = 0;
    let failed = |name: &str, source| CalibrationError::Image {
        name: name.to_owned(),
        source,
    };
    let mut vision = Vision::new(map, camera, line_width, config.clone())
        .map_err(|source| failed("settings", source))?;
    let (mut lines, mut balls, mut residuals) = (Vec::new(), Vec::new(), Vec::new());
    for image in images {
        vision.reset_colour_model();
        let (points, left_out) = match vision.process(&image.image.view()) {
            Ok(detections) => {
                lines.extend(measure_line_widths(
                    &detections,
                    camera,
                    line_width,
                    &config,
                ));
                balls.extend(measure_ball(&detections, map, &config));
                (detections.line_points.len(), None)
            }
            Err(error) => (0, Some(error.to_string())),
        };
        residuals.push(ImageResidual {
            name: image.name.clone(),
            points,
            rms_px: 0.0,
            left_out,
        });
    }
    if lines.len() < MEASUREMENTS_MIN && balls.len() < MEASUREMENTS_MIN {
        return Err(CalibrationError::NoConvergence(
            "too few lines and balls were detected".to_owned(),
        ));
    }
    let farthest = lines
        .iter()
        .chain(&balls)
        .map(|measurement| measurement.distance);
    let rows = (farthest.fold(0.0, f32::max) / BIN_WIDTH) as usize + 1;
    let rows: Vec<SizeBin> = (0..rows)
        .map(|row| {
            let range = BIN_WIDTH * row as f32..BIN_WIDTH * (row + 1) as f32;
            let ([line_px, line_px_by_map], line_count) = bin_medians(&lines, &range);
            let ([ball_px, ball_px_by_map], ball_count) = bin_medians(&balls, &range);
            SizeBin {
                distance: BIN_WIDTH * (row as f32 + 0.5),
                lines: line_count,
                line_px,
                line_px_by_map,
                balls: ball_count,
                ball_px,
                ball_px_by_map,
            }
        })
        .filter(|row| row.line_px.is_some() || row.ball_px.is_some())
        .collect();
    let rms = |pairs: Vec<(f32, f32)>| {
        let squares: f32 = pairs.iter().map(|(a, b)| (a - b) * (a - b)).sum();
        (!pairs.is_empty()).then(|| (squares / pairs.len() as f32).sqrt())
    };
    Ok(SizeCalibration {
        line_rms_px: rms(rows
            .iter()
            .filter_map(|row| Some((row.line_px?, row.line_px_by_map?)))
            .collect()),
        ball_rms_px: rms(rows
            .iter()
            .filter_map(|row| Some((row.ball_px?, row.ball_px_by_map?)))
            .collect()),
        rows,
        images: residuals,
    })
}

/// Line widths perpendicular to the line; its direction follows from adjacent crossings.
fn measure_line_widths(
    detections: &Detections,
    camera: &CameraConfig,
    line_width: f32,
    config: &VisionConfig,
) -> Vec<SizeMeasurement> {
    let mut points: Vec<_> = detections
        .line_points
        .iter()
        .map(|point| (azimuth(camera.centre_px, point.position_px), point))
        .collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let step = TAU / RADIAL_LINES as f32;
    let mut measured = Vec::new();
    for (index, (angle, point)) in points.iter().enumerate() {
        let at = point.point.at;
        let distance = at.distance();
        // The nearest point on the next ray, likely on the same line.
        let next = points[index + 1..]
            .iter()
            .take_while(|(other, _)| other - angle < 1.5 * step)
            .filter(|(other, _)| other - angle > 0.5 * step)
            .min_by(|a, b| {
                let off = |point: f32| (point - distance).abs();
                off(a.1.point.at.distance()).total_cmp(&off(b.1.point.at.distance()))
            });
        let Some((_, next)) = next else { continue };
        let (dx, dy) = (next.point.at.x - at.x, next.point.at.y - at.y);
        let length = math::hypot(dx, dy);
        if length > 3.0 * step * distance / CROSSING_SINE_MIN || length <= 0.0 {
            continue;
        }
        let square = ((at.x * dy - at.y * dx) / (distance * length)).abs();
        let radial_px = point.point.std_radial / config.lines.position_std_px;
        if square < CROSSING_SINE_MIN || radial_px <= 0.0 {
            continue;
        }
        measured.push(SizeMeasurement {
            distance,
            measured_px: point.width * square / radial_px,
            predicted_px: line_width / radial_px,
        });
    }
    measured
}

/// The ball's size, if it is on the ground and mostly visible.
fn measure_ball(
    detections: &Detections,
    map: &GroundMap,
    config: &VisionConfig,
) -> Option<SizeMeasurement> {
    let ball = detections
        .ball
        .filter(|ball| ball.on_ground && ball.score > 0.5)?;
    let expected = crate::objects::ball::expected_ball_pixels(
        map,
        &config.objects,
        ball.at.distance(),
        ball.position_px,
    )?;
    let diameter = |pixels: f32| 2.0 * (pixels / PI).sqrt();
    Some(SizeMeasurement {
        distance: ball.at.distance(),
        measured_px: diameter(ball.pixels as f32),
        predicted_px: diameter(expected),
    })
}

fn bin_medians(all: &[SizeMeasurement], range: &std::ops::Range<f32>) -> ([Option<f32>; 2], usize) {
    let members: Vec<&SizeMeasurement> = all
        .iter()
        .filter(|measurement| range.contains(&measurement.distance))
        .collect();
    let median = |mut values: Vec<f32>| {
        values.sort_by(f32::total_cmp);
        (values.len() >= MEASUREMENTS_MIN).then(|| values[values.len() / 2])
    };
    let measured = median(
        members
            .iter()
            .map(|measurement| measurement.measured_px)
            .collect(),
    );
    let by_map = median(
        members
            .iter()
            .map(|measurement| measurement.predicted_px)
            .collect(),
    );
    ([measured, by_map], members.len())
}
