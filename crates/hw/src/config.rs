//! Which devices does this robot have, and on which ports? hardware.toml, next to robot.toml.

use std::path::Path;

use serde::{Deserialize, Serialize};

use localize::robot::BaseConfig;
use localize::toml_file::{self, TomlFileError};
use localize::toml_location::key_location;

use crate::error::HwError;

/// Longest validity of a motion command, seconds. Without a new command the wheels stop.
pub const COMMAND_VALIDITY_MAX: f64 = 0.1;

/// A hardware file. Every table is optional.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HardwareConfig {
    /// The camera.
    pub camera: Option<CameraDeviceConfig>,
    /// The base: one board, or a VESC for each wheel.
    pub base: Option<BaseDeviceConfig>,
    /// Inertial units and compasses on serial ports of their own.
    #[serde(default)]
    pub inertial: Vec<InertialDeviceConfig>,
}

/// `[camera]`; the image size is in robot.toml.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraDeviceConfig {
    /// V4L2 device (`/dev/video0`, preferably `/dev/v4l/by-id/...`). `unix:PATH` receives images from another program
    /// (docs/wire.md). `genicam:NAME` is a GigE or USB3 Vision camera by its Aravis name; `genicam:` alone selects the
    /// first; both need an executable that was built with `--features aravis` (docs/robot.md).
    pub device: String,
    /// Images per second.
    #[serde(default = "default_camera_rate_hz")]
    pub rate_hz: f32,
    /// V4L2 pixel format: RGB3, BGR3, YUYV, UYVY, RGGB, GRBG, GBRG, BA81, NV12, MJPG or GREY. If empty: the first of
    /// these that the camera supports.
    #[serde(default)]
    pub format: String,
    /// Exposure, seconds; automatic if absent.
    pub exposure: Option<f32>,
    /// Gain, unit of the driver; automatic if absent.
    pub gain: Option<i32>,
    /// White balance, kelvin; automatic if absent.
    pub white_balance_k: Option<i32>,
    /// Time without an image after which the camera counts as stalled, seconds.
    #[serde(default = "default_timeout")]
    pub stall: f32,
}

/// How the base is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bus {
    /// The board protocol (docs/wire.md) over a serial port.
    Board,
    /// One VESC on a serial port, which forwards to the others on its CAN bus.
    VescUart,
    /// VESCs on a CAN interface of Linux.
    VescCan,
    /// VESCs on a CAN bus behind a serial adapter.
    VescSlcan,
}

/// `[base]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseDeviceConfig {
    /// board, vesc-uart, vesc-can or vesc-slcan.
    pub bus: Bus,
    /// Serial port (`/dev/serial/by-id/...`) or CAN interface (`can0`).
    pub port: String,
    /// Baud rate of a serial port.
    #[serde(default = "default_baud")]
    pub baud: u32,
    /// Bit rate of the CAN bus behind a serial adapter, bit/s.
    #[serde(default = "default_can_bit_rate")]
    pub can_bit_rate: u32,
    /// VESC: CAN node number of each wheel's controller, in the order of robot.toml's wheels. Messages count wheels from 0.
    #[serde(default)]
    pub nodes: Vec<u8>,
    /// VESC over UART: node number of the controller on the serial port.
    #[serde(default)]
    pub uart_node: u8,
    /// True for each wheel whose motor is reversed. If absent, no motor is reversed.
    #[serde(default)]
    pub reversed: Vec<bool>,
    /// Board: send the robot's velocity instead of the wheels' speeds.
    #[serde(default)]
    pub send_twist: bool,
    /// Rate at which the last command is repeated, and at which new ones are sent at most, per second.
    #[serde(default = "default_base_rate_hz")]
    pub rate_hz: f32,
    /// Age at which a command expires and the wheels stop, seconds; at most 0.1.
    #[serde(default = "default_command_age_max")]
    pub command_age_max: f32,
    /// VESC: time for which stopped wheels are braked before the motors are released, seconds.
    #[serde(default = "default_timeout")]
    pub brake_time: f32,
    /// Time without a message after which the base counts as stalled, seconds.
    #[serde(default = "default_timeout")]
    pub stall: f32,
    /// Board: use its inertial unit.
    #[serde(default)]
    pub imu: bool,
    /// Board: use its compass.
    #[serde(default)]
    pub compass: bool,
    /// Board: heading of the robot on the field when the board reports 0, degrees.
    #[serde(default)]
    pub north_deg: f32,
}

