//! How wrong is the ground map? Estimates its errors while the robot drives, and corrects points for them
//! (docs/methods.md 2.13).
//!
//! Each tracked image compares its line points with the markings. What pose and tilt cannot explain moves the unknowns of
//! the map: mount of mirror and camera, or smooth terms (`basis`). The unknowns' remaining uncertainty enters the points'
//! standard deviations and, through the image's geometry, the covariance of the pose.

mod basis;
mod block;
mod certainty;
mod config;
mod drive_fit;
mod far_mount;
mod image_cost;
mod image_fit;
mod knock;
mod learning;
mod map_fit;
mod mirror;
mod mount_search;
mod mount_trial;
mod origin_by_wheels;
mod points;
mod posterior;
mod refit;
mod sensitivity;
mod smooth;
mod state;
mod sums;
mod term;
mod turning_point;

pub use basis::{DisplacedPoint, MapBasis, PreparedBasis};
pub use config::MapCorrectionConfig;
pub use drive_fit::DriveFit;
pub use map_fit::MapFit;
pub use mirror::MirrorModel;
pub use smooth::{height_term, smooth_terms};
pub use state::{MapCorrection, MapCorrectionEstimate, TermEstimate, TrackedImage};
pub use term::{BasisTerm, Harmonic, NODES, TERMS_MAX, TermKind, Unit};
