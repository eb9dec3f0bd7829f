//! Where are the virtual devices? In a robot folder for `run`: robot.toml, hardware.toml and the devices.

use std::path::PathBuf;

use anyhow::{Context, Result};
use hw::config::Bus;
use sim::Simulator;
use vision::output_file::write_file;

use super::options::Options;
use super::vescs::NODES;

/// File names of the devices in the folder.
pub(super) const BASE: &str = "base";
pub(super) const WIT: &str = "wit";
pub(super) const BNO085: &str = "bno085";
pub(super) const CAMERA: &str = "camera";

/// Exposure of the virtual camera at the simulator's exposure 1, seconds.
pub(super) const EXPOSURE_UNIT: f32 = 0.01;

/// Writes robot.toml and hardware.toml into the folder of the devices.
pub(super) fn write_robot_folder(sim: &Simulator, options: &Options<'_>) -> Result<()> {
    let mut robot = sim.robot().clone();
    if let Some(field) = &sim.scenario().field {
        robot.field.clone_from(field);
    }
    let absolute = |path: &mut PathBuf| -> Result<()> {
        *path = path
            .canonicalize()
            .with_context(|| format!("cannot read {}", path.display()))?;
        Ok(())
    };
    absolute(&mut robot.field)?;
    // A camera counts its exposure in seconds, the simulator in multiples of its default.
    if let Some(control) = &mut robot.exposure {
        let sensor = sim.image_sensor();
        (control.exposure, control.gain) = (sensor.exposure, sensor.gain);
        for exposure in [
            &mut control.exposure,
            &mut control.exposure_min,
            &mut control.exposure_max,
            &mut control.path_slope,
            &mut control.path_offset,
        ] {
            *exposure *= EXPOSURE_UNIT;
        }
    }
    robot
        .mirror
        .as_mut()
        .map_or(Ok(()), |mirror| absolute(&mut mirror.profile))?;
    robot
        .map
        .as_mut()
        .map_or(Ok(()), |map| absolute(&mut map.file))?;
    robot.labels.as_mut().map_or(Ok(()), absolute)?;
    robot.colours.as_mut().map_or(Ok(()), absolute)?;
    let rate_hz = sim.scenario().frame_rate_hz;
    let wheels = robot
        .base
        .as_ref()
        .map_or(0, |base| base.wheel_angles_deg.len());
    let hardware = format!(
        "# The virtual robot of `mirrorball sim --hardware`; its devices are in this folder.\n\
         [camera]\ndevice = \"unix:./{CAMERA}\"\nrate_hz = {rate_hz:?}\n\n\
         [base]\n{}port = \"./{BASE}\"\n\n\
         [[inertial]]\nsensor = \"wit\"\nport = \"./{WIT}\"\nimu = true\ncompass = {}\n",
        base_keys(options.bus, wheels),
        robot.compass.is_some()
    );
    for (name, text) in [
        ("robot.toml", toml::to_string(&robot)?),
        ("hardware.toml", hardware),
    ] {
        let path = options.folder.join(name);
        write_file(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// Keys of the base's bus.
fn base_keys(bus: Bus, wheels: usize) -> String {
    let nodes = &NODES[..wheels.min(NODES.len())];
    match bus {
        Bus::Board => "bus = \"board\"\n".to_owned(),
        Bus::VescUart => format!(
            "bus = \"vesc-uart\"\nnodes = {nodes:?}\nuart_node = {}\n",
            NODES[0]
        ),
        Bus::VescCan | Bus::VescSlcan => format!("bus = \"vesc-slcan\"\nnodes = {nodes:?}\n"),
    }
}
