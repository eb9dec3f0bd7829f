//! What can be wrong with what the eyes are given? Files, sizes and configuration, each named.

use std::path::PathBuf;

use localize::config::SettingError;

/// Why vision cannot work with what it was given.
#[derive(Debug, thiserror::Error)]
pub enum VisionError {
    /// An image file cannot be read or is no image.
    #[error("cannot read image {}: {reason}", path.display())]
    ReadImage {
        /// The file.
        path: PathBuf,
        /// The decoder's word.
        reason: String,
    },
    /// A frame has another size than the map was made for.
    #[error(
        "image is {actual_width_px} × {actual_height_px} pixels, the map and the camera are {expected_width_px} × {expected_height_px}"
    )]
    ImageSize {
        /// Columns of the frame.
        actual_width_px: usize,
        /// Rows of the frame.
        actual_height_px: usize,
        /// Columns of the map.
        expected_width_px: usize,
        /// Rows of the map.
        expected_height_px: usize,
    },
    /// A frame holds fewer bytes than its size and format need.
    #[error("truncated image: {actual_bytes} bytes (expected {expected_bytes})")]
    Truncated {
        /// Bytes found.
        actual_bytes: usize,
        /// Bytes of a whole frame.
        expected_bytes: usize,
    },
    /// A frame without light: nothing can be told from it.
    #[error("black frame: the brightest of its carpet is {brightest} of 255")]
    TooDark {
        /// The level that 95 % of the scanned pixels stay below, of 255.
        brightest: u8,
    },
    /// A setting whose value cannot work.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A file of labels, colours or a mask is not what it should be.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        reason: String,
    },
}
