//! The robot's description, robot.toml: camera, mirror or map, field, base and sensors.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::omni::{OmniError, OmniKinematics};
use crate::sensors::compass_calibration::CompassCalibration;
use crate::toml_file::{self, TomlFileError};
use crate::toml_location::key_location;

mod calibration;
mod camera;
mod exposure;
mod value_checks;

use calibration::{CalibrationFile, check_compass};
pub use calibration::{ImuCalibration, OdometryCalibration, TimingCalibration, rotation_from_rpy};
pub use camera::{CameraConfig, CameraSection};
pub use exposure::{CameraControl, ExposureSetting};
use value_checks::{TURN_DEG, check_not_negative, check_positive, check_range, check_within};

/// Height of the viewpoint if no mirror profile is known, metres: the mirror's surface at half its radius.
///
/// A tilt displaces a ground point by its squared distance over this height, so the height is that of the mean pixel.
pub const DEFAULT_VIEWPOINT_HEIGHT: f32 = 0.75;

/// Height of the mirror's rim if no mirror profile is known, metres. The league allows robots of 0.8.
///
/// Not [`DEFAULT_VIEWPOINT_HEIGHT`]: object detection and the viewer use far objects near the mirror's rim, which is
/// higher than its middle. With a profile, both use the profile's own height.
pub const DEFAULT_MIRROR_RIM_HEIGHT: f32 = 0.78;

/// A robot file. Paths are relative to the file; `load` has already resolved them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotConfig {
    /// The field file.
    pub field: PathBuf,
    /// Files that calibration wrote. Empty after loading: their sections are in this robot then.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub include: Vec<PathBuf>,
    /// Camera and its mount. Not required for a recording of line points.
    pub camera: Option<CameraSection>,
    /// Range of the camera's exposure and gain.
    pub exposure: Option<CameraControl>,
    /// The mirror's profile.
    pub mirror: Option<MirrorConfig>,
    /// A calibrated map.
    pub map: Option<MapConfig>,
    /// Mask of the robot's own body: a grey PNG of the image's size, black on the body.
    pub mask: Option<PathBuf>,
    /// Labelled pixels to learn the colours: a CSV of file,u,v,class.
    pub labels: Option<PathBuf>,
    /// A saved colour table, instead of labels.
    pub colours: Option<PathBuf>,
    /// Three or four omnidirectional wheels. A robot with another drive, such as a differential one, has no `[base]`: its motion comes
    /// from odometry.csv (dy_m = 0), or from ROS 2.
    pub base: Option<BaseConfig>,
    /// Correction of the wheels' motion.
    pub odometry: Option<OdometryCalibration>,
    /// Times between the sensors.
    pub timing: Option<TimingCalibration>,
    /// Inertial unit.
    pub imu: Option<ImuConfig>,
    /// Compass.
    pub compass: Option<CompassModelConfig>,
    /// Parts of the robot in the camera's view.
    pub body: Option<BodyConfig>,
}

/// `[mirror]`: a mirror of revolution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MirrorConfig {
    /// CSV of radius_m,height_m (above the ground).
    pub profile: PathBuf,
}

/// `[map]`: calibrated map from pixels to ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapConfig {
    /// npz of x_m, y_m.
    pub file: PathBuf,
    /// Standard deviation of its origin from the robot's centre, per axis, metres. Without it
    /// `localize.map_correction.origin_std` holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin_std: Option<f32>,
    /// Standard deviation of its forward direction, degrees. 0 without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_std_deg: Option<f32>,
}

/// `[base]`: three or four omnidirectional wheels on a circle (docs/methods.md 7.1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaseConfig {
    /// Position of each wheel, degrees counter-clockwise from the robot's x axis. A wheel rolls perpendicular to that
    /// direction.
    pub wheel_angles_deg: Vec<f32>,
    /// Radius of a wheel, metres.
    pub wheel_radius: f32,
    /// Distance of the wheels from the robot's centre, metres.
    pub wheel_distance: f32,
    /// Encoder ticks per revolution of a wheel.
    pub ticks_per_turn: f32,
    /// Odometry samples per second.
    pub rate_hz: f32,
    /// Mass of the robot, kilograms.
    pub mass: f32,
    /// Top speed of a wheel's rim, m/s.
    pub speed_max: f32,
    /// Largest acceleration by the motors, m/s².
    pub acceleration_max: f32,
}

impl BaseConfig {
    /// Kinematics of the wheels. Fails for wheels that cannot drive in every direction.
    pub fn kinematics(&self) -> Result<OmniKinematics, OmniError> {
        let angles: Vec<f32> = self
            .wheel_angles_deg
            .iter()
            .map(|angle_deg| angle_deg.to_radians())
            .collect();
        OmniKinematics::new(&angles, self.wheel_radius, self.wheel_distance)
    }
}

