//! What is the virtual hardware made from?

use std::path::Path;

use hw::config::Bus;

/// Options of the virtual hardware.
pub(crate) struct Options<'a> {
    /// Folder of the devices.
    pub folder: &'a Path,
    /// Fault plan (TOML).
    pub faults: Option<&'a Path>,
    /// The scenario's path moves the robot instead of the wheel commands.
    pub own_path: bool,
    /// Bus of the base.
    pub bus: Bus,
    /// The camera's format: RGB3 or YUYV.
    pub format: &'a str,
    /// File for the true poses, with stamps of the devices' clock.
    pub truth: Option<&'a Path>,
}
