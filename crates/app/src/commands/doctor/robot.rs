//! Do configuration and devices match? Each device is opened and read for a moment; no wheel turns.

use std::path::Path;
use std::time::Duration;

use hw::{DeviceEvent, Devices, EventQueue, HardwareConfig, HealthReport, HealthState};

use super::finding::Finding;
use crate::net::NetworkConfig;
use crate::run::network::NETWORK_FILE;
use crate::run::raw_image::raw_image;
use crate::run::robot_folder::RobotPaths;
use pipeline::sample::{CameraImage, ImageContent, Sample, SourceImage};
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Minimum number of line points of a camera on a field.
const LINE_POINTS_MIN: usize = 15;

/// Minimum number of commands that the line carries while one of them is valid.
const COMMANDS_PER_VALIDITY_MIN: f64 = 2.0;

/// Checks a robot's configuration and devices.
pub(super) fn check_robot(path: &Path, listen: f64) -> Vec<Finding> {
    let RobotPaths { folder, robot_file } = match RobotPaths::resolve(path) {
        Ok(paths) => paths,
        Err(error) => {
            let remedy = "give the robot's folder, or copy config/robots/virtual and change it";
            return vec![Finding::bad("robot", format!("{error:#}"), remedy)];
        }
    };
    let mut findings = Vec::new();
    let setup = Setup::load(&robot_file, None);
    findings.push(match &setup {
        Ok(setup) => Finding::fine(
            "robot.toml",
            match &setup.camera {
                Some((camera, _)) => {
                    format!(
                        "camera of {} × {} pixels",
                        camera.width_px, camera.height_px
                    )
                }
                None => "no camera".to_owned(),
            },
        ),
        Err(error) => Finding::bad(
            "robot.toml",
            format!("{error:#}"),
            "correct the file; docs/recording.md lists its keys",
        ),
    });
    let hardware_file = folder.join("hardware.toml");
    let hardware = match &setup {
        Ok(setup) => {
            let wheels = setup.robot.base.clone().unwrap_or_default();
            HardwareConfig::load_for_wheels(&hardware_file, &wheels)
        }
        Err(_) => HardwareConfig::load(&hardware_file),
    };
    match hardware {
        Ok(hardware) => {
            findings.push(Finding::fine("hardware.toml", hardware_summary(&hardware)));
            if let Ok(setup) = &setup {
                findings.extend(check_devices(&hardware, setup, listen));
            }
        }
        Err(error) => findings.push(Finding::bad(
            "hardware.toml",
            error.to_string(),
            "docs/hardware.toml lists the keys; `mirrorball run --list` lists the devices of this machine",
        )),
    }
    findings.extend(check_network(&folder.join(NETWORK_FILE)));
    findings
}

/// Checks network.toml and lists what it opens. None without the file.
fn check_network(path: &Path) -> Option<Finding> {
    if !path.exists() {
        return None;
    }
    let config = match NetworkConfig::load(path) {
        Ok(config) => config,
        Err(error) => {
            let remedy = "docs/network.md lists the keys";
            return Some(Finding::bad(NETWORK_FILE, format!("{error:#}"), remedy));
        }
    };
    let mut open: Vec<String> = Vec::new();
    open.extend(
        config
            .outputs
            .iter()
            .map(|out| format!("state to {}", out.to)),
    );
    open.extend(
        config
            .commands
            .map(|commands| format!("commands at {}", commands.bind)),
    );
    open.extend(config.team.map(|team| {
        format!(
            "the team at {} as robot {} (the settings' team.number must be the same)",
            team.group, team.robot
        )
    }));
    open.extend(
        config
            .stream
            .map(|stream| format!("viewers at {}:{}", stream.bind, stream.port)),
    );
    if open.is_empty() {
        open.push("nothing is open".to_owned());
    }
    Some(Finding::fine(NETWORK_FILE, open.join(", ")))
}

fn hardware_summary(hardware: &HardwareConfig) -> String {
    let negation = |present: bool| if present { "" } else { "no " };
    format!(
        "{}camera, {}base, {} inertial",
        negation(hardware.camera.is_some()),
        negation(hardware.base.is_some()),
        hardware.inertial.len()
    )
}

fn check_devices(hardware: &HardwareConfig, setup: &Setup, listen: f64) -> Vec<Finding> {
    let events = EventQueue::new(1024);
    let devices = match Devices::start(hardware, &setup.robot, 0, &events) {
        Ok(devices) => devices,
        Err(error) => {
            let remedy = "correct hardware.toml or robot.toml";
            return vec![Finding::bad("devices", error.to_string(), remedy)];
        }
    };
    let deadline = hw::now() + listen;
    let (mut image, mut emergency_stop) = (None, false);
    while hw::now() < deadline {
        match events.pop_timeout(Duration::from_millis(50)) {
            Some(DeviceEvent::Image(newest)) => image = Some(newest),
            Some(DeviceEvent::Switches(switches)) => emergency_stop = switches.emergency_stop,
            _ => {}
        }
    }
    let ports = device_ports(hardware);
    let mut findings: Vec<Finding> = devices
        .health()
        .iter()
        .zip(ports)
        .map(|(health, port)| device_finding(health, &port))
        .collect();
    findings.extend(check_line(hardware, setup));
    if emergency_stop {
        findings.push(Finding::note(
            "emergency stop",
            "pressed",
            "release it before the game",
        ));
    }
    if hardware.camera.is_some() {
        findings.extend(image.map(|image| check_vision(setup, image)));
    }
    findings
}