/// Model of an inertial sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InertialSensor {
    /// BNO085 in UART-RVC mode.
    Bno085,
    /// WitMotion, normal protocol.
    Wit,
}

/// `[[inertial]]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InertialDeviceConfig {
    /// bno085 or wit.
    pub sensor: InertialSensor,
    /// Serial port.
    pub port: String,
    /// Baud rate.
    #[serde(default = "default_baud")]
    pub baud: u32,
    /// Use acceleration and angular rate.
    #[serde(default = "default_true")]
    pub imu: bool,
    /// Use the yaw as a compass. A BNO085's yaw in this mode starts at 0 at power-on and drifts.
    #[serde(default)]
    pub compass: bool,
    /// WitMotion: use the magnetic field instead of the yaw; robot.toml's `compass.calibration` converts it to headings.
    #[serde(default)]
    pub magnetometer: bool,
    /// Mounting of the sensor in the robot: roll, pitch, yaw of its axes, degrees (about x, then y, then z).
    #[serde(default)]
    pub mount_deg: [f32; 3],
    /// True if the sensor's yaw increases clockwise.
    #[serde(default)]
    pub clockwise: bool,
    /// Heading of the robot on the field when the sensor's yaw is 0, degrees.
    #[serde(default)]
    pub north_deg: f32,
    /// Time without a message after which the sensor counts as stalled, seconds.
    #[serde(default = "default_timeout")]
    pub stall: f32,
    /// Duration of bitwise equal readings after which the sensor counts as stuck, seconds.
    #[serde(default = "default_timeout")]
    pub stuck: f32,
}

fn default_true() -> bool {
    true
}
fn default_camera_rate_hz() -> f32 {
    30.0
}
fn default_base_rate_hz() -> f32 {
    100.0
}
fn default_timeout() -> f32 {
    0.5
}
fn default_command_age_max() -> f32 {
    COMMAND_VALIDITY_MAX as f32
}
fn default_baud() -> u32 {
    115_200
}
fn default_can_bit_rate() -> u32 {
    500_000
}

/// Why a hardware file cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum HardwareConfigError {
    /// The file cannot be read, or its content is something else.
    #[error(transparent)]
    File(#[from] TomlFileError),
    /// An invalid value.
    #[error("{place}: {source}")]
    Value {
        /// The file, and the line if the key has one.
        place: String,
        /// Key and reason.
        source: HwError,
    },
}

impl HardwareConfig {
    /// Reads and checks a hardware file.
    pub fn load(path: &Path) -> Result<Self, HardwareConfigError> {
        Self::load_and_check(path, HardwareConfig::check)
    }

    /// Reads a hardware file and checks it, also against the wheels of the robot: robot.toml's `[base]`.
    pub fn load_for_wheels(path: &Path, wheels: &BaseConfig) -> Result<Self, HardwareConfigError> {
        let wheel_count = wheels.kinematics().map(|omni| omni.wheel_count()).ok();
        Self::load_and_check(path, |config| {
            config.check()?;
            match (&config.base, wheel_count) {
                (Some(base), Some(count)) => base.check_entries(count),
                _ => Ok(()),
            }
        })
    }

    fn load_and_check(
        path: &Path,
        check: impl Fn(&Self) -> Result<(), HwError>,
    ) -> Result<Self, HardwareConfigError> {
        let (config, text): (HardwareConfig, _) = toml_file::read(path)?;
        let config = config.resolve_relative_paths(path.parent().unwrap_or(Path::new("")));
        let value = |source: HwError| HardwareConfigError::Value {
            place: match &source {
                HwError::Config { key, .. } => key_location(path, &text, key),
                _ => path.display().to_string(),
            },
            source,
        };
        check(&config).map_err(value)?;
        Ok(config)
    }

