//! How much was recorded?

use serde::Serialize;

/// Numbers of samples.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Counts {
    pub(super) frames: u64,
    /// Images that came faster than they could be written.
    pub(super) images_dropped: u64,
    pub(super) odometry: u64,
    pub(super) imu: u64,
    pub(super) compass: u64,
}
