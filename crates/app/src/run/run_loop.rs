//! What happens between start and stop? What devices deliver goes through the spine; the wheels stop before all else ends.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};
use hw::camera::CapturedImage;
use hw::{BaseDriver, DeviceEvent, Devices, EventQueue, HardwareConfig};
use localize::Stamp;

use super::command_arbiter::CommandArbiter;
use super::log_rotation::LogRotation;
use super::network::{self, RunNetwork};
use super::patrol::Patrol;
use super::robot_folder::RobotFolder;
use super::status::{OperatorNotices, RunReport, RunStatus};
use super::stop_flag::StopFlag;
use super::{Args, teleop};
use crate::run::raw_image::raw_image;
use pipeline::config::PIPELINE_FILE;
use pipeline::feed::Feed;
use pipeline::log::{Header, LogConfig};
use pipeline::result_files::CsvOutputs;
use pipeline::sample::{CameraImage, ImageContent, Sample, SourceImage};
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Samples that may wait for the spine: more than a second of every device.
const EVENT_QUEUE_CAPACITY: usize = 1024;
/// Longest wait for something to arrive: how soon a stop is noticed.
const EVENT_TIMEOUT: Duration = Duration::from_millis(20);
/// Without a frame for so long the spine goes on without sight, seconds, and again after as long: six frames at 30 Hz.
const IMAGE_TIMEOUT: f64 = 0.2;
/// How long the bus has to take the last stop.
const STOP_TIMEOUT: Duration = Duration::from_millis(300);
/// Freed memory that is kept for the next frames, bytes: some images and a log's chunks.
const RETAINED_BYTES: i32 = 32 << 20;
/// Cycles that may wait to be written as poses.
const POSE_QUEUE_CAPACITY: usize = 300;

/// A run that is set up.
pub(super) struct RunLoop {
    robot: RobotFolder,
    pipeline: Pipeline,
    log: Option<LogRotation>,
    pose_writer: Option<PoseWriter>,
    feed: Feed,
    arbiter: CommandArbiter,
    network: RunNetwork,
    patrol: Option<Patrol>,
    teleop: bool,
    realtime: Option<i32>,
    duration: f64,
}

impl RunLoop {
    /// Reads and builds everything; whatever cannot be is an error now.
    pub(super) fn new(
        args: &Args,
        robot: RobotFolder,
        patrol: Option<Patrol>,
        feed: Feed,
    ) -> Result<Self> {
        let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
        let spine = Pipeline::new(&robot.setup, &config)?;
        if let Some(notice) = spine.notice() {
            eprintln!("{notice}");
        }
        let log_config = LogConfig {
            images: args.images,
            ..LogConfig::default()
        };
        let header = header(&robot, &config)?;
        let field = &robot.setup.field;
        let keep = |path: &Path| LogRotation::start(path, header.clone(), field, &log_config);
        let keeper = args.record.as_deref().map(keep).transpose()?;
        let helm = CommandArbiter::new();
        let network = network::load_config(
            args.network.as_deref(),
            &robot.folder,
            args.live,
            config.team.number,
        )?;
        let outside = RunNetwork::start(&network, &feed, (&header, field), &helm)?;
        let poses = args.out.as_deref().map(PoseWriter::start).transpose()?;
        Ok(RunLoop {
            robot,
            pipeline: spine,
            log: keeper,
            pose_writer: poses,
            feed,
            arbiter: helm,
            network: outside,
            patrol,
            teleop: args.teleop,
            realtime: args.realtime,
            duration: args.duration.unwrap_or(f64::INFINITY),
        })
    }

