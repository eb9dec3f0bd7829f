//! Errors of vision: files, image sizes and configuration values, each named.

use std::path::PathBuf;

use localize::config::SettingError;

/// Why vision cannot use a file, an image or a setting.
#[derive(Debug, thiserror::Error)]
pub enum VisionError {
    /// An image file cannot be read or is not an image.
    #[error("cannot read image {}: {reason}", path.display())]
    ReadImage {
        /// The file.
        path: PathBuf,
        /// The decoder's message.
        reason: String,
    },
    /// An image differs in size from the map.
    #[error(
        "wrong image size: {actual_width_px} × {actual_height_px} pixels (expected {expected_width_px} × {expected_height_px}, as the map and the camera){}",
        turned_hint([*actual_width_px, *actual_height_px], [*expected_width_px, *expected_height_px])
    )]
    ImageSize {
        /// Columns of the image.
        actual_width_px: usize,
        /// Rows of the image.
        actual_height_px: usize,
        /// Columns of the map.
        expected_width_px: usize,
        /// Rows of the map.
        expected_height_px: usize,
    },
    /// The rim of robot.toml leaves no ground to scan.
    #[error(
        "camera.outer_radius_px = {outer_radius_px}: no ground within the mirror's rim is farther than vision.scan.range_min = {range_min} m \
         (farthest: {farthest:.3} m)"
    )]
    RimTooSmall {
        /// The setting, pixels.
        outer_radius_px: f32,
        /// Farthest ground within the rim, metres.
        farthest: f32,
        /// Where scan lines begin, metres.
        range_min: f32,
    },
    /// The mask leaves no ground.
    #[error(
        "the mask hides all ground: it is false on the robot's own body and rods, true elsewhere"
    )]
    MaskHidesGround,
    /// The map shows ground, but no scan line can follow it outward.
    #[error(
        "no scan line fits the ground map: its ground does not lie farther outward with the pixels, from {nearest:.3} m on. A wavy mirror \
         profile, or a wrong centre_px"
    )]
    NoScanLines {
        /// Nearest ground that the map shows, metres.
        nearest: f32,
    },
    /// An image holds fewer bytes than its size and format need.
    #[error("truncated image: {actual_bytes} bytes (expected {expected_bytes})")]
    Truncated {
        /// Bytes found.
        actual_bytes: usize,
        /// Bytes of a complete image.
        expected_bytes: usize,
    },
    /// The image is too dark to learn colours from.
    #[error("black image: brightness {brightest} of 255 at the 95th percentile near the robot")]
    TooDark {
        /// 95th percentile of the scanned pixels near the robot, of 255.
        brightest: u8,
    },
    /// Classes were requested although no colours are learned: no image was processed yet, or the last one failed.
    #[error("no colour model: process an image first")]
    NoColourModel,
    /// A setting out of its bounds.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A file of labels, colours or a mask has invalid content.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        reason: String,
    },
}

/// What an image whose sides are exchanged suggests.
fn turned_hint(actual: [usize; 2], [width, height]: [usize; 2]) -> &'static str {
    if actual == [height, width] && width != height {
        ". The image is turned by a quarter, perhaps by its EXIF orientation"
    } else {
        ""
    }
}
