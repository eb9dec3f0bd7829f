//! Which devices does this robot have, and where? hardware.toml beside robot.toml.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::HwError;

/// A hardware file; every table may be left out.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HardwareConfig {
    /// The camera.
    pub camera: Option<CameraDevice>,
    /// The base: one board, or a VESC for each wheel.
    pub base: Option<BaseDevice>,
    /// Inertial units and compasses on lines of their own.
    #[serde(default)]
    pub inertial: Vec<InertialDevice>,
}

/// `[camera]`; the size of its images is robot.toml's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraDevice {
    /// `/dev/video0`, better `/dev/v4l/by-id/...`; `unix:PATH` takes frames from another program (docs/wire.md);
    /// `genicam:NAME` is a GigE or USB3 Vision camera by Aravis' name of it (`genicam:` alone: the first found).
    pub device: String,
    /// Wanted frames per second.
    #[serde(default = "thirty")]
    pub rate_hz: f32,
    /// Wanted format as V4L2 names it (YUYV, UYVY, NV12, RGB3, BGR3, GREY, RGGB, GRBG, GBRG, BA81, MJPG); empty: the first
    /// of these that the camera has.
    #[serde(default)]
    pub format: String,
    /// Exposure, seconds; left out: the camera's own automatic.
    pub exposure: Option<f32>,
    /// Gain, the driver's own unit; left out: the camera's own automatic.
    pub gain: Option<i32>,
    /// White balance, kelvin; left out: the camera's own automatic.
    pub white_balance_k: Option<i32>,
    /// Silence that counts as a stall, seconds.
    #[serde(default = "half")]
    pub stall: f32,
}

/// How the base is spoken to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bus {
    /// Our own protocol over a serial line.
    Board,
    /// One VESC on a serial line, the others behind it on its CAN bus.
    VescUart,
    /// VESCs on a CAN interface of Linux.
    VescCan,
    /// VESCs on a CAN bus behind a serial adapter.
    VescSlcan,
}

/// `[base]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseDevice {
    /// board, vesc-uart, vesc-can or vesc-slcan.
    pub bus: Bus,
    /// Serial line (`/dev/serial/by-id/...`) or CAN interface (`can0`).
    pub port: String,
    /// Baud rate of a serial line.
    #[serde(default = "baud")]
    pub baud: u32,
    /// Bit rate of the CAN bus behind a serial adapter, bit/s.
    #[serde(default = "bit_rate")]
    pub can_bit_rate: u32,
    /// VESC: number of each wheel's controller, in the order of robot.toml's wheels.
    #[serde(default)]
    pub nodes: Vec<u8>,
    /// VESC over UART: number of the controller at the serial line itself.
    #[serde(default)]
    pub uart_node: u8,
    /// True for each wheel whose motor turns the other way; left out: none.
    #[serde(default)]
    pub reversed: Vec<bool>,
    /// Board: send the robot's velocity in place of the wheels' speeds.
    #[serde(default)]
    pub send_twist: bool,
    /// Commands sent per second.
    #[serde(default = "hundred")]
    pub rate_hz: f32,
    /// Age at which a command is stale and the wheels stop, seconds; never more than 0.1.
    #[serde(default = "tenth")]
    pub command_age_max: f32,
    /// VESC: how long stopped wheels are braked before the motors are let go, seconds.
    #[serde(default = "half")]
    pub brake_time: f32,
    /// Silence that counts as a stall, seconds.
    #[serde(default = "half")]
    pub stall: f32,
    /// Board: take its inertial unit.
    #[serde(default)]
    pub imu: bool,
    /// Board: take its compass.
    #[serde(default)]
    pub compass: bool,
    /// Board: heading of the robot on the field when the board says 0, degrees.
    #[serde(default)]
    pub north_deg: f32,
}

/// Which sensor it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sensor {
    /// BNO085 in its UART-RVC mode.
    Bno085,
    /// WitMotion, normal protocol.
    Wit,
}

/// `[[inertial]]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InertialDevice {
    /// bno085 or wit.
    pub sensor: Sensor,
    /// Serial line.
    pub port: String,
    /// Baud rate.
    #[serde(default = "baud")]
    pub baud: u32,
    /// Take acceleration and rate of turn.
    #[serde(default = "yes")]
    pub imu: bool,
    /// Take the yaw as a compass. A BNO085's yaw in this mode begins at 0 when it is switched on and drifts.
    #[serde(default)]
    pub compass: bool,
    /// WitMotion: take the magnetic field for the compass in place of the yaw; robot.toml's `compass.calibration` makes
    /// headings of it.
    #[serde(default)]
    pub magnetometer: bool,
    /// How the sensor lies in the robot: roll, pitch, yaw of its axes, degrees (turned about x, then y, then z).
    #[serde(default)]
    pub mount_deg: [f32; 3],
    /// True if the sensor's yaw grows clockwise.
    #[serde(default)]
    pub clockwise: bool,
    /// Heading of the robot on the field when the sensor's yaw is 0, degrees.
    #[serde(default)]
    pub north_deg: f32,
    /// Silence that counts as a stall, seconds.
    #[serde(default = "half")]
    pub stall: f32,
    /// Time for which readings may be equal to the last bit before the sensor counts as stuck, seconds.
    #[serde(default = "half")]
    pub stuck: f32,
}

