//! `mirrorball sim --hardware`: the simulated robot's devices as pseudo terminals and a camera socket in real time, for an
//! unchanged `mirrorball run`.

mod base;
mod board;
mod camera;
mod devices;
mod drive_command;
mod faults;
mod folder_lock;
mod inertial;
mod options;
mod real_time_sim;
mod robot_folder;
mod serial_port;
mod timing;
mod vescs;

use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;
use sim::Simulator;

use crate::run::stop_flag::StopFlag;
use devices::VirtualDevices;
use drive_command::CommandStats;
use faults::{FaultInterval, FaultPlan};
use folder_lock::FolderLock;
pub(crate) use options::Options;
use pipeline::csv_table::CsvWriter;
use real_time_sim::RealTimeSim;
use timing::{raise_thread_priority, sleep_until};

/// What `--json` prints at the end.
#[derive(Serialize)]
struct VirtualHardwareResult {
    folder: PathBuf,
    seconds: f64,
    /// Time by which the simulation was too slow, seconds: simulated time paused meanwhile.
    slipped_s: f64,
    commands: CommandStats,
    faults: Vec<FaultInterval>,
}

/// Runs the scenario's hardware until its end, or until a signal.
pub(crate) fn run(sim: Simulator, duration: f64, options: &Options<'_>, json: bool) -> Result<()> {
    let plan = options.faults.map(FaultPlan::load).transpose()?;
    let _lock = FolderLock::take(options.folder)?;
    let header = "stamp_s,x_m,y_m,theta_rad,exposure_s,gain";
    let truth = options.truth.map(|path| CsvWriter::create(path, header));
    let mut devices =
        VirtualDevices::new(&sim, plan.unwrap_or_default(), options, truth.transpose()?)?;
    robot_folder::write_robot_folder(&sim, options)?;
    let stop = StopFlag::on_signals()?;
    let folder = options.folder.display();
    stderr_line!("the devices are ready: mirrorball run --robot {folder}");
    let mut sim = RealTimeSim::start(sim, options.own_path)?;
    raise_thread_priority();
    let started = sim.start_stamp();
    while !stop.is_raised() && hw::now() - started < duration {
        if let Some(kick) = devices.base_firmware.take_kick() {
            sim.kick(kick);
        }
        let Some(due) = sim.next_sample(|now| devices.base_firmware.commanded_twist(now))? else {
            break;
        };
        if let Some(setting) = devices.commanded_setting() {
            sim.command_camera(setting);
        }
        sleep_until(due.stamp);
        devices.deliver(due, hw::now() - started)?;
    }
    let outcome = VirtualHardwareResult {
        folder: options.folder.to_owned(),
        seconds: hw::now() - started,
        slipped_s: sim.lag(),
        commands: devices.base_firmware.command_stats(),
        faults: devices.fault_intervals(started),
    };
    drop(sim);
    devices
        .ground_truth
        .take()
        .map_or(Ok(()), CsvWriter::finish)?;
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        let stats = outcome.commands;
        println!(
            "{:.1} s ({:.2} s behind), {} driving and {} standing commands, {} ran out",
            outcome.seconds, outcome.slipped_s, stats.driving, stats.standing, stats.ran_out
        );
    }
    Ok(())
}
