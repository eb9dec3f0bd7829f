//! Which devices does the robot have? All configured devices together, and a list of those of this machine.

use localize::robot::RobotConfig;

use crate::base::BaseDriver;
use crate::camera::{CameraDriver, describe_video_device};
use crate::config::HardwareConfig;
use crate::error::HwError;
use crate::event_queue::EventQueue;
use crate::health::HealthReport;
use crate::inertial::InertialDriver;

/// All devices of a robot, one thread each. Dropping them stops the wheels first.
#[derive(Debug)]
pub struct Devices {
    /// The base, if configured.
    pub base: Option<BaseDriver>,
    /// The camera, if configured.
    pub camera: Option<CameraDriver>,
    /// Inertial units and compasses on serial ports of their own.
    pub inertial: Vec<InertialDriver>,
}

impl Devices {
    /// Starts the thread of every configured device. Devices are opened later: a missing one is a state in its health.
    ///
    /// `queued_images`: images that consumers may queue at once, as a log does.
    pub fn start(
        hardware: &HardwareConfig,
        robot: &RobotConfig,
        queued_images: usize,
        queue: &EventQueue,
    ) -> Result<Self, HwError> {
        hardware.check()?;
        let wheels = robot.base.clone().unwrap_or_default();
        let base = hardware
            .base
            .as_ref()
            .map(|base| BaseDriver::start(base, &wheels, queue));
        let camera = match (&hardware.camera, &robot.camera) {
            (Some(device), Some(image)) => {
                let size_px = [image.width_px as u32, image.height_px as u32];
                Some(CameraDriver::start(device, size_px, queued_images, queue)?)
            }
            (Some(_), None) => {
                let reason = "the image size is unknown. Add [camera] to robot.toml".to_owned();
                let key = "camera";
                return Err(HwError::Config { key, reason });
            }
            (None, _) => None,
        };
        let inertial = hardware.inertial.iter().enumerate().map(|(index, device)| {
            // Most robots have one: it has no number.
            let name = match index {
                0 => "imu".to_owned(),
                _ => format!("imu {}", index + 1),
            };
            InertialDriver::start(&name, device, queue)
        });
        Ok(Devices {
            base: base.transpose()?,
            camera,
            inertial: inertial.collect::<Result<_, _>>()?,
        })
    }

    /// Health of each device.
    pub fn health(&self) -> Vec<HealthReport> {
        let base = self.base.iter().map(BaseDriver::health);
        let camera = self.camera.iter().map(CameraDriver::health);
        base.chain(camera)
            .chain(self.inertial.iter().map(InertialDriver::health))
            .collect()
    }
}

/// A device of this machine that could be configured.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectedDevice {
    /// The value for hardware.toml.
    pub name: String,
    /// What it is, or why it cannot be used.
    pub description: Result<String, HwError>,
}

/// Cameras, serial ports and CAN interfaces of this machine, in the order of their names.
pub fn list_devices() -> Vec<DetectedDevice> {
    let mut found = list_video_devices();
    for path in list_directory("/dev/serial/by-id") {
        let target = std::fs::canonicalize(&path)
            .map_or_else(|error| error.to_string(), |path| path.display().to_string());
        found.push(DetectedDevice {
            name: path,
            description: Ok(format!("serial port {target}")),
        });
    }
    for path in list_directory("/sys/class/net") {
        // ARPHRD_CAN of linux/if_arp.h
        let is_can =
            std::fs::read_to_string(format!("{path}/type")).is_ok_and(|kind| kind.trim() == "280");
        if is_can {
            let state = std::fs::read_to_string(format!("{path}/operstate")).unwrap_or_default();
            found.push(DetectedDevice {
                name: path.rsplit('/').next().unwrap_or_default().to_owned(),
                description: Ok(format!("CAN interface, {}", state.trim())),
            });
        }
    }
    found
}

fn list_video_devices() -> Vec<DetectedDevice> {
    let mut numbers: Vec<u32> = list_directory("/dev")
        .iter()
        .filter_map(|path| path.strip_prefix("/dev/video")?.parse().ok())
        .collect();
    numbers.sort_unstable();
    let devices = numbers.into_iter().map(|number| {
        let name = format!("/dev/video{number}");
        let description = describe_video_device(&name);
        DetectedDevice { name, description }
    });
    devices.collect()
}

fn list_directory(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<_> = entries
        .map(|entry| entry.path().display().to_string())
        .collect();
    paths.sort();
    paths
}