impl Default for BaseConfig {
    fn default() -> Self {
        BaseConfig {
            wheel_angles_deg: vec![60.0, 180.0, 300.0],
            wheel_radius: 0.05,
            wheel_distance: 0.2,
            ticks_per_turn: 4096.0,
            rate_hz: 100.0,
            mass: 30.0,
            speed_max: 4.5,
            acceleration_max: 3.0,
        }
    }
}

/// `[imu]`: an inertial unit at the robot's centre, axes along the robot's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuConfig {
    /// Samples per second.
    pub rate_hz: f32,
    /// White noise of each acceleration sample, m/s² (one sigma).
    pub acceleration_noise: f32,
    /// Constant acceleration bias, m/s² (one sigma over units).
    pub acceleration_bias: f32,
    /// White noise of each rate sample, degrees/s (one sigma).
    pub rate_noise_deg: f32,
    /// Constant rate bias, degrees/s (one sigma over units).
    pub rate_bias_deg: f32,
    /// Mounting and errors of this unit, as written by `calibrate imu`.
    pub calibration: Option<ImuCalibration>,
}

impl Default for ImuConfig {
    fn default() -> Self {
        ImuConfig {
            rate_hz: 100.0,
            acceleration_noise: 0.15,
            acceleration_bias: 0.1,
            rate_noise_deg: 0.3,
            rate_bias_deg: 0.3,
            calibration: None,
        }
    }
}

/// `[compass]`: a heading on the field, disturbed by motors and iron in the floor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CompassModelConfig {
    /// Samples per second.
    pub rate_hz: f32,
    /// White noise of each sample, degrees (one sigma).
    pub noise_deg: f32,
    /// Slow bias, degrees (one sigma).
    pub bias_deg: f32,
    /// Correlation time of the slow bias, seconds.
    pub bias_time: f32,
    /// Calibration of the magnetometer, as written by `calibrate compass`.
    pub calibration: Option<CompassCalibration>,
    /// Iron of the simulated robot: its compass is then an uncalibrated magnetometer.
    pub iron: Option<IronConfig>,
}

/// `[compass.iron]`: distortion of the earth's magnetic field by the robot's iron; its horizontal component is 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IronConfig {
    /// Offset of the field in the robot frame: magnets.
    pub hard: [f32; 2],
    /// Matrix (rows) applied to the field in the robot frame before the offset: steel.
    pub soft: [[f32; 2]; 2],
}

impl Default for CompassModelConfig {
    fn default() -> Self {
        CompassModelConfig {
            rate_hz: 30.0,
            noise_deg: 5.0,
            bias_deg: 4.0,
            bias_time: 20.0,
            calibration: None,
            iron: None,
        }
    }
}

/// `[body]`: the robot's own parts in the image, with the rods that carry the mirror.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BodyConfig {
    /// Radius of the robot's round body, metres.
    pub radius: f32,
    /// Height of that body, metres.
    pub height: f32,
    /// Side of the square camera box that carries the pinhole, metres.
    pub camera_side: f32,
    /// Directions of the rods, degrees counter-clockwise from the robot's x axis.
    pub rod_angles_deg: Vec<f32>,
    /// Distance of the rods from the mirror's axis, metres.
    pub rod_distance: f32,
    /// Radius of each rod, metres.
    pub rod_radius: f32,
}

impl Default for BodyConfig {
    fn default() -> Self {
        BodyConfig {
            radius: 0.22,
            height: 0.35,
            camera_side: 0.03,
            rod_angles_deg: vec![60.0, 180.0, 300.0],
            rod_distance: 0.18,
            rod_radius: 0.003,
        }
    }
}

/// Where the mirror's axis meets the image, pixels: within the largest image, or as far beside it.
const CENTRE_PX: RangeInclusive<f32> = -8192.0..=16384.0;
/// Focal length of any camera, pixels.
const FOCAL_PX: RangeInclusive<f32> = 1.0..=100_000.0;
/// Radius of a robot's wheels and their distance from its centre, metres.
const WHEEL_SIZE: RangeInclusive<f32> = 0.001..=5.0;
/// Speed and acceleration of any robot, m/s and m/s².
const SPEED: RangeInclusive<f32> = 0.01..=50.0;
const ACCELERATION: RangeInclusive<f32> = 0.01..=200.0;
/// Height of a camera, metres.
const CAMERA_HEIGHT: RangeInclusive<f32> = 0.01..=20.0;
/// Samples per second of a simulated sensor.
const SENSOR_RATE_HZ: RangeInclusive<f32> = 0.01..=10_000.0;