    /// Plays until the end is asked for.
    pub(super) fn run(mut self, stop: &StopFlag) -> Result<RunReport> {
        let mut status = RunStatus::new();
        // Threads take over the priority of the one that starts them: those of log and network were started before.
        hw::realtime::request_low_latency();
        hw::realtime::retain_freed_memory(RETAINED_BYTES);
        if let Some(priority) = self.realtime {
            let _told = hw::realtime::set_realtime_priority(priority)
                .inspect_err(|error| status.print_line(&format!("no real-time priority: {error}")));
            let _told = hw::realtime::lock_memory()
                .inspect_err(|error| status.print_line(&format!("memory is not locked: {error}")));
        }
        let inbox = EventQueue::new(EVENT_QUEUE_CAPACITY);
        let devices = Devices::start(&self.robot.hardware, &self.robot.setup.robot, &inbox)?;
        self.arbiter
            .attach_base(devices.base.as_ref().map(BaseDriver::handle));
        let driver = self.start_motion_thread(stop)?;
        status.print_line(&start_message(&self.robot.hardware, self.teleop));
        let mut watch = RunState::new();
        while !stop.is_raised() && status.elapsed() < self.duration {
            if let Some(event) = inbox.pop_timeout(EVENT_TIMEOUT) {
                self.handle_event(event, &mut watch, &mut status);
            }
            if let Some(frame) = watch.missing_image(hw::now()) {
                self.process_sample(Sample::Image(frame), &mut watch, &mut status);
            }
            status.update_status_line(watch.last_cycle.as_deref(), || devices.health());
        }
        let wheels_stopped = self.arbiter.close(STOP_TIMEOUT);
        let commands = self.network.command_counts();
        stop.raise();
        let health = devices.health();
        drop(devices);
        if let Some(driver) = driver {
            // A driver that panicked has said why; its wheels stand.
            let _ended = driver.join();
        }
        if let Some(fault) = self.pose_writer.and_then(PoseWriter::finish) {
            status.report_log_change(&fault);
        }
        let kept = self.log.map(|keeper| {
            let (kept, fault) = keeper.finish();
            if let Some(fault) = fault {
                status.report_log_change(&fault);
            }
            kept
        });
        let lost = (inbox.drop_counts(), watch.samples_refused);
        Ok(status.into_report(lost, (wheels_stopped, commands), health, kept))
    }

