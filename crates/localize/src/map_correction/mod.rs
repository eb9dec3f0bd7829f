//! How wrong is the ground map? Estimates its errors while the robot drives, and corrects points for them
//! (docs/methods.md 2.13).
//!
//! Each tracked image compares its line points with the markings. What pose and tilt cannot explain moves the unknowns of
//! the map: mount of mirror and camera, or smooth terms (`basis`). The unknowns' remaining uncertainty enters the points'
//! standard deviations and, through the image's geometry, the covariance of the pose.

mod basis;
mod belief;
mod config;
mod mirror;
mod refit;
mod smooth;
mod sums;

pub use basis::{BasisTerm, DisplacedPoint, Harmonic, MapBasis, NODES, TERMS_MAX, TermKind, Unit};
pub use belief::{MapCorrection, MapCorrectionEstimate, TermEstimate, TrackedImage};
pub use config::MapCorrectionConfig;
pub use mirror::MirrorModel;
pub use smooth::{height_term, smooth_terms};
