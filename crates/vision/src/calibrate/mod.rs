//! How does this camera really map the ground? Calibrations of the ground map, each with its residuals.

pub mod apparent_size;
pub mod colours;
mod joint_fit;
pub mod lines;
mod map_correction;
pub mod mask;
pub mod mount_fit;
mod polar_map;
pub mod strip;
mod strip_edges;

pub use apparent_size::{SizeBin, SizeCalibration, calibrate_sizes};
pub use colours::{LearnedColours, learn_colours};
pub use lines::{LinesCalibration, NamedImage, calibrate_lines};
pub use mask::calibrate_mask;
pub use mount_fit::{MountFit, fit_mount};
pub use strip::{Strip, StripCalibration, StripImage, calibrate_strip};

/// A point of the ground whose place in the image is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Column and row, pixels.
    pub position_px: [f64; 2],
    /// Robot frame, metres.
    pub ground: [f64; 2],
}

/// How well one image of a calibration agrees with all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageResidual {
    /// Its file, as the list of images names it.
    pub name: String,
    /// Points that it gave.
    pub points: usize,
    /// Root mean square of its points' distances from the calibration, pixels.
    pub rms_px: f64,
    /// Why it was left out; none if it was used.
    pub left_out: Option<String>,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// A number of the target or the camera that cannot be.
    #[error("{key} = {value}: {reason}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        reason: &'static str,
    },
    /// Too few images agree.
    #[error("only {used} of {total} images can be used, {required} are needed; {reasons}")]
    TooFewImages {
        /// Images that could be used.
        used: usize,
        /// Images given.
        total: usize,
        /// Images needed.
        required: usize,
        /// The first reasons for leaving images out.
        reasons: String,
    },
    /// The fit does not settle.
    #[error("the fit does not settle: {0}")]
    NoConvergence(String),
    /// The mirror cannot be traced.
    #[error(transparent)]
    Optics(#[from] crate::optics::ray_tracing::OpticsError),
    /// An image has another size than the camera.
    #[error("{name}: {source}")]
    Image {
        /// Its file.
        name: String,
        /// What is wrong.
        source: crate::error::VisionError,
    },
}