    fn start_motion_thread(&mut self, stop: &StopFlag) -> Result<Option<JoinHandle<()>>> {
        let (helm, stop) = (self.arbiter.clone(), stop.clone());
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

    fn handle_event(&mut self, event: DeviceEvent, watch: &mut RunState, status: &mut RunStatus) {
        let sample = match event {
            DeviceEvent::Image(frame) => Sample::Image(watch.camera_image(frame)),
            DeviceEvent::Odometry(odometry) => Sample::Odometry(odometry),
            DeviceEvent::Command(command) => Sample::Command(command),
            DeviceEvent::Imu(imu) => Sample::Imu(imu),
            DeviceEvent::Compass(compass) => Sample::Compass(compass),
            DeviceEvent::Health(health) => {
                let text = status.report_device(&health);
                self.write_note(&text);
                return;
            }
            event => {
                if let Some(text) = watch.notices.update(&event) {
                    status.print_line(&text);
                    self.write_note(&text);
                }
                return;
            }
        };
        if is_finite(&sample) {
            self.process_sample(sample, watch, status);
        } else {
            watch.samples_refused += 1;
        }
    }

    fn process_sample(&mut self, sample: Sample, watch: &mut RunState, status: &mut RunStatus) {
        let taken = hw::now();
        if matches!(sample, Sample::Image(_)) {
            for report in self.network.team_reports() {
                self.pipeline.process_sample(Sample::TeamReport(report));
            }
        }
        let Some(cycle) = self.pipeline.process_sample(sample) else {
            return;
        };
        self.arbiter.set_pose(cycle.stamp, cycle.estimate.pose);
        let published = hw::now();
        status.count_cycle(&cycle, taken, published);
        let cycle = Arc::new(cycle);
        self.feed.publish(&cycle);
        if let Some(poses) = &self.pose_writer {
            poses.write_cycle(&cycle);
        }
        if let Some(text) = self
            .log
            .as_mut()
            .and_then(|keeper| keeper.write_cycle(cycle.clone()))
        {
            status.report_log_change(&text);
        }
        watch.last_cycle = Some(cycle);
    }

    fn write_note(&self, text: &str) {
        if let Some(keeper) = &self.log {
            keeper.write_note(hw::now(), text);
        }
    }
}

/// What log and stream say of this run before its first cycle.
fn header(robot: &RobotFolder, config: &PipelineConfig) -> Result<Header> {
    let setup = &robot.setup;
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new(&format!("run {}", robot.folder.display()), None)
        .with_robot(&setup.robot, map, setup.colours.as_ref())?
        .with_file(PIPELINE_FILE, toml::to_string(config)?)
        .with_file("hardware.toml", toml::to_string(&robot.hardware)?);
    Ok(header)
}

fn start_message(hardware: &HardwareConfig, teleop: bool) -> String {
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
struct RunState {
    last_cycle: Option<Arc<Cycle>>,
    /// When the last frame came, or its absence was last made up for.
    last_image: Stamp,
    notices: OperatorNotices,
    /// Samples that were no numbers.
    samples_refused: u64,
}

impl RunState {
    fn new() -> Self {
        RunState {
            last_cycle: None,
            last_image: hw::now(),
            notices: OperatorNotices::default(),
            samples_refused: 0,
        }
    }

    fn camera_image(&mut self, frame: CapturedImage) -> CameraImage {
        self.last_image = hw::now();
        let stamp = frame.stamp;
        // A picture of the past says nothing about where the robot is now.
        let content = if frame.repeated {
            ImageContent::Unreadable("the camera repeats its image".to_owned())
        } else {
            ImageContent::Pixels(SourceImage::Raw(raw_image(frame)))
        };
        CameraImage { stamp, content }
    }

    /// In place of a frame that does not come: odometry carries the pose on.
    fn missing_image(&mut self, now: Stamp) -> Option<CameraImage> {
        if now - self.last_image < IMAGE_TIMEOUT {
            return None;
        }
        self.last_image = now;
        Some(CameraImage {
            stamp: now,
            content: ImageContent::Unreadable("no frame from the camera".to_owned()),
        })
    }
}

fn is_finite(sample: &Sample) -> bool {
    match sample {
        Sample::Odometry(odometry) => (odometry.dx + odometry.dy + odometry.dtheta).is_finite(),
        Sample::Compass(compass) => compass.heading.is_finite(),
        Sample::Imu(imu) => imu
            .acceleration
            .iter()
            .chain(&imu.rate)
            .all(|value| value.is_finite()),
        Sample::Command(_) | Sample::TeamReport(_) | Sample::GroundTruth(_) | Sample::Image(_) => {
            true
        }
    }
}

/// The table of poses, written by a thread of its own.
struct PoseWriter {
    queue: SyncSender<Arc<Cycle>>,
    thread: JoinHandle<Result<()>>,
}

impl PoseWriter {
    fn start(path: &Path) -> Result<Self> {
        let mut outputs = CsvOutputs::create(Some(path), None, None)?;
        let (waiting, cycles): (_, Receiver<Arc<Cycle>>) = sync_channel(POSE_QUEUE_CAPACITY);
        let write = move || {
            for cycle in cycles {
                outputs.write(&cycle)?;
            }
            outputs.finish()
        };
        let thread = std::thread::Builder::new()
            .name("poses".to_owned())
            .spawn(write)?;
        Ok(PoseWriter {
            queue: waiting,
            thread,
        })
    }

    fn write_cycle(&self, cycle: &Arc<Cycle>) {
        // A disk too slow for a line of text a frame costs the line.
        let _full = self.queue.try_send(Arc::clone(cycle));
    }

    fn finish(self) -> Option<String> {
        drop(self.queue);
        match self.thread.join() {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(format!("the poses were not written: {error:#}")),
            Err(_) => Some("the poses were not written".to_owned()),
        }
    }
}