/// Why a robot file cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum RobotConfigError {
    /// The file cannot be read, or its content is something else.
    #[error(transparent)]
    File(#[from] TomlFileError),
    /// A value out of bounds.
    #[error("{place}: {key}: {reason}")]
    Value {
        /// The file, with the line if the key has one.
        place: String,
        /// The key in the file.
        key: &'static str,
        /// What is wrong with it.
        reason: String,
    },
}

impl RobotConfig {
    /// Reads and checks a robot file; its paths are resolved relative to the file's folder.
    pub fn load(path: &Path) -> Result<Self, RobotConfigError> {
        let (mut robot, text): (RobotConfig, _) = toml_file::read(path)?;
        robot
            .check()
            .map_err(|(key, reason)| RobotConfigError::Value {
                place: key_location(path, &text, key),
                key,
                reason,
            })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let files = [
            Some(&mut robot.field),
            robot.mask.as_mut(),
            robot.labels.as_mut(),
            robot.colours.as_mut(),
            robot.map.as_mut().map(|map| &mut map.file),
            robot.mirror.as_mut().map(|mirror| &mut mirror.profile),
        ];
        for file in files.into_iter().flatten() {
            *file = folder.join(&*file);
        }
        include_files(&mut robot, folder)?;
        Ok(robot)
    }

    /// The first key with an invalid value, and the reason.
    fn check(&self) -> Result<(), (&'static str, String)> {
        if let Some(camera) = &self.camera {
            if !(2..=8192).contains(&camera.width_px) || !(2..=8192).contains(&camera.height_px) {
                let size = format!("{} × {} px", camera.width_px, camera.height_px);
                return Err((
                    "camera.width_px",
                    format!("the image has {size}: both sides between 2 and 8192"),
                ));
            }
            for centre in camera.centre_px.unwrap_or_default() {
                check_range("camera.centre_px", centre, CENTRE_PX)?;
            }
            check_within("camera.forward_deg", &[camera.forward_deg], TURN_DEG)?;
            for (key, value, range) in [
                ("camera.focal_px", camera.focal_px, FOCAL_PX),
                ("camera.height", camera.height, CAMERA_HEIGHT),
                (
                    "camera.outer_radius_px",
                    camera.outer_radius_px,
                    1.0..=(camera.width_px + camera.height_px) as f32,
                ),
            ] {
                value.map_or(Ok(()), |value| check_range(key, value, range))?;
            }
        }
        if let Some(origin_std) = self.map.as_ref().and_then(|map| map.origin_std) {
            check_not_negative("map.origin_std", origin_std)?;
        }
        if let Some(turn_std) = self.map.as_ref().and_then(|map| map.turn_std_deg) {
            check_not_negative("map.turn_std_deg", turn_std)?;
        }
        if let Some(exposure) = &self.exposure {
            exposure.check()?;
        }
        if let Some(base) = &self.base {
            base.check()?;
        }
        if let Some(imu) = &self.imu {
            check_range("imu.rate_hz", imu.rate_hz, SENSOR_RATE_HZ)?;
            check_not_negative("imu.acceleration_noise", imu.acceleration_noise)?;
            check_not_negative("imu.acceleration_bias", imu.acceleration_bias)?;
            check_not_negative("imu.rate_noise_deg", imu.rate_noise_deg)?;
            check_not_negative("imu.rate_bias_deg", imu.rate_bias_deg)?;
            imu.calibration
                .map_or(Ok(()), |calibration| calibration.check())?;
        }
        self.odometry.map_or(Ok(()), |odometry| odometry.check())?;
        self.timing.map_or(Ok(()), |timing| timing.check())?;
        if let Some(compass) = &self.compass {
            check_range("compass.rate_hz", compass.rate_hz, SENSOR_RATE_HZ)?;
            check_not_negative("compass.noise_deg", compass.noise_deg)?;
            check_not_negative("compass.bias_deg", compass.bias_deg)?;
            check_positive("compass.bias_time", compass.bias_time)?;
            compass
                .calibration
                .map_or(Ok(()), |calibration| check_compass(&calibration))?;
        }
        if let Some(body) = &self.body {
            check_within("body.rod_angles_deg", &body.rod_angles_deg, TURN_DEG)?;
            check_not_negative("body.radius", body.radius)?;
            check_not_negative("body.height", body.height)?;
            check_not_negative("body.camera_side", body.camera_side)?;
            check_not_negative("body.rod_distance", body.rod_distance)?;
            check_not_negative("body.rod_radius", body.rod_radius)?;
        }
        Ok(())
    }
}