fn yes() -> bool {
    true
}
fn thirty() -> f32 {
    30.0
}
fn hundred() -> f32 {
    100.0
}
fn half() -> f32 {
    0.5
}
fn tenth() -> f32 {
    0.1
}
fn baud() -> u32 {
    115_200
}
fn bit_rate() -> u32 {
    500_000
}

/// Why there is no hardware configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// The file is no hardware configuration.
    #[error("{}: {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        source: Box<toml::de::Error>,
    },
    /// A value that cannot work.
    #[error("{}: {source}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Key and reason.
        source: HwError,
    },
}

impl HardwareConfig {
    /// Reads and checks a hardware file.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let path = path.to_owned();
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(source) => return Err(ConfigError::Read { path, source }),
        };
        let config: HardwareConfig = match toml::from_str(&text) {
            Ok(config) => config,
            Err(source) => {
                let source = Box::new(source);
                return Err(ConfigError::Parse { path, source });
            }
        };
        let config = config.relative_to(path.parent().unwrap_or(Path::new("")));
        match config.check() {
            Ok(()) => Ok(config),
            Err(source) => Err(ConfigError::Value { path, source }),
        }
    }

    /// Ports that begin with a dot lie relative to the file, as the virtual robot's do.
    fn relative_to(mut self, folder: &Path) -> Self {
        let base = self.base.iter_mut().map(|base| &mut base.port);
        let inertial = self.inertial.iter_mut().map(|one| &mut one.port);
        let camera = self.camera.iter_mut().map(|camera| &mut camera.device);
        for port in base.chain(inertial).chain(camera) {
            let (kind, path) = match port.strip_prefix("unix:") {
                Some(path) => ("unix:", path),
                None => ("", port.as_str()),
            };
            if path.starts_with('.') {
                *port = format!("{kind}{}", folder.join(path).display());
            }
        }
        self
    }

    /// Refuses the first value that cannot work.
    pub fn check(&self) -> Result<(), HwError> {
        if let Some(camera) = &self.camera {
            camera.check()?;
        }
        if let Some(base) = &self.base {
            base.check()?;
        }
        for inertial in &self.inertial {
            within("inertial.stall", inertial.stall, 0.02..=10.0)?;
            within("inertial.stuck", inertial.stuck, 0.05..=60.0)?;
            within("inertial.north_deg", inertial.north_deg, -360.0..=360.0)?;
            for angle in inertial.mount_deg {
                within("inertial.mount_deg", angle, -360.0..=360.0)?;
            }
        }
        Ok(())
    }
}

impl CameraDevice {
    fn check(&self) -> Result<(), HwError> {
        within("camera.rate_hz", self.rate_hz, 1.0..=1000.0)?;
        within("camera.stall", self.stall, 0.05..=10.0)?;
        within("camera.exposure", self.exposure.unwrap_or(0.01), 1e-5..=1.0)
    }
}

impl BaseDevice {
    /// Refuses the first value that cannot work.
    pub(crate) fn check(&self) -> Result<(), HwError> {
        within("base.rate_hz", self.rate_hz, 20.0..=1000.0)?;
        within("base.command_age_max", self.command_age_max, 0.01..=0.1)?;
        within("base.brake_time", self.brake_time, 0.0..=10.0)?;
        within("base.stall", self.stall, 0.05..=10.0)?;
        within("base.north_deg", self.north_deg, -360.0..=360.0)
    }
}

fn within(
    key: &'static str,
    value: f32,
    range: std::ops::RangeInclusive<f32>,
) -> Result<(), HwError> {
    if range.contains(&value) {
        return Ok(());
    }
    let reason = format!(
        "{value} is not between {} and {}",
        range.start(),
        range.end()
    );
    Err(HwError::Config { key, reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<HardwareConfig, ConfigError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("hardware.toml");
        std::fs::write(&path, text).expect("written");
        HardwareConfig::load(&path)
    }

    #[test]
    fn the_example_of_the_docs_is_a_configuration() {
        let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/hardware.toml");
        let config = HardwareConfig::load(Path::new(example)).expect("a configuration");
        assert!(config.camera.is_some() && config.base.is_some());
        assert_eq!(config.inertial.len(), 1);
    }

    #[test]
    fn a_base_needs_no_more_than_its_bus_and_port() {
        let text = "[base]\nbus = \"board\"\nport = \"/dev/ttyACM0\"\n[[inertial]]\nsensor = \"bno085\"\nport = \"/dev/ttyUSB0\"\n";
        let config = load(text).expect("a configuration");
        let base = config.base.expect("a base");
        assert_eq!((base.bus, base.baud), (Bus::Board, 115_200));
        assert_eq!(config.inertial.len(), 1);
    }

    #[test]
    fn stale_commands_cannot_be_allowed_for_longer_than_a_tenth_of_a_second() {
        let text = "[base]\nbus = \"board\"\nport = \"p\"\ncommand_age_max = 0.2\n";
        let message = load(text).expect_err("too long").to_string();
        assert!(message.contains("hardware.toml") && message.contains("base.command_age_max"));
    }

    #[test]
    fn unknown_keys_and_sensors_are_refused_with_their_line() {
        for text in [
            "[base]\nbus = \"board\"\nport = \"p\"\nspeed = 1\n",
            "\n[[inertial]]\nport = \"p\"\nsensor = \"compass\"\n",
        ] {
            let message = load(text).expect_err("unknown").to_string();
            assert!(message.contains("line 4"), "{message}");
        }
    }
}
