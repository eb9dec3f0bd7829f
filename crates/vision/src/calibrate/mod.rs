//! Calibration of the ground map, the mount, the mask and the colours, each with its residuals.

mod acceptance;
pub mod apparent_size;
pub mod colours;
mod edge_field;
mod field_sizes;
mod free_sizes;
mod halves;
mod joint_fit;
mod known_map;
mod line_pixels;
pub mod lines;
mod map_alignment;
mod map_continuation;
mod map_correction;
pub mod mask;
mod mirror_search;
pub mod mount_fit;
mod own_structure;
mod polar_map;
mod radial_family;
mod radial_model;
mod repeated_images;
pub mod rim;
mod rival_fields;
mod straight_lines;
pub mod strip;
mod strip_edges;
pub mod strip_target;
mod two_groups;
mod two_robots;
mod unknown_field;
pub mod unknown_mirror;

pub use acceptance::doubt;
pub use apparent_size::{SizeBin, SizeCalibration, calibrate_sizes};
pub use colours::{LearnedColours, learn_colours};
pub use known_map::calibrate_lines;
pub use lines::{LINES_IMAGES_MAX, LinesCalibration, NamedImage};
pub use mask::calibrate_mask;
pub use mount_fit::{MountFit, fit_mount};
pub use rim::{Rim, RimError, find_rim};
pub use strip::{StripCalibration, StripImage, calibrate_strip};
pub use strip_target::{BarColour, Strip};
pub use unknown_mirror::{
    UnknownField, UnknownMirror, calibrate_unknown_field, calibrate_unknown_mirror,
};

/// A ground point with its image position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Column and row, pixels.
    pub position_px: [f64; 2],
    /// Robot frame, metres.
    pub ground: [f64; 2],
}

/// How far the maps of two halves of the images are apart, metres: medians over the pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disagreement {
    /// Up to 3 m.
    pub near: f32,
    /// From 3 to 5 m. NaN where no line point reaches.
    pub far: f32,
}

/// Residual of one image of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageResidual {
    /// Its file, as the list of images names it.
    pub name: String,
    /// Number of its points.
    pub points: usize,
    /// Root mean square of its points' residuals, pixels; 0 if the calibration measures none.
    pub rms_px: f64,
    /// Reason for excluding it. None if it was used.
    pub left_out: Option<String>,
}

/// Reasons for excluding images, or what to do if none was excluded.
fn listed_reasons(reasons: &[String]) -> String {
    match reasons {
        [] => "Take more images".to_owned(),
        reasons => reasons.join("; "),
    }
}

impl CalibrationError {
    /// True if wrong sizes in the field file may be the reason.
    pub fn may_be_sizes(&self) -> bool {
        match self {
            CalibrationError::WrongField { is_known, .. } => !is_known,
            // On a wrong field one mirror may explain some of the images and another one the rest.
            CalibrationError::Undecided(_) | CalibrationError::TwoCameras { .. } => true,
            _ => false,
        }
    }
}

/// Why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// An invalid value of the target or the camera.
    #[error("{key} = {value}: {reason}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The requirement it fails.
        reason: String,
    },
    /// Too few images are usable.
    #[error("too few usable images: {used} of {total} (expected at least {required}). {reasons}")]
    TooFewImages {
        /// Usable images.
        used: usize,
        /// Images given.
        total: usize,
        /// Required images.
        required: usize,
        /// First reasons for excluding images.
        reasons: String,
    },
    /// The strip lies elsewhere than its description says.
    #[error(
        "by how wide the bars appear, they lie {:.2} m {} the robot than strip.toml says: are first_edge, spacing and the colour of \
         first_bar right?",
        nearer.abs(),
        if *nearer > 0.0 { "nearer to" } else { "farther from" }
    )]
    StripElsewhere {
        /// By how much they are nearer, metres.
        nearer: f64,
    },
    /// The fit does not converge.
    #[error("the fit does not converge: {0}")]
    NoConvergence(String),
    /// The images do not decide between several maps.
    #[error("the images do not decide the map: {0}")]
    Undecided(String),
    /// The images show another field.
    #[error(
        "the images do not show this field: {share_percent} % of the line points on it lie on markings. {hint}"
    )]
    WrongField {
        /// Share of the line points on the field that lie on markings, percent.
        share_percent: u32,
        /// The field that fits better, or what to check.
        hint: String,
        /// True if `hint` names a field that fits better.
        is_known: bool,
    },
    /// As `refused`, and sizes that the images fit are known.
    #[error(
        "{refused}. The field has other sizes, it seems: with {} {share_percent} % of the points would lie on markings. Measure them, \
         or let --fit-field FILE.toml write the field and calibrate on it",
        sizes.join(", ")
    )]
    OtherSizes {
        /// Why the sizes of the file are refused.
        refused: Box<CalibrationError>,
        /// Edits of the field file.
        sizes: Vec<String>,
        /// Share of the line points on the field that lie on its markings then, percent.
        share_percent: u32,
    },
    /// The images come from two cameras.
    #[error(
        "the images come from two cameras: {sign}. Calibrate each by itself. First: {}. Second: {}",
        first.join(", "),
        second.join(", ")
    )]
    TwoCameras {
        /// By what they are told apart.
        sign: String,
        /// Images of the camera with more images.
        first: Vec<String>,
        /// The others that one map explains.
        second: Vec<String>,
    },
    /// The mirror cannot be traced.
    #[error(transparent)]
    Optics(#[from] crate::optics::ray_tracing::OpticsError),
    /// An image has another size than the camera.
    #[error("{name}: {source}")]
    Image {
        /// Its file.
        name: String,
        /// The error.
        source: crate::error::VisionError,
    },
}