    /// Ports that start with a dot are relative to the file's folder, as those of the virtual robot.
    fn resolve_relative_paths(mut self, folder: &Path) -> Self {
        let base = self.base.iter_mut().map(|base| &mut base.port);
        let inertial = self.inertial.iter_mut().map(|inertial| &mut inertial.port);
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

    /// Fails for the first invalid value.
    pub fn check(&self) -> Result<(), HwError> {
        if let Some(camera) = &self.camera {
            camera.check()?;
        }
        if let Some(base) = &self.base {
            base.check()?;
        }
        for inertial in &self.inertial {
            check_name("inertial.port", &inertial.port)?;
            check_baud("inertial.baud", inertial.baud)?;
            check_range("inertial.stall", inertial.stall, 0.02..=10.0)?;
            check_range("inertial.stuck", inertial.stuck, 0.05..=60.0)?;
            check_range("inertial.north_deg", inertial.north_deg, -360.0..=360.0)?;
            for angle in inertial.mount_deg {
                check_range("inertial.mount_deg", angle, -360.0..=360.0)?;
            }
        }
        Ok(())
    }
}

impl CameraDeviceConfig {
    /// Fails for the first invalid value.
    pub(crate) fn check(&self) -> Result<(), HwError> {
        check_name("camera.device", &self.device)?;
        if self.device.starts_with("genicam:") && !cfg!(feature = "aravis") {
            let device = &self.device;
            return Err(HwError::Config {
                key: "camera.device",
                reason: format!(
                    "invalid device: {device:?} (this executable has no GenICam cameras). Build it with --features aravis"
                ),
            });
        }
        check_range("camera.rate_hz", self.rate_hz, 1.0..=1000.0)?;
        check_range("camera.stall", self.stall, 0.05..=10.0)?;
        check_range("camera.exposure", self.exposure.unwrap_or(0.01), 1e-5..=1.0)
    }
}

impl BaseDeviceConfig {
    /// Fails for the first invalid value.
    pub(crate) fn check(&self) -> Result<(), HwError> {
        check_name("base.port", &self.port)?;
        check_baud("base.baud", self.baud)?;
        for (index, node) in self.nodes.iter().enumerate() {
            if self.nodes[..index].contains(node) {
                let key = "base.nodes";
                let reason =
                    format!("invalid node: {node} twice (expected one controller for each wheel)");
                return Err(HwError::Config { key, reason });
            }
        }
        check_range("base.rate_hz", self.rate_hz, 20.0..=1000.0)?;
        check_range(
            "base.command_age_max",
            self.command_age_max,
            0.01..=COMMAND_VALIDITY_MAX as f32,
        )?;
        check_range("base.brake_time", self.brake_time, 0.0..=10.0)?;
        check_range("base.stall", self.stall, 0.05..=10.0)?;
        check_range("base.north_deg", self.north_deg, -360.0..=360.0)
    }

