//! Where are lines in an image whose ground map is unknown? Images in, line points in pixels out.
//!
//! The detector runs with a generic map: range grows exponentially with image radius, as in most mirrors of the league.
//! Only positions and widths in the image are used. Widths are hardly limited, since the map is a guess.

use localize::math;
use localize::robot::CameraConfig;
use localize::sample::LinePoint;
use rayon::prelude::*;

use crate::calibrate::CalibrationError;
use crate::calibrate::lines::NamedImage;
use crate::calibrate::radial_model::PixelPoint;
use crate::calibrate::repeated_images::repeated_images;
use crate::config::VisionConfig;
use crate::error::VisionError;
use crate::lines::detection::LinePointDetection;
use crate::optics::ground_map::GroundMap;
use crate::process::Vision;

/// Range at the axis and its growth up to the rim: 0.3 to 8 m.
const RANGE_INNER: f32 = 0.3;
const GROWTH: f32 = 3.3;

/// Line points of one image.
#[derive(Debug, Clone)]
pub(super) struct ImagePixels {
    pub(super) points: Vec<PixelPoint>,
    /// Reason for having no points.
    pub(super) refused: Option<String>,
}

/// The line points of an image, and its index in the list of all images.
#[derive(Debug, Clone)]
pub(super) struct SearchImage {
    pub(super) index: usize,
    pub(super) points: Vec<PixelPoint>,
}

/// Detects line points in all images, in parallel.
pub(super) fn detect_line_pixels(
    camera: &CameraConfig,
    line_width: f32,
    images: &[NamedImage],
    vision_config: &VisionConfig,
) -> Result<Vec<ImagePixels>, CalibrationError> {
    let mut config = vision_config.clone();
    config.lines.width_ratio_min = 0.0;
    config.lines.width_ratio_max *= 1.5;
    config.scan.pixel_footprint_max = 100.0;
    let vision = Vision::new(&generic_map(camera), camera, line_width, config.clone()).map_err(
        |source| CalibrationError::Image {
            name: "the generic map".into(),
            source,
        },
    )?;
    let repeated = repeated_images(images.iter().map(|image| &image.image));
    images
        .par_iter()
        .zip(repeated)
        .map_init(
            || vision.clone(),
            |vision, (image, repeated)| {
                if let Some(first) = repeated {
                    return Ok(ImagePixels {
                        points: Vec::new(),
                        refused: Some(format!("the same picture as {}", images[first].name)),
                    });
                }
                vision.reset_colour_model();
                let found = match vision.process_lines(&image.image.view()) {
                    Ok(found) => found,
                    Err(source @ VisionError::ImageSize { .. }) => {
                        let name = image.name.clone();
                        return Err(CalibrationError::Image { name, source });
                    }
                    Err(error) => {
                        return Ok(ImagePixels {
                            points: Vec::new(),
                            refused: Some(error.to_string()),
                        });
                    }
                };
                let points = found.line_points.iter();
                Ok(ImagePixels {
                    points: points
                        .map(|point| pixel_point(point, camera, &config))
                        .collect(),
                    refused: None,
                })
            },
        )
        .collect()
}

fn pixel_point(
    found: &LinePointDetection,
    camera: &CameraConfig,
    config: &VisionConfig,
) -> PixelPoint {
    let [u, v] = found.position_px;
    let LinePoint {
        std_radial,
        std_tangential,
        ..
    } = found.point;
    let widths_px = [std_radial, std_tangential]
        .map(|std| f64::from(found.width * config.lines.position_std_px / std));
    PixelPoint {
        at_px: camera.robot_direction_px(u, v).map(f64::from),
        widths_px,
    }
}

fn generic_map(camera: &CameraConfig) -> GroundMap {
    let (width_px, height_px) = (camera.width_px, camera.height_px);
    let rim = camera
        .outer_radius_px
        .unwrap_or(width_px.max(height_px) as f32 / 2.0);
    let mut map = GroundMap {
        width_px,
        height_px,
        x: Vec::with_capacity(width_px * height_px),
        y: Vec::with_capacity(width_px * height_px),
    };
    for (row, column) in (0..height_px).flat_map(|v| (0..width_px).map(move |u| (v, u))) {
        let (u, v) = (column as f32, row as f32);
        let [x, y] = camera.robot_direction_px(u, v);
        let radius = math::hypot(x, y).max(1e-3);
        let range = if camera.is_inside_mirror(u, v) {
            RANGE_INNER * math::exp(GROWTH * radius / rim)
        } else {
            f32::NAN
        };
        map.x.push(range * x / radius);
        map.y.push(range * y / radius);
    }
    map
}
