//! `mirrorball sim --hardware`: what would the robot's devices say? Pseudo terminals and a camera socket in real time, so that
//! `mirrorball run` drives the simulated robot unchanged.

mod base;
mod board;
mod camera;
mod devices;
mod drive_command;
mod faults;
mod inertial;
mod real_time_sim;
mod robot_folder;
mod serial_port;
mod vescs;

use std::path::{Path, PathBuf};

use anyhow::Result;
use hw::config::Bus;
use localize::Stamp;
use serde::Serialize;
use sim::Sim;

use crate::run::stop_flag::StopFlag;
use devices::VirtualDevices;
use drive_command::CommandStats;
use faults::{FaultPlan, HardwareFaultKind};
use pipeline::csv_table::CsvWriter;
use real_time_sim::RealTimeSim;

/// What the devices are made from.
pub struct Options<'a> {
    /// Where the devices' names lie.
    pub folder: &'a Path,
    /// What fails when (TOML).
    pub faults: Option<&'a Path>,
    /// The scenario's path moves the robot, whatever the wheels are told.
    pub own_path: bool,
    /// How the base is spoken to.
    pub bus: Bus,
    /// The camera's format: RGB3 or YUYV.
    pub format: &'a str,
    /// Where true poses are written, on the clock of the devices.
    pub truth: Option<&'a Path>,
}

/// What `--json` prints at the end.
#[derive(Serialize)]
struct VirtualHardwareResult {
    folder: PathBuf,
    seconds: f64,
    /// Time that the simulation was too slow for, seconds: the world stood still meanwhile.
    slipped_s: f64,
    commands: CommandStats,
    faults: Vec<FaultInterval>,
}

/// A fault as it happened, CLOCK_MONOTONIC, seconds.
#[derive(Serialize)]
struct FaultInterval {
    kind: HardwareFaultKind,
    from_s: f64,
    until_s: f64,
}

/// Plays the scenario's hardware until its end, or until a signal.
pub fn run(sim: Sim, duration: f64, options: &Options<'_>, json: bool) -> Result<()> {
    let plan = options.faults.map(FaultPlan::load).transpose()?;
    let header = "stamp_s,x_m,y_m,theta_rad";
    let truth = options.truth.map(|path| CsvWriter::create(path, header));
    let mut devices =
        VirtualDevices::new(&sim, plan.unwrap_or_default(), options, truth.transpose()?)?;
    robot_folder::write_robot_folder(&sim, options)?;
    let stop = StopFlag::on_signals()?;
    let folder = options.folder.display();
    eprintln!("the devices are there: mirrorball run --robot {folder}");
    let mut world = RealTimeSim::start(sim, options.own_path)?;
    raise_thread_priority();
    let began = world.start_stamp();
    while !stop.is_raised() && hw::now() - began < duration {
        let Some(due) = world.next_sample(|now| devices.base_firmware.commanded_twist(now))? else {
            break;
        };
        sleep_until(due.stamp);
        devices.deliver(due, hw::now() - began)?;
    }
    let outcome = VirtualHardwareResult {
        folder: options.folder.to_owned(),
        seconds: hw::now() - began,
        slipped_s: world.lag(),
        commands: devices.base_firmware.command_stats(),
        faults: devices.fault_intervals(began),
    };
    drop(world);
    devices
        .ground_truth
        .take()
        .map_or(Ok(()), CsvWriter::finish)?;
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        let audit = outcome.commands;
        println!(
            "{:.1} s ({:.2} s behind), {} driving and {} standing commands, {} ran out",
            outcome.seconds, outcome.slipped_s, audit.driving, audit.standing, audit.ran_out
        );
    }
    Ok(())
}

/// Devices do not wait for a processor: where it may, the calling thread comes before all that merely compute.
fn raise_thread_priority() {
    // What may not is late now and then, and works all the same.
    let _may = hw::realtime::set_realtime_priority(1);
}

fn sleep_until(stamp: Stamp) {
    let left = stamp - hw::now();
    if left > 0.0 {
        std::thread::sleep(std::time::Duration::from_secs_f64(left));
    }
}