    /// Fails if a list has not one entry for each wheel.
    pub(crate) fn check_entries(&self, wheel_count: usize) -> Result<(), HwError> {
        let nodes = if self.bus == Bus::Board {
            0
        } else {
            wheel_count
        };
        check_count("base.nodes", self.nodes.len(), nodes)?;
        if self.reversed.is_empty() {
            return Ok(());
        }
        check_count("base.reversed", self.reversed.len(), wheel_count)
    }
}

/// Fails if a list has not the expected number of entries.
pub(crate) fn check_count(
    key: &'static str,
    entries: usize,
    expected: usize,
) -> Result<(), HwError> {
    if entries == expected {
        return Ok(());
    }
    let reason = format!("invalid number of entries: {entries} (expected {expected})");
    Err(HwError::Config { key, reason })
}

fn check_name(key: &'static str, name: &str) -> Result<(), HwError> {
    if !name.is_empty() {
        return Ok(());
    }
    let reason = "invalid name: \"\" (expected a device). `mirrorball run --list` shows those of this machine";
    let reason = reason.to_owned();
    Err(HwError::Config { key, reason })
}

fn check_baud(key: &'static str, baud: u32) -> Result<(), HwError> {
    if baud > 0 {
        return Ok(());
    }
    let reason = "invalid baud rate: 0 (expected 1 or more, such as 115200)".to_owned();
    Err(HwError::Config { key, reason })
}

fn check_range(
    key: &'static str,
    value: f32,
    range: std::ops::RangeInclusive<f32>,
) -> Result<(), HwError> {
    if range.contains(&value) {
        return Ok(());
    }
    let reason = format!(
        "invalid value: {value} (expected {} to {})",
        range.start(),
        range.end()
    );
    Err(HwError::Config { key, reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<HardwareConfig, HardwareConfigError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("hardware.toml");
        std::fs::write(&path, text).expect("written");
        HardwareConfig::load(&path)
    }

    #[test]
    fn example_in_docs_is_a_valid_configuration() {
        let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/hardware.toml");
        let config = HardwareConfig::load(Path::new(example)).expect("a configuration");
        assert!(config.camera.is_some() && config.base.is_some());
        assert_eq!(config.inertial.len(), 1);
    }

    #[test]
    fn base_requires_only_bus_and_port() {
        let text = "[base]\nbus = \"board\"\nport = \"/dev/ttyACM0\"\n[[inertial]]\nsensor = \"bno085\"\nport = \"/dev/ttyUSB0\"\n";
        let config = load(text).expect("a configuration");
        let base = config.base.expect("a base");
        assert_eq!((base.bus, base.baud), (Bus::Board, 115_200));
        assert_eq!(config.inertial.len(), 1);
    }

    #[test]
    fn command_age_max_above_100_ms_is_rejected() {
        let text = "[base]\nbus = \"board\"\nport = \"p\"\ncommand_age_max = 0.2\n";
        let message = load(text).expect_err("an error").to_string();
        assert!(
            message.contains("hardware.toml: line ") && message.contains("base.command_age_max")
        );
    }

    #[cfg(not(feature = "aravis"))]
    #[test]
    fn genicam_camera_is_refused_by_a_build_without_it() {
        let message = load("[camera]\ndevice = \"genicam:\"\n").expect_err("an error");
        let message = message.to_string();
        assert!(message.contains("hardware.toml: line 2: "), "{message}");
        assert!(
            message.contains("Build it with --features aravis"),
            "{message}"
        );
    }

    #[test]
    fn empty_names_baud_rates_of_zero_and_equal_nodes_are_refused_with_line_number() {
        let base = "[base]\nport = \"p\"\nbus = \"vesc-can\"\n";
        for (text, wanted) in [
            (
                "[camera]\n\n\ndevice = \"\"\n".to_owned(),
                "camera.device: invalid name",
            ),
            (
                format!("{base}baud = 0\n"),
                "base.baud: invalid baud rate: 0",
            ),
            (
                format!("{base}nodes = [1, 1, 2]\n"),
                "base.nodes: invalid node: 1 twice",
            ),
        ] {
            let message = load(&text).expect_err("refused").to_string();
            assert!(
                message.contains("line 4: ") && message.contains(wanted),
                "{message}"
            );
        }
        for text in [
            "[base]\nbus = \"board\"\nport = \"\"\n",
            "[[inertial]]\nsensor = \"wit\"\nport = \"\"\n",
            "[[inertial]]\nsensor = \"wit\"\nport = \"p\"\nbaud = 0\n",
        ] {
            load(text).expect_err("refused");
        }
    }

    #[test]
    fn lists_of_wrong_length_for_the_wheels_are_refused_with_line_number() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("hardware.toml");
        for (list, entries) in [("reversed = [true]", 1), ("nodes = [1, 2]", 2)] {
            let text = format!("[base]\nbus = \"board\"\nport = \"p\"\n{list}\n");
            std::fs::write(&path, text).expect("written");
            let refused = HardwareConfig::load_for_wheels(&path, &BaseConfig::default());
            let message = refused.expect_err("refused").to_string();
            assert!(message.contains("hardware.toml: line 4: "), "{message}");
            assert!(
                message.contains(&format!("entries: {entries} (")),
                "{message}"
            );
        }
    }

    #[test]
    fn unknown_keys_and_sensors_are_rejected_with_line_number() {
        for text in [
            "[base]\nbus = \"board\"\nport = \"p\"\nspeed = 1\n",
            "\n[[inertial]]\nport = \"p\"\nsensor = \"compass\"\n",
        ] {
            let message = load(text).expect_err("unknown").to_string();
            assert!(message.contains("line 4"), "{message}");
        }
    }
}
