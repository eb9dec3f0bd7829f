//! Which robot is this? A folder with robot.toml (camera, wheels, field) and hardware.toml (devices).

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use hw::HardwareConfig;

use pipeline::setup::{SensorSource, Setup};

/// A robot's configuration and its devices, checked.
pub(crate) struct RobotFolder {
    /// Its folder.
    pub folder: PathBuf,
    /// Field, ground map and camera.
    pub setup: Setup,
    /// Devices.
    pub hardware: HardwareConfig,
}

impl RobotFolder {
    /// Reads robot.toml and hardware.toml of a folder, or of the folder of a robot.toml.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let RobotPaths { folder, robot_file } = RobotPaths::resolve(path)?;
        let setup = Setup {
            sensors: SensorSource::Devices,
            ..Setup::load(&robot_file, None)?
        };
        let wheels = setup.robot.base.clone().unwrap_or_default();
        let hardware = HardwareConfig::load_for_wheels(&folder.join("hardware.toml"), &wheels)?;
        if hardware.camera.is_some() && setup.robot.camera.is_none() {
            bail!(
                "{}: hardware.toml has [camera], but robot.toml has none. Add [camera] to robot.toml",
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

/// A robot's folder and its robot file.
pub(crate) struct RobotPaths {
    /// Holds hardware.toml and network.toml.
    pub folder: PathBuf,
    /// robot.toml.
    pub robot_file: PathBuf,
}

impl RobotPaths {
    /// Paths for a robot's folder or its robot file.
    pub(crate) fn resolve(path: &Path) -> Result<Self> {
        if path.is_dir() {
            return Ok(RobotPaths {
                folder: path.to_owned(),
                robot_file: path.join("robot.toml"),
            });
        }
        if !path.exists() {
            bail!(
                "no such robot: {} (expected a folder with robot.toml and hardware.toml, as config/robots/virtual)",
                path.display()
            );
        }
        Ok(RobotPaths {
            folder: path.parent().unwrap_or(Path::new("")).to_owned(),
            robot_file: path.to_owned(),
        })
    }
}
