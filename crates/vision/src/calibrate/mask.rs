//! Calibration of the mask: body and rods, which stay constant in images of a turning robot.

use std::path::Path;

use crate::calibrate::CalibrationError;
use crate::error::VisionError;
use crate::image::Image;
use localize::robot::CameraConfig;

/// Fewest images of a turning robot; with fewer, floor may be constant by chance.
const IMAGES_MIN: usize = 6;

/// Largest standard deviation of the robot's own parts while it turns, levels: noise and stray light.
const STATIC_STD_MAX: f64 = 9.0;

/// Own parts are darker than this fraction of the median brightness; constant bright pixels may be floor.
const DARK_RATIO_MAX: f64 = 0.75;

/// One entry per pixel, row by row: false on the robot's own body and rods, true elsewhere.
///
/// `images`: of a robot turning in place, at least six spread over the circle. A pixel belongs to the robot if it is
/// constant in all of them and dark. Isolated pixels are removed.
pub fn calibrate_mask(
    camera: &CameraConfig,
    images: &[Image],
) -> Result<Vec<bool>, CalibrationError> {
    if images.len() < IMAGES_MIN {
        return Err(CalibrationError::TooFewImages {
            used: images.len(),
            total: images.len(),
            required: IMAGES_MIN,
            reasons: "take images in directions spread over the circle".into(),
        });
    }
    for (number, image) in images.iter().enumerate() {
        image
            .view()
            .check(camera.width_px, camera.height_px)
            .map_err(|source| CalibrationError::Image {
                name: format!("image {number}"),
                source,
            })?;
    }
    let count = images.len() as f64;
    let statistics: Vec<[f64; 2]> = (0..camera.width_px * camera.height_px)
        .map(|pixel| {
            let (mut sum, mut squares) = (0.0, 0.0);
            for image in images {
                let rgb = &image.rgb[3 * pixel..3 * pixel + 3];
                let grey = rgb.iter().map(|&channel| f64::from(channel)).sum::<f64>() / 3.0;
                sum += grey;
                squares += grey * grey;
            }
            let mean = sum / count;
            [mean, (squares / count - mean * mean).max(0.0).sqrt()]
        })
        .collect();
    let inside = |pixel: usize| {
        let (u, v) = (pixel % camera.width_px, pixel / camera.width_px);
        camera.is_inside_mirror(u as f32, v as f32)
    };
    let mut levels: Vec<f64> = (0..statistics.len())
        .filter(|&pixel| inside(pixel))
        .map(|pixel| statistics[pixel][0])
        .collect();
    levels.sort_by(f64::total_cmp);
    let typical = levels.get(levels.len() / 2).copied().unwrap_or(0.0);
    let is_body: Vec<bool> = statistics
        .iter()
        .map(|&[mean, deviation]| deviation < STATIC_STD_MAX && mean < DARK_RATIO_MAX * typical)
        .collect();
    Ok((0..is_body.len())
        .map(|pixel| !has_body_neighbours(&is_body, camera, pixel))
        .collect())
}

/// Writes a mask as an image: black on the robot itself, white elsewhere.
pub fn save_mask(
    mask: &[bool],
    width_px: usize,
    height_px: usize,
    path: &Path,
) -> Result<(), VisionError> {
    let level = |&free: &bool| if free { 255u8 } else { 0 };
    let image = Image {
        width_px,
        height_px,
        rgb: mask.iter().flat_map(|free| [level(free); 3]).collect(),
    };
    image.save(path)
}

/// Reads a mask of the camera's size.
pub fn load_mask(path: &Path, width_px: usize, height_px: usize) -> Result<Vec<bool>, VisionError> {
    let image = Image::load(path)?;
    if (image.width_px, image.height_px) != (width_px, height_px) {
        return Err(VisionError::File {
            path: path.to_owned(),
            reason: format!(
                "wrong mask size: {} × {} pixels (expected {width_px} × {height_px}, as the camera)",
                image.width_px, image.height_px
            ),
        });
    }
    Ok(image.rgb.chunks_exact(3).map(|rgb| rgb[0] >= 128).collect())
}

/// True if at least three of the 3 × 3 pixels are the robot's own: dilates by one pixel, removes isolated pixels.
fn has_body_neighbours(is_body: &[bool], camera: &CameraConfig, pixel: usize) -> bool {
    let (u, v) = (pixel % camera.width_px, pixel / camera.width_px);
    let columns = u.saturating_sub(1)..=(u + 1).min(camera.width_px - 1);
    let rows = v.saturating_sub(1)..=(v + 1).min(camera.height_px - 1);
    let body_pixels = rows
        .flat_map(|v| columns.clone().map(move |u| (u, v)))
        .filter(|&(u, v)| is_body[v * camera.width_px + u])
        .count();
    body_pixels >= 3
}

#[cfg(test)]
mod tests {
    use localize::math;

    use super::*;

    const SIZE_PX: usize = 120;

    /// A robot that turns over a carpet with a white line, its disc in the middle; darker towards the rim.
    fn image(turn: f32, body: f32) -> Image {
        let centre = SIZE_PX as f32 / 2.0;
        let mut rgb = Vec::new();
        for pixel in 0..SIZE_PX * SIZE_PX {
            let (x, y) = (
                (pixel % SIZE_PX) as f32 - centre,
                (pixel / SIZE_PX) as f32 - centre,
            );
            let range = math::hypot(x, y);
            let (sin, cos) = math::sin_cos(turn);
            let across = (cos * x + sin * y - 25.0).abs();
            let light = 1.0 - 0.1 * range / centre;
            let level = match (range < 15.0, across < 4.0) {
                (true, _) => body,
                (false, true) => 220.0 * light,
                (false, false) => 90.0 * light,
            };
            let noise = ((pixel * 7919 + (turn * 1e4) as usize * 31) % 7) as f32 - 3.0;
            rgb.extend([(level + noise) as u8; 3]);
        }
        Image {
            width_px: SIZE_PX,
            height_px: SIZE_PX,
            rgb,
        }
    }

    #[test]
    fn body_that_is_darker_than_the_carpet_is_masked_and_no_carpet() {
        let camera: CameraConfig = toml::from_str(
            "width_px = 120\nheight_px = 120\nforward_deg = 90.0\nflipped = false\ncentre_px = [60.0, 60.0]\nouter_radius_px = 58.0",
        )
        .expect("a camera");
        for body in [15.0, 40.0, 57.0] {
            let images: Vec<Image> = (0..12).map(|k| image(0.52 * k as f32, body)).collect();
            let mask = calibrate_mask(&camera, &images).expect("a mask");
            let (mut own, mut carpet) = (0, 0);
            for (pixel, free) in mask.iter().enumerate() {
                let (x, y) = (pixel % SIZE_PX, pixel / SIZE_PX);
                let range = math::hypot(x as f32 - 60.0, y as f32 - 60.0);
                own += usize::from(range < 14.0 && *free);
                carpet += usize::from((17.0..58.0).contains(&range) && !free);
            }
            assert_eq!((own, carpet), (0, 0), "body of {body}");
        }
    }
}
