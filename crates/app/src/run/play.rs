//! What happens between start and stop? What devices deliver goes through the spine; the wheels stop before all else ends.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};
use hw::camera::CameraFrame;
use hw::{Base, Devices, Event, HardwareConfig, Inbox};
use localize::Stamp;

use super::helm::Helm;
use super::keeper::Keeper;
use super::outside::{self, Outside};
use super::patrol::Patrol;
use super::robot::Robot;
use super::status::{Remarks, Report, Status};
use super::stop::Stop;
use super::{Args, teleop};
use crate::run::raw_image::raw_image;
use pipeline::cycle::{Cycle, SPINE_FILE, Spine, SpineConfig};
use pipeline::feed::Feed;
use pipeline::log::{Header, LogConfig};
use pipeline::result_files::Outputs;
use pipeline::sample::{Content, Frame, Picture, Sample};

/// Samples that may wait for the spine: more than a second of every device.
const WAITING_MAX: usize = 1024;
/// Longest wait for something to arrive: how soon a stop is noticed.
const PATIENCE: Duration = Duration::from_millis(20);
/// Without a frame for so long the spine goes on without sight, seconds, and again after as long: six frames at 30 Hz.
const BLIND: f64 = 0.2;
/// How long the bus has to take the last stop.
const LAST_WORD: Duration = Duration::from_millis(300);
/// Freed memory that is kept for the next frames, bytes: some images and a log's chunks.
const KEPT_BYTES: i32 = 32 << 20;
/// Cycles that may wait to be written as poses.
const POSES_WAITING: usize = 300;

/// A run that is set up.
pub(super) struct Play {
    robot: Robot,
    spine: Spine,
    keeper: Option<Keeper>,
    poses: Option<Poses>,
    feed: Feed,
    helm: Helm,
    outside: Outside,
    patrol: Option<Patrol>,
    teleop: bool,
    realtime: Option<i32>,
    duration: f64,
}

impl Play {
    /// Reads and builds everything; whatever cannot be is an error now.
    pub(super) fn new(
        args: &Args,
        robot: Robot,
        patrol: Option<Patrol>,
        feed: Feed,
    ) -> Result<Self> {
        let config = SpineConfig::load(&args.preset, args.config.as_deref())?;
        let spine = Spine::new(&robot.setup, &config)?;
        let log_config = LogConfig {
            images: args.images,
            ..LogConfig::default()
        };
        let header = header(&robot, &config)?;
        let field = &robot.setup.field;
        let keep = |path: &Path| Keeper::start(path, header.clone(), field, &log_config);
        let keeper = args.record.as_deref().map(keep).transpose()?;
        let helm = Helm::new();
        let network = outside::configured(
            args.network.as_deref(),
            &robot.folder,
            args.live,
            config.team.number,
        )?;
        let outside = Outside::start(&network, &feed, (&header, field), &helm)?;
        let poses = args.out.as_deref().map(Poses::start).transpose()?;
        Ok(Play {
            robot,
            spine,
            keeper,
            poses,
            feed,
            helm,
            outside,
            patrol,
            teleop: args.teleop,
            realtime: args.realtime,
            duration: args.duration.unwrap_or(f64::INFINITY),
        })
    }

