//! `mirrorball sim --hardware`: what would the robot's devices say? Pseudo terminals and a camera socket in real time, so that
//! `mirrorball run` drives the simulated robot unchanged.

mod base;
mod board;
mod camera;
mod devices;
mod faults;
mod folder;
mod inertial;
mod line;
mod orders;
mod vescs;
mod world;

use std::path::{Path, PathBuf};

use anyhow::Result;
use hw::config::Bus;
use localize::Stamp;
use serde::Serialize;
use sim::Sim;

use crate::run::stop::Stop;
use devices::Devices;
use faults::{Kind, Plan};
use orders::Audit;
use pipeline::csv_table::Written;
use world::World;

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
struct Outcome {
    folder: PathBuf,
    seconds: f64,
    /// Time that the simulation was too slow for, seconds: the world stood still meanwhile.
    slipped_s: f64,
    commands: Audit,
    faults: Vec<Happened>,
}

/// A fault as it happened, CLOCK_MONOTONIC, seconds.
#[derive(Serialize)]
struct Happened {
    kind: Kind,
    from_s: f64,
    until_s: f64,
}

/// Plays the scenario's hardware until its end, or until a signal.
pub fn run(sim: Sim, duration: f64, options: &Options<'_>, json: bool) -> Result<()> {
    let plan = options.faults.map(Plan::load).transpose()?;
    let header = "stamp_s,x_m,y_m,theta_rad";
    let truth = options.truth.map(|path| Written::create(path, header));
    let mut devices = Devices::new(&sim, plan.unwrap_or_default(), options, truth.transpose()?)?;
    folder::write(&sim, options)?;
    let stop = Stop::on_signals()?;
    let folder = options.folder.display();
    eprintln!("the devices are there: mirrorball run --robot {folder}");
    let mut world = World::start(sim, options.own_path)?;
    be_hardware();
    let began = world.began();
    while !stop.is_raised() && hw::now() - began < duration {
        let Some(due) = world.next(|now| devices.wheels.wanted(now))? else {
            break;
        };
        sleep_until(due.at);
        devices.pass(due, hw::now() - began)?;
    }
    let outcome = Outcome {
        folder: options.folder.to_owned(),
        seconds: hw::now() - began,
        slipped_s: world.slipped(),
        commands: devices.wheels.audit(),
        faults: devices.happened(began),
    };
    drop(world);
    devices.truth.take().map_or(Ok(()), Written::finish)?;
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
fn be_hardware() {
    // What may not is late now and then, and works all the same.
    let _may = hw::realtime::set_priority(1);
}

fn sleep_until(stamp: Stamp) {
    let left = stamp - hw::now();
    if left > 0.0 {
        std::thread::sleep(std::time::Duration::from_secs_f64(left));
    }
}