/// Adds the files that a robot file includes, relative to its folder. What they say replaces what the robot file says.
fn include_files(robot: &mut RobotConfig, folder: &Path) -> Result<(), RobotConfigError> {
    for name in std::mem::take(&mut robot.include) {
        include_file(robot, &folder.join(name))?;
    }
    Ok(())
}

fn include_file(robot: &mut RobotConfig, path: &Path) -> Result<(), RobotConfigError> {
    let (file, text): (CalibrationFile, _) = toml_file::read(path)?;
    let rejected = |(key, reason): (&'static str, String)| RobotConfigError::Value {
        place: key_location(path, &text, key),
        key,
        reason,
    };
    if let Some(odometry) = file.odometry {
        robot.odometry = Some(odometry);
    }
    if let Some(imu) = file.imu {
        let config = robot.imu.get_or_insert_with(ImuConfig::default);
        config.calibration = Some(imu.calibration);
    }
    if let Some(timing) = file.timing {
        robot.timing = Some(timing);
    }
    if let Some(compass) = file.compass {
        let config = robot
            .compass
            .get_or_insert_with(CompassModelConfig::default);
        config.calibration = Some(compass.calibration);
    }
    if let Some(rim) = file.camera {
        let missing = || ("camera", "robot.toml has no [camera] section".to_owned());
        let camera = robot
            .camera
            .as_mut()
            .ok_or_else(missing)
            .map_err(rejected)?;
        camera.centre_px = Some(rim.centre_px);
        camera.outer_radius_px = Some(rim.outer_radius_px);
    }
    robot.check().map_err(rejected)
}

impl BaseConfig {
    fn check(&self) -> Result<(), (&'static str, String)> {
        let wheels = self.wheel_angles_deg.len();
        if !(3..=4).contains(&wheels) {
            return Err((
                "base.wheel_angles_deg",
                format!(
                    "{wheels} wheels (expected three or four omnidirectional ones; a robot with another drive leaves [base] out and gives its motion in odometry.csv)"
                ),
            ));
        }
        check_within("base.wheel_angles_deg", &self.wheel_angles_deg, TURN_DEG)?;
        for (key, value, range) in [
            ("base.wheel_radius", self.wheel_radius, WHEEL_SIZE),
            ("base.wheel_distance", self.wheel_distance, WHEEL_SIZE),
            ("base.speed_max", self.speed_max, SPEED),
            ("base.acceleration_max", self.acceleration_max, ACCELERATION),
        ] {
            check_range(key, value, range)?;
        }
        for (key, value) in [
            ("base.ticks_per_turn", self.ticks_per_turn),
            ("base.rate_hz", self.rate_hz),
            ("base.mass", self.mass),
        ] {
            check_positive(key, value)?;
        }
        self.kinematics()
            .map(drop)
            .map_err(|error| ("base.wheel_angles_deg", error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<RobotConfig, RobotConfigError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("robot.toml");
        std::fs::write(&path, text).expect("written");
        RobotConfig::load(&path)
    }

    #[test]
    fn numbers_that_no_camera_has_are_refused_with_their_line() {
        for line in [
            "focal_px = 1e30",
            "height = 1e30",
            "outer_radius_px = 1e-30",
            "outer_radius_px = 4290",
            "centre_px = [238.9, 1e30]",
        ] {
            let text = format!(
                "field = \"field.toml\"\n[camera]\nwidth_px = 480\nheight_px = 480\n{line}\n"
            );
            let message = load(&text).expect_err("refused").to_string();
            assert!(
                message.contains("line 5: camera.") && message.contains("(expected "),
                "{message}"
            );
        }
    }

    #[test]
    fn two_wheels_are_refused_with_what_a_differential_robot_does() {
        let two = "field = \"field.toml\"\n[base]\nwheel_angles_deg = [90.0, 270.0]\n";
        let message = load(two).expect_err("refused").to_string();
        assert!(
            message.contains("line 3: base.wheel_angles_deg: 2 wheels")
                && message.contains("leaves [base] out"),
            "{message}"
        );
        let none = load("field = \"field.toml\"\n").expect("a robot");
        assert_eq!(none.base, None);
    }

    #[test]
    fn camera_with_a_size_alone_has_no_axis_yet() {
        let text = "field = \"field.toml\"\n[camera]\nwidth_px = 480\nheight_px = 480\n";
        let section = load(text).expect("a robot").camera.expect("a camera");
        assert_eq!(section.camera(), None);
        let camera = section.with_axis([240.0, 239.0], None);
        assert_eq!((camera.forward_deg, camera.flipped), (90.0, true));
    }

    #[test]
    fn a_compass_calibration_without_a_heading_is_refused() {
        let compass = |soft: &str, radius: &str| {
            load(&format!(
                "field = \"field.toml\"\n[compass.calibration]\nhard = [3.0, -2.0]\nsoft = {soft}\nradius = {radius}\n"
            ))
        };
        assert!(compass("[[1.0, 0.1], [0.1, 0.9]]", "21.5").is_ok());
        for (soft, radius, key) in [
            (
                "[[1.0, 0.0], [0.0, 1.0]]",
                "0.0",
                "compass.calibration.radius",
            ),
            (
                "[[1.0, 0.0], [0.0, 1.0]]",
                "-20.0",
                "compass.calibration.radius",
            ),
            (
                "[[1.0, 2.0], [0.5, 1.0]]",
                "20.0",
                "compass.calibration.soft",
            ),
        ] {
            let refused = compass(soft, radius).expect_err("refused").to_string();
            assert!(refused.contains(key), "{refused}");
        }
    }

    #[test]
    fn included_calibration_replaces_what_the_robot_file_says() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: &str| {
            std::fs::write(folder.path().join(name), text).expect("written");
        };
        write(
            "robot.toml",
            "field = \"field.toml\"\ninclude = [\"wheels.toml\", \"latency.toml\"]\n[timing]\ncamera_latency = 0.5\n",
        );
        write(
            "wheels.toml",
            "[odometry]\nmatrix = [[1.1, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.9]]\n",
        );
        write("latency.toml", "[timing]\ncamera_latency = 0.03\n");
        let load = || RobotConfig::load(&folder.path().join("robot.toml"));
        let robot = load().expect("a robot");
        assert_eq!(robot.timing.expect("a latency").camera_latency, 0.03);
        assert_eq!(robot.odometry.expect("a matrix").matrix[2][2], 0.9);
        assert!(
            robot.include.is_empty(),
            "a log holds the values themselves"
        );
        for (text, wanted) in [
            ("[timing]\ncamera_latency = 7.0\n", "line 2"),
            ("\nfield = \"/etc/passwd\"\n", "line 2"),
            ("[timing]\n", "line 1"),
        ] {
            write("latency.toml", text);
            let message = load().expect_err("rejected").to_string();
            assert!(
                message.contains("latency.toml") && message.contains(wanted),
                "{message}"
            );
        }
    }

    #[test]
    fn sample_robot_toml_loads_with_resolved_paths() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
        let robot = RobotConfig::load(&folder.join("robot.toml")).expect("a robot");
        assert!(robot.field.is_file());
        assert!(robot.mirror.expect("a mirror").profile.is_file());
    }

