//! `mirrorball sim --hardware`: what would the robot's devices say? Pseudo terminals and a camera socket in real time, so that
//! `mirrorball run` drives the simulated robot unchanged.

mod board;
mod camera;
mod faults;
mod inertial;
mod line;
mod world;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use hw::camera::Encoding;
use localize::Stamp;
use localize::omni::Omni;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use sim::Sim;

use crate::run::stop::Stop;
use crate::table::{Written, seconds};
use board::{Audit, Board};
use camera::{Camera, Shot};
use faults::{Fault, Kind, Plan};
use inertial::{Damage, Units};
use line::Line;
use world::{Due, World};

/// Names of the devices in the folder.
const BASE: &str = "base";
const WIT: &str = "wit";
const BNO085: &str = "bno085";
const CAMERA: &str = "camera";
/// Where the wheels' counters stand at the start: they wrap in every run, after five turns of a wheel.
const COUNT_FIRST: u32 = 0u32.wrapping_sub(20_000);
/// Bytes of noise for one message of a line that carries nothing else.
const NOISE_BYTES: usize = 23;
/// One byte in so many is wrong on a noisy line.
const BYTES_PER_ERROR: u32 = 200;

/// What the devices are made from.
pub struct Options<'a> {
    /// Where the devices' names lie.
    pub folder: &'a Path,
    /// What fails when (TOML).
    pub faults: Option<&'a Path>,
    /// The scenario's path moves the robot, whatever the wheels are told.
    pub own_path: bool,
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
    write_robot(&sim, options)?;
    let stop = Stop::on_signals()?;
    let folder = options.folder.display();
    eprintln!("the devices are there: mirrorball run --robot {folder}");
    let mut world = World::start(sim, options.own_path)?;
    let began = world.began();
    while !stop.is_raised() && hw::now() - began < duration {
        let Some(due) = world.next(|now| devices.board.wanted(now))? else {
            break;
        };
        sleep_until(due.at);
        devices.pass(&due, hw::now() - began)?;
    }
    let outcome = Outcome {
        folder: options.folder.to_owned(),
        seconds: hw::now() - began,
        slipped_s: world.slipped(),
        commands: devices.board.audit,
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

fn sleep_until(stamp: Stamp) {
    let left = stamp - hw::now();
    if left > 0.0 {
        std::thread::sleep(std::time::Duration::from_secs_f64(left));
    }
}

/// All devices of the virtual robot.
struct Devices {
    base: Line,
    wit: Line,
    bno085: Line,
    camera: Camera,
    board: Board,
    units: Units,
    plan: Plan,
    truth: Option<Written>,
    /// What the inertial unit said last, for one that is stuck.
    last_inertia: Vec<u8>,
    last_image: Option<Shot>,
    halves_sent: usize,
    restarts: usize,
    chance: ChaCha8Rng,
}

impl Devices {
    fn new(sim: &Sim, plan: Plan, options: &Options<'_>, truth: Option<Written>) -> Result<Self> {
        let folder = options.folder;
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        let base = sim.robot().base.clone().unwrap_or_default();
        let angles: Vec<f32> = base
            .wheel_angles_deg
            .iter()
            .map(|angle| angle.to_radians())
            .collect();
        let omni = Omni::new(&angles, base.wheel_radius, base.wheel_distance)?;
        let encoding = match options.format {
            "YUYV" => Encoding::Yuyv,
            _ => Encoding::Rgb8,
        };
        Ok(Devices {
            base: Line::plugged(&folder.join(BASE))?,
            wit: Line::plugged(&folder.join(WIT))?,
            bno085: Line::plugged(&folder.join(BNO085))?,
            camera: Camera::plugged(&folder.join(CAMERA), encoding)?,
            board: Board::new(omni, base.ticks_per_turn),
            units: Units::default(),
            plan,
            truth,
            last_inertia: Vec::new(),
            last_image: None,
            halves_sent: 0,
            restarts: 0,
            chance: ChaCha8Rng::seed_from_u64(sim.scenario().seed),
        })
    }

    /// Lets a device say what is due; `time` is since the start.
    fn pass(&mut self, due: &Due, time: f64) -> Result<()> {
        self.plug(time)?;
        self.board.hear(&self.base.received(), hw::now());
        match &due.sample {
            sim::Sample::Odometry(_) => self.encoders(due, time),
            sim::Sample::Imu(imu) => {
                let inertia = self.board.inertia(imu, self.board_time(due, time));
                self.say_base(&inertia, time);
                self.inertia(imu, time);
            }
            sim::Sample::Compass(compass) => {
                let heading = self.board.heading(compass, self.board_time(due, time));
                self.say_base(&heading, time);
                if !self.plan.is_on(Kind::ImuGarbage, time) {
                    self.wit.send(&Units::wit_angle(compass));
                }
            }
            sim::Sample::Image(image) => self.image(image, due.at, time),
            sim::Sample::Truth(truth) => {
                if let Some(file) = &mut self.truth {
                    let (stamp, pose) = (seconds(due.at), truth.robot.pose);
                    file.row(format_args!(
                        "{stamp},{:.5},{:.5},{:.6}",
                        pose.x, pose.y, pose.theta
                    ))?;
                }
            }
            sim::Sample::Command(_) => {}
        }
        Ok(())
    }

    /// Pulls out and puts in what the plan says.
    fn plug(&mut self, time: f64) -> Result<()> {
        if self.plan.is_on(Kind::BaseUnplugged, time) {
            self.base.unplug()?;
            self.board.plugged_anew();
        } else {
            self.base.plug()?;
        }
        if self.plan.is_on(Kind::ImuUnplugged, time) {
            self.wit.unplug()?;
        } else {
            self.wit.plug()?;
        }
        self.camera
            .set_unplugged(self.plan.is_on(Kind::CameraUnplugged, time));
        Ok(())
    }

    /// The board's clock, µs.
    fn board_time(&self, due: &Due, time: f64) -> u32 {
        let step = self.plan.on(Kind::BaseClock, time);
        let stamp = due.at + step.map_or(0.0, |fault| fault.step);
        // Wraps after 71 minutes, as the board's does.
        (stamp.0 / 1000) as u32
    }

    fn encoders(&mut self, due: &Due, time: f64) {
        let restarts = self.plan.begun(Kind::BaseRestarts, time);
        let restarted = restarts > std::mem::replace(&mut self.restarts, restarts);
        let time_us = self.board_time(due, time);
        let said = self
            .board
            .report(time, time_us, &due.turned, COUNT_FIRST, restarted);
        self.say_base(&said, time);
    }

    fn say_base(&mut self, message: &[u8], time: f64) {
        if self.plan.is_on(Kind::BaseSilent, time) {
            return;
        }
        let mut bytes = message.to_vec();
        if self.plan.is_on(Kind::BaseGarbage, time) {
            bytes = self.noise();
        }
        if self.plan.is_on(Kind::BaseNoise, time) {
            for byte in &mut bytes {
                if self.chance.random_range(0..BYTES_PER_ERROR) == 0 {
                    *byte ^= 1 << self.chance.random_range(0..8u32);
                }
            }
        }
        self.base.send(&bytes);
    }

    fn noise(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; NOISE_BYTES];
        self.chance.fill_bytes(&mut bytes);
        bytes
    }

    fn inertia(&mut self, imu: &localize::sample::Imu, time: f64) {
        let said = self.units.bno085(imu);
        self.bno085.send(&said);
        if self.plan.is_on(Kind::ImuGarbage, time) {
            let noise = self.noise();
            return self.wit.send(&noise);
        }
        if !self.plan.is_on(Kind::ImuStuck, time) {
            let damage = if self.plan.is_on(Kind::ImuNan, time) {
                Damage::Range
            } else {
                Damage::None
            };
            self.last_inertia = Units::wit(imu, damage);
        }
        self.wit.send(&self.last_inertia);
    }

    fn image(&mut self, image: &sim::simulation::Image, at: Stamp, time: f64) {
        let off = self.plan.on(Kind::CameraClock, time);
        let mut shot = Shot {
            stamp_ns: (at + off.map_or(0.0, |fault| fault.step)).0,
            size_px: [image.width_px, image.height_px],
            rgb: std::sync::Arc::new(image.rgb.clone()),
            cut: None,
        };
        if self.plan.is_on(Kind::CameraSilent, time) {
            return;
        }
        if self.plan.is_on(Kind::CameraHalfFrame, time) {
            let begun = self.plan.begun(Kind::CameraHalfFrame, time);
            if begun == self.halves_sent {
                return;
            }
            self.halves_sent = begun;
            shot.cut = Some(0.5);
        }
        if self.plan.is_on(Kind::CameraFreezes, time) {
            let frozen = self.last_image.as_ref().unwrap_or(&shot);
            shot.rgb = frozen.rgb.clone();
        }
        self.last_image = Some(shot.clone());
        self.camera.shoot(shot);
    }

    fn happened(&self, began: Stamp) -> Vec<Happened> {
        let happened = |fault: &Fault| Happened {
            kind: fault.kind,
            from_s: (began + fault.at).seconds(),
            until_s: (began + fault.at + fault.lasts).seconds(),
        };
        self.plan.faults.iter().map(happened).collect()
    }
}

/// Writes robot.toml and hardware.toml beside the devices: the folder is a robot that `run` plays with.
fn write_robot(sim: &Sim, options: &Options<'_>) -> Result<()> {
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
    let hardware = format!(
        "# The virtual robot of `mirrorball sim --hardware`; its devices lie beside this file.\n\
         [camera]\ndevice = \"unix:./{CAMERA}\"\nrate_hz = {rate_hz:?}\n\n\
         [base]\nbus = \"board\"\nport = \"./{BASE}\"\n\n\
         [[inertial]]\nsensor = \"wit\"\nport = \"./{WIT}\"\nimu = true\ncompass = {}\n",
        robot.compass.is_some()
    );
    for (name, text) in [
        ("robot.toml", toml::to_string(&robot)?),
        ("hardware.toml", hardware),
    ] {
        let path = options.folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
