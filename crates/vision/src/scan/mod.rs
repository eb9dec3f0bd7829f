//! Which pixels are read? Scan lines over the ground map, their brightness, peaks along them.

pub(crate) mod brightness;
pub(crate) mod limits;
pub mod pattern;
pub(crate) mod peaks;