    #[test]
    fn robot_toml_needs_only_a_field() {
        let robot = load("field = \"field.toml\"").expect("a robot");
        assert!(robot.camera.is_none() && robot.base.is_none());
    }

    #[test]
    fn angle_beyond_a_turn_is_refused_with_its_line() {
        for (text, key) in [
            (
                "[camera]\nwidth_px = 480\nheight_px = 480\nforward_deg = 1e9",
                "line 5: camera.forward_deg: 1000000000",
            ),
            (
                "[base]\nwheel_angles_deg = [60.0, 180.0, 361.0]",
                "line 3: base.wheel_angles_deg: 361",
            ),
            (
                "[body]\nrod_angles_deg = [-400.0]",
                "line 3: body.rod_angles_deg: -400",
            ),
        ] {
            let loaded = load(&format!("field = \"f.toml\"\n{text}\n"));
            let message = loaded.expect_err(key).to_string();
            let wanted = format!("{key} (expected -360 to 360)");
            assert!(message.ends_with(&wanted), "{message}");
        }
        let text =
            "field = \"f.toml\"\n[camera]\nwidth_px = 480\nheight_px = 480\nforward_deg = -270\n";
        load(text).expect("a direction");
    }

    #[test]
    fn unknown_key_is_rejected_with_its_line() {
        let message = load("field = \"f.toml\"\n[base]\nwheels = 3\n")
            .expect_err("unknown key")
            .to_string();
        assert!(
            message.contains("robot.toml")
                && message.contains("line 3")
                && message.contains("wheels"),
            "{message}"
        );
    }

    #[test]
    fn base_with_two_wheels_is_rejected() {
        let message = load("field = \"f.toml\"\n[base]\nwheel_angles_deg = [0.0, 180.0]\n")
            .expect_err("two wheels")
            .to_string();
        assert!(
            message.contains("robot.toml: line 3: base.wheel_angles_deg"),
            "{message}"
        );
    }
}
