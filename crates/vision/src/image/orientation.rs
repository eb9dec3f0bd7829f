//! How is an image file turned before it is shown? The tag of its metadata (EXIF) in, one orientation of a set out.
//!
//! Image viewers and OpenCV turn an image by its tag, so its pixels mean the turned image. A robot's camera has one
//! orientation. Where files of one camera have several, either tags or pixels are wrong, and a wrong one turns the robot.

use std::fmt::{self, Display};

use image::metadata::Orientation as Transform;

/// The transformation from the stored pixels to those shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orientation(Transform);

impl Orientation {
    pub(super) fn new(transform: Transform) -> Self {
        Orientation(transform)
    }
}

impl Display for Orientation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Transform::NoTransforms => "no turn",
            Transform::Rotate90 => "a turn by 90° clockwise",
            Transform::Rotate180 => "a turn by 180°",
            Transform::Rotate270 => "a turn by 90° counter-clockwise",
            Transform::FlipHorizontal => "a flip left to right",
            Transform::FlipVertical => "a flip upside down",
            Transform::Rotate90FlipH => "a turn by 90° clockwise and a flip left to right",
            Transform::Rotate270FlipH => "a turn by 90° counter-clockwise and a flip left to right",
        })
    }
}

/// Refuses files of one camera whose tags differ.
#[derive(Debug, Clone, Default)]
pub struct CommonOrientation {
    first: Option<(String, Orientation)>,
}

impl CommonOrientation {
    /// Compares a file with the first one. Errors with both.
    pub fn check(&mut self, name: &str, orientation: Orientation) -> Result<(), String> {
        let (first, expected) = self
            .first
            .get_or_insert_with(|| (name.to_owned(), orientation));
        if *expected == orientation {
            return Ok(());
        }
        Err(format!(
            "{name}: its EXIF orientation demands {orientation}, that of {first} {expected} (expected the same for all images \
             of a camera). Turn the pixels alike and remove the tags"
        ))
    }
}
