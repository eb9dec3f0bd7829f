//! Where does the robot see itself? Body and rods: what stays the same while the floor turns by.

use std::path::Path;

use crate::calibrate::CalibrationError;
use crate::error::VisionError;
use crate::image::Image;
use localize::robot::CameraConfig;

/// Fewer images of a turning robot leave floor that happens to stay the same.
const IMAGES_MIN: usize = 6;

/// The robot's own parts change less than this while it turns, levels (standard deviation): noise and stray light.
const STATIC_STD_MAX: f64 = 9.0;

/// Floor is brighter than the darkest own parts by this factor, at least; a dark pixel's steadiness proves little else.
const DARK_RATIO_MAX: f64 = 0.6;

/// One entry a pixel, row by row: false where the robot's own body and rods are, true elsewhere.
///
/// `images`: of a robot turning in place, at least six spread around the circle. A pixel is the robot's own if it
/// stays the same in all of them and is darker than the floor mostly is. Specks are smoothed away.
pub fn calibrate_mask(
    camera: &CameraConfig,
    images: &[Image],
) -> Result<Vec<bool>, CalibrationError> {
    if images.len() < IMAGES_MIN {
        return Err(CalibrationError::TooFewImages {
            used: images.len(),
            total: images.len(),
            required: IMAGES_MIN,
            reasons: "a mask needs images all around".into(),
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

/// Writes a mask as a picture: black where the robot sees itself, white elsewhere.
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

/// Reads a mask that has the camera's size.
pub fn load_mask(path: &Path, width_px: usize, height_px: usize) -> Result<Vec<bool>, VisionError> {
    let image = Image::load(path)?;
    if (image.width_px, image.height_px) != (width_px, height_px) {
        return Err(VisionError::File {
            path: path.to_owned(),
            reason: format!(
                "is {} × {} pixels, but the camera has {width_px} × {height_px}",
                image.width_px, image.height_px
            ),
        });
    }
    Ok(image.rgb.chunks_exact(3).map(|rgb| rgb[0] >= 128).collect())
}

/// Are at least three of the nine pixels around one the robot's own? Widens by a pixel's blur, drops specks.
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