/// Does the line to the base carry the commands? None if it does.
fn check_line(hardware: &HardwareConfig, setup: &Setup) -> Option<Finding> {
    let device = hardware.base.as_ref()?;
    let wheels = setup.robot.base.clone().unwrap_or_default();
    let rate_max = hw::base::command_rate_max(device, &wheels)?;
    let hw::config::BaseDeviceConfig { baud, rate_hz, .. } = device;
    if rate_max >= f64::from(*rate_hz) {
        return None;
    }
    let what = format!("line to the base ({})", device.port);
    let found =
        format!("{baud} baud carry {rate_max:.0} of {rate_hz} commands per second: fewer are sent");
    let remedy = "raise `baud` in hardware.toml and in the base, or lower `rate_hz`";
    // Below, a command expires before the next one has arrived.
    let is_enough = rate_max * f64::from(device.command_age_max) >= COMMANDS_PER_VALIDITY_MIN;
    Some(if is_enough {
        Finding::note(&what, found, remedy)
    } else {
        Finding::bad(&what, found, remedy)
    })
}

/// The ports in the order of [`Devices::health`].
fn device_ports(hardware: &HardwareConfig) -> Vec<String> {
    let base = hardware.base.iter().map(|base| base.port.clone());
    let camera = hardware.camera.iter().map(|camera| camera.device.clone());
    let inertial = hardware.inertial.iter().map(|sensor| sensor.port.clone());
    base.chain(camera).chain(inertial).collect()
}

fn device_finding(health: &HealthReport, port: &str) -> Finding {
    let what = format!("{} ({port})", health.device);
    let reason = health.reason.clone().unwrap_or_default();
    match health.state {
        HealthState::Running => Finding::fine(&what, format!("{} messages", health.messages)),
        HealthState::Clock => {
            let remedy = "correct the device's clock: its setting, firmware or driver";
            Finding::note(&what, reason, remedy)
        }
        HealthState::Absent => Finding::bad(&what, reason, missing_device_remedy(port)),
        HealthState::Stalled => Finding::bad(&what, reason, "check its power, cable and settings"),
        HealthState::Garbage if port.starts_with("unix:") => Finding::bad(
            &what,
            reason,
            "start the camera's program; let it send images as in docs/wire.md",
        ),
        HealthState::Garbage => Finding::bad(
            &what,
            reason,
            "compare baud rate and protocol with the device's; swap the ports if two were confused",
        ),
        HealthState::Stuck | HealthState::Range => {
            Finding::bad(&what, reason, "switch the device off and on")
        }
    }
}

/// Remedy for a device that cannot be opened.
fn missing_device_remedy(port: &str) -> String {
    let path = Path::new(port.strip_prefix("unix:").unwrap_or(port));
    if port.starts_with("genicam:") {
        return "check the network address and the camera's power; `arv-tool-0.8` lists the cameras".to_owned();
    }
    if !port.contains('/') {
        return format!(
            "bring the interface up: sudo ip link set {port} up type can bitrate 500000"
        );
    }
    match rustix::fs::access(
        path,
        rustix::fs::Access::READ_OK | rustix::fs::Access::WRITE_OK,
    ) {
        Ok(()) => "end the other program that uses it (`fuser` shows it)".to_owned(),
        Err(rustix::io::Errno::ACCESS) => {
            let group = if port.contains("video") || port.contains("v4l") {
                "video"
            } else {
                "dialout"
            };
            format!("install the udev rules, or: sudo usermod -aG {group} $USER, and log in again")
        }
        Err(_) => {
            "plug it in; `mirrorball run --list` shows the devices that are present".to_owned()
        }
    }
}

/// Processes one image as `run` does.
fn check_vision(setup: &Setup, image: hw::camera::CapturedImage) -> Finding {
    let pipeline = Pipeline::new(setup, &PipelineConfig::default());
    let stamp = image.stamp;
    let content = ImageContent::Pixels(SourceImage::Raw(raw_image(image)));
    let result = pipeline.map(|mut pipeline| {
        pipeline.process_sample(Sample::Image(CameraImage {
            stamp,
            setting: None,
            content,
        }))
    });
    let bad = |found: String| {
        let remedy = "compare the camera's size and format with robot.toml's";
        Finding::bad("sight", found, remedy)
    };
    match result {
        Err(error) => bad(format!("{error:#}")),
        Ok(None) => bad("no image was processed".to_owned()),
        Ok(Some(cycle)) => match cycle.image_fault {
            Some(fault) => bad(fault),
            None => {
                let points = cycle.line_points.len();
                let found = format!("{points} line points in one image");
                if points < LINE_POINTS_MIN {
                    let remedy = "on a field: uncover the lens, set the exposure, check the map with `calibrate`";
                    Finding::note("sight", found, remedy)
                } else {
                    Finding::fine("sight", found)
                }
            }
        },
    }
}