    /// Plays until the end is asked for.
    pub(super) fn run(mut self, stop: &Stop) -> Result<Report> {
        let mut status = Status::new();
        // Threads take over the priority of the one that starts them: those of log and network were started before.
        hw::realtime::be_prompt();
        hw::realtime::keep_memory(KEPT_BYTES);
        if let Some(priority) = self.realtime {
            let _told = hw::realtime::set_priority(priority)
                .inspect_err(|error| status.say(&format!("no real-time priority: {error}")));
            let _told = hw::realtime::lock_memory()
                .inspect_err(|error| status.say(&format!("memory is not locked: {error}")));
        }
        let inbox = Inbox::new(WAITING_MAX);
        let devices = Devices::start(&self.robot.hardware, &self.robot.setup.robot, &inbox)?;
        self.helm.attach(devices.base.as_ref().map(Base::helm));
        let driver = self.start_driver(stop)?;
        status.say(&welcome(&self.robot.hardware, self.teleop));
        let mut watch = Watch::new();
        while !stop.is_raised() && status.elapsed() < self.duration {
            if let Some(event) = inbox.take(PATIENCE) {
                self.take(event, &mut watch, &mut status);
            }
            if let Some(frame) = watch.blind(hw::now()) {
                self.turn(Sample::Frame(frame), &mut watch, &mut status);
            }
            status.glance(watch.last.as_deref(), || devices.health());
        }
        let wheels_stopped = self.helm.close(LAST_WORD);
        let commands = self.outside.commands();
        stop.raise();
        let health = devices.health();
        drop(devices);
        if let Some(driver) = driver {
            // A driver that panicked has said why; its wheels stand.
            let _ended = driver.join();
        }
        if let Some(fault) = self.poses.and_then(Poses::finish) {
            status.log(&fault);
        }
        let kept = self.keeper.map(|keeper| {
            let (kept, fault) = keeper.finish();
            if let Some(fault) = fault {
                status.log(&fault);
            }
            kept
        });
        let lost = (inbox.dropped(), watch.refused);
        Ok(status.report(lost, (wheels_stopped, commands), health, kept))
    }

    fn start_driver(&mut self, stop: &Stop) -> Result<Option<JoinHandle<()>>> {
        let (helm, stop) = (self.helm.clone(), stop.clone());
        let name = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let started = match (self.patrol.take(), self.teleop) {
            (Some(patrol), _) => name("patrol").spawn(move || patrol.drive(&helm, &stop)),
            (None, true) => name("teleop").spawn(move || {
                if let Err(error) = teleop::drive(&helm, &stop) {
                    eprintln!("mirrorball: {error:#}");
                    stop.raise();
                }
            }),
            (None, false) => return Ok(None),
        };
        started
            .map(Some)
            .context("cannot start the driver's thread")
    }

    fn take(&mut self, event: Event, watch: &mut Watch, status: &mut Status) {
        let sample = match event {
            Event::Frame(frame) => Sample::Frame(watch.frame(frame)),
            Event::Odometry(odometry) => Sample::Odometry(odometry),
            Event::Command(command) => Sample::Command(command),
            Event::Imu(imu) => Sample::Imu(imu),
            Event::Compass(compass) => Sample::Compass(compass),
            Event::Health(health) => {
                let text = status.device(&health);
                self.note(&text);
                return;
            }
            event => {
                if let Some(text) = watch.remarks.of(&event) {
                    status.say(&text);
                    self.note(&text);
                }
                return;
            }
        };
        if is_number(&sample) {
            self.turn(sample, watch, status);
        } else {
            watch.refused += 1;
        }
    }

    fn turn(&mut self, sample: Sample, watch: &mut Watch, status: &mut Status) {
        let taken = hw::now();
        if matches!(sample, Sample::Frame(_)) {
            for report in self.outside.reports() {
                self.spine.take(Sample::Report(report));
            }
        }
        let Some(cycle) = self.spine.take(sample) else {
            return;
        };
        self.helm.publish(cycle.stamp, cycle.estimate.pose);
        let published = hw::now();
        status.cycle(&cycle, taken, published);
        let cycle = Arc::new(cycle);
        self.feed.publish(&cycle);
        if let Some(poses) = &self.poses {
            poses.cycle(&cycle);
        }
        if let Some(text) = self
            .keeper
            .as_mut()
            .and_then(|keeper| keeper.cycle(cycle.clone()))
        {
            status.log(&text);
        }
        watch.last = Some(cycle);
    }

    fn note(&self, text: &str) {
        if let Some(keeper) = &self.keeper {
            keeper.note(hw::now(), text);
        }
    }
}

