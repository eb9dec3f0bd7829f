//! Scan lines over the ground map, their brightness, and peaks along them.

pub(crate) mod brightness;
pub(crate) mod flanks;
pub(crate) mod limits;
pub mod pattern;
pub(crate) mod peaks;
pub(crate) mod rgb_weights;
