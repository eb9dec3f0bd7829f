//! What does each virtual device say when? Samples of the simulation in their wire formats, and the faults that are on.

use anyhow::{Context, Result};
use hw::camera::Encoding;
use localize::Stamp;
use localize::omni::OmniKinematics;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::Sim;

use super::base::Base;
use super::camera::{Camera, Shot};
use super::faults::{Fault, Kind, Plan};
use super::inertial::{Damage, Units};
use super::line::Line;
use super::world::Due;
use super::{Happened, Options, folder};
use pipeline::csv_table::{Written, seconds};

/// Where the wheels' counters stand at the start: they wrap in every run, after five turns of a wheel.
const COUNT_FIRST: u32 = 0u32.wrapping_sub(20_000);
/// Bytes of noise for one message of a line that carries nothing else.
const NOISE_BYTES: usize = 23;
/// One byte in so many is wrong on a noisy line.
const BYTES_PER_ERROR: u32 = 200;

/// All devices of the virtual robot.
pub(super) struct Devices {
    base: Line,
    wit: Line,
    bno085: Line,
    camera: Camera,
    pub(super) wheels: Base,
    units: Units,
    plan: Plan,
    pub(super) truth: Option<Written>,
    /// What the inertial unit said last, for one that is stuck.
    last_inertia: Vec<u8>,
    last_image: Option<Shot>,
    halves_sent: usize,
    restarts: usize,
    chance: ChaCha8Rng,
}

impl Devices {
    pub(super) fn new(
        sim: &Sim,
        plan: Plan,
        options: &Options<'_>,
        truth: Option<Written>,
    ) -> Result<Self> {
        let at = options.folder;
        std::fs::create_dir_all(at).with_context(|| format!("cannot make {}", at.display()))?;
        let base = sim.robot().base.clone().unwrap_or_default();
        let angles: Vec<f32> = base
            .wheel_angles_deg
            .iter()
            .map(|angle| angle.to_radians())
            .collect();
        let omni = OmniKinematics::new(&angles, base.wheel_radius, base.wheel_distance)?;
        let encoding = match options.format {
            "YUYV" => Encoding::Yuyv,
            _ => Encoding::Rgb8,
        };
        Ok(Devices {
            base: Line::plugged(&at.join(folder::BASE))?,
            wit: Line::plugged(&at.join(folder::WIT))?,
            bno085: Line::plugged(&at.join(folder::BNO085))?,
            camera: Camera::plugged(&at.join(folder::CAMERA), encoding)?,
            wheels: Base::new(options.bus, omni, base.ticks_per_turn),
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
    pub(super) fn pass(&mut self, due: Due, time: f64) -> Result<()> {
        self.plug(time)?;
        let answers = self.wheels.hear(&self.base.received(), hw::now());
        self.say_base(&answers, time);
        let at = due.at;
        match due.sample {
            sim::SimSample::Odometry(_) => self.encoders(&due.turned, at, time),
            sim::SimSample::Imu(imu) => {
                let inertia = self.wheels.inertia(&imu, self.board_time(at, time));
                self.say_base(&inertia, time);
                self.inertia(&imu, time);
            }
            sim::SimSample::Compass(compass) => {
                let heading = self.wheels.heading(&compass, self.board_time(at, time));
                self.say_base(&heading, time);
                if !self.plan.is_on(Kind::ImuGarbage, time) {
                    self.wit.send(&Units::wit_angle(&compass));
                }
            }
            sim::SimSample::Image(image) => self.image(image, at, time),
            sim::SimSample::Truth(truth) => {
                if let Some(file) = &mut self.truth {
                    let (stamp, pose) = (seconds(at), truth.robot.pose);
                    file.row(format_args!(
                        "{stamp},{:.5},{:.5},{:.6}",
                        pose.x, pose.y, pose.theta
                    ))?;
                }
            }
            sim::SimSample::Command(_) => {}
        }
        Ok(())
    }

    /// Pulls out and puts in what the plan says.
    fn plug(&mut self, time: f64) -> Result<()> {
        if self.plan.is_on(Kind::BaseUnplugged, time) {
            self.base.unplug()?;
            self.wheels.plugged_anew();
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
    fn board_time(&self, at: Stamp, time: f64) -> u32 {
        let step = self.plan.on(Kind::BaseClock, time);
        let stamp = at + step.map_or(0.0, |fault| fault.step);
        // Wraps after 71 minutes, as the board's does.
        (stamp.0 / 1000) as u32
    }

    fn encoders(&mut self, turned: &[f64], at: Stamp, time: f64) {
        let restarts = self.plan.begun(Kind::BaseRestarts, time);
        let restarted = restarts > std::mem::replace(&mut self.restarts, restarts);
        let time_us = self.board_time(at, time);
        let said = match &mut self.wheels {
            Base::Board(board) => board.report(time, time_us, turned, COUNT_FIRST, restarted),
            Base::Vescs(vescs) => vescs.report(turned, COUNT_FIRST, at),
        };
        self.say_base(&said, time);
    }

    fn say_base(&mut self, message: &[u8], time: f64) {
        if message.is_empty() || self.plan.is_on(Kind::BaseSilent, time) {
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

    fn image(&mut self, image: sim::simulation::SimImage, at: Stamp, time: f64) {
        let off = self.plan.on(Kind::CameraClock, time);
        let mut shot = Shot {
            stamp_ns: (at + off.map_or(0.0, |fault| fault.step)).0,
            size_px: [image.width_px, image.height_px],
            rgb: std::sync::Arc::new(image.rgb),
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

    pub(super) fn happened(&self, began: Stamp) -> Vec<Happened> {
        let happened = |fault: &Fault| Happened {
            kind: fault.kind,
            from_s: (began + fault.at).seconds(),
            until_s: (began + fault.at + fault.lasts).seconds(),
        };
        self.plan.faults.iter().map(happened).collect()
    }
}