/// What log and stream say of this run before its first cycle.
fn header(robot: &Robot, config: &SpineConfig) -> Result<Header> {
    let setup = &robot.setup;
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new(&format!("run {}", robot.folder.display()), None)
        .with_robot(&setup.robot, map, setup.colours.as_ref())?
        .with_file(SPINE_FILE, toml::to_string(config)?)
        .with_file("hardware.toml", toml::to_string(&robot.hardware)?);
    Ok(header)
}

fn welcome(hardware: &HardwareConfig, teleop: bool) -> String {
    let mut names: Vec<&str> = Vec::new();
    names.extend(
        hardware
            .camera
            .as_ref()
            .map(|camera| camera.device.as_str()),
    );
    names.extend(hardware.base.as_ref().map(|base| base.port.as_str()));
    names.extend(hardware.inertial.iter().map(|one| one.port.as_str()));
    let help = if teleop {
        format!("\n{}", teleop::HELP)
    } else {
        String::new()
    };
    format!("playing with {}{help}", names.join(", "))
}

/// What the loop remembers from event to event.
struct Watch {
    last: Option<Arc<Cycle>>,
    /// When the last frame came, or its absence was last made up for.
    framed: Stamp,
    remarks: Remarks,
    /// Samples that were no numbers.
    refused: u64,
}

impl Watch {
    fn new() -> Self {
        Watch {
            last: None,
            framed: hw::now(),
            remarks: Remarks::default(),
            refused: 0,
        }
    }

    fn frame(&mut self, frame: CameraFrame) -> Frame {
        self.framed = hw::now();
        let stamp = frame.stamp;
        // A picture of the past says nothing about where the robot is now.
        let content = if frame.repeated {
            Content::Unreadable("the camera repeats its image".to_owned())
        } else {
            Content::Image(Picture::Raw(raw_image(frame)))
        };
        Frame { stamp, content }
    }

    /// In place of a frame that does not come: odometry carries the pose on.
    fn blind(&mut self, now: Stamp) -> Option<Frame> {
        if now - self.framed < BLIND {
            return None;
        }
        self.framed = now;
        Some(Frame {
            stamp: now,
            content: Content::Unreadable("no frame from the camera".to_owned()),
        })
    }
}

fn is_number(sample: &Sample) -> bool {
    match sample {
        Sample::Odometry(odometry) => (odometry.dx + odometry.dy + odometry.dtheta).is_finite(),
        Sample::Compass(compass) => compass.heading.is_finite(),
        Sample::Imu(imu) => imu
            .acceleration
            .iter()
            .chain(&imu.rate)
            .all(|value| value.is_finite()),
        Sample::Command(_) | Sample::Report(_) | Sample::Truth(_) | Sample::Frame(_) => true,
    }
}

/// The table of poses, written by a thread of its own.
struct Poses {
    waiting: SyncSender<Arc<Cycle>>,
    thread: JoinHandle<Result<()>>,
}

impl Poses {
    fn start(path: &Path) -> Result<Self> {
        let mut outputs = Outputs::create(Some(path), None, None)?;
        let (waiting, cycles): (_, Receiver<Arc<Cycle>>) = sync_channel(POSES_WAITING);
        let write = move || {
            for cycle in cycles {
                outputs.write(&cycle)?;
            }
            outputs.finish()
        };
        let thread = std::thread::Builder::new()
            .name("poses".to_owned())
            .spawn(write)?;
        Ok(Poses { waiting, thread })
    }

    fn cycle(&self, cycle: &Arc<Cycle>) {
        // A disk too slow for a line of text a frame costs the line.
        let _full = self.waiting.try_send(Arc::clone(cycle));
    }

    fn finish(self) -> Option<String> {
        drop(self.waiting);
        match self.thread.join() {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(format!("the poses were not written: {error:#}")),
            Err(_) => Some("the poses were not written".to_owned()),
        }
    }
}
