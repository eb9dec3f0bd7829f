//! Which robot is this? A folder with robot.toml (eyes, wheels, field) and hardware.toml (devices).

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use hw::HardwareConfig;

use pipeline::setup::Setup;

/// A robot and its devices, read and checked.
pub struct RobotFolder {
    /// Its folder.
    pub folder: PathBuf,
    /// Field, map and eyes.
    pub setup: Setup,
    /// Devices.
    pub hardware: HardwareConfig,
}

impl RobotFolder {
    /// Reads robot.toml and hardware.toml of a folder; robot.toml's own path does as well.
    pub fn load(path: &Path) -> Result<Self> {
        let (folder, robot_file) = resolve_robot_path(path)?;
        let setup = Setup::load(&robot_file, None)?;
        let hardware = HardwareConfig::load(&folder.join("hardware.toml"))?;
        if hardware.camera.is_some() && setup.robot.camera.is_none() {
            bail!(
                "{}: hardware.toml has a camera, so robot.toml needs [camera]",
                folder.display()
            );
        }
        Ok(RobotFolder {
            folder,
            setup,
            hardware,
        })
    }
}

/// The folder and the robot file that a path names.
pub fn resolve_robot_path(path: &Path) -> Result<(PathBuf, PathBuf)> {
    if path.is_dir() {
        return Ok((path.to_owned(), path.join("robot.toml")));
    }
    if !path.exists() {
        bail!(
            "{} is not there: a robot is a folder with robot.toml and hardware.toml, as config/robots/virtual",
            path.display()
        );
    }
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    Ok((folder, path.to_owned()))
}
