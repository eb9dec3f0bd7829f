//! What happens between start and stop? Samples of devices go through the pipeline; the wheels stop before anything else ends.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};
use hw::camera::CapturedImage;
use hw::{BaseDriver, DeviceEvent, Devices, EventQueue, HardwareConfig};
use localize::Stamp;

use super::arguments::Args;
use super::command_arbiter::CommandArbiter;
use super::log_rotation::LogRotation;
use super::network::{self, RunNetwork};
use super::patrol::Patrol;
use super::raw_image::raw_image;
use super::robot_folder::RobotFolder;
use super::status::{OperatorNotices, RunOutcome, RunReport, RunStatus};
use super::stop_flag::StopFlag;
use super::teleop;
use crate::memory::{self, RUN_RETAINED_BYTES};
use crate::stream::StreamPreamble;
use pipeline::config::PIPELINE_FILE;
use pipeline::feed::Feed;
use pipeline::log::{Header, LogConfig};
use pipeline::result_files::CsvOutputs;
use pipeline::sample::{CameraImage, ImageContent, Sample, SourceImage};
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Capacity of the queue of device events: more than a second of every device.
const EVENT_QUEUE_CAPACITY: usize = 1024;
/// Longest wait for an event: the latency of a stop.
const EVENT_TIMEOUT: Duration = Duration::from_millis(20);
/// Without an image for this time the pipeline runs a cycle without one, seconds: six images at 30 Hz.
const IMAGE_TIMEOUT: f64 = 0.2;
/// Time for the bus to take the last stop command.
const STOP_TIMEOUT: Duration = Duration::from_millis(300);

/// Capacity of the queue of poses to write, cycles.
const POSE_QUEUE_CAPACITY: usize = 300;

/// A run with everything that it needs.
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
    /// Reads the configuration and starts log and network.
    pub(super) fn new(
        args: &Args,
        robot: RobotFolder,
        patrol: Option<Patrol>,
        feed: Feed,
    ) -> Result<Self> {
        let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
        let pipeline = Pipeline::new(&robot.setup, &config)?;
        let log_config = LogConfig {
            images: args.images,
            ..LogConfig::default()
        };
        let header = header(&robot, &config)?;
        let field = &robot.setup.field;
        let start_log = |path: &Path| LogRotation::start(path, header.clone(), field, &log_config);
        let log = args.record.as_deref().map(start_log).transpose()?;
        let arbiter = CommandArbiter::new();
        let network_config = network::load_config(
            args.network.as_deref(),
            &robot.folder,
            args.live,
            config.team.number,
        )?;
        let preamble = StreamPreamble {
            header: &header,
            field,
        };
        let network = RunNetwork::start(&network_config, &feed, preamble, &arbiter)?;
        let pose_writer = args.out.as_deref().map(PoseWriter::start).transpose()?;
        Ok(RunLoop {
            robot,
            pipeline,
            log,
            pose_writer,
            feed,
            arbiter,
            network,
            patrol,
            teleop: args.teleop,
            realtime: args.realtime,
            duration: args.duration.unwrap_or(f64::INFINITY),
        })
    }

    /// Runs until `stop` is raised or the duration has passed.
    pub(super) fn run(mut self, stop: &StopFlag) -> Result<RunReport> {
        let mut status = RunStatus::new();
        // A thread inherits the priority of the thread that starts it. Log and network threads are already running.
        hw::realtime::request_low_latency();
        memory::retain_freed_memory(RUN_RETAINED_BYTES);
        if let Some(priority) = self.realtime {
            let _reported = hw::realtime::set_realtime_priority(priority).inspect_err(|error| {
                status.print_line(&format!("cannot set the real-time priority: {error}"))
            });
            let _reported = hw::realtime::lock_memory()
                .inspect_err(|error| status.print_line(&format!("cannot lock memory: {error}")));
        }
        let events = EventQueue::new(EVENT_QUEUE_CAPACITY);
        let devices = Devices::start(&self.robot.hardware, &self.robot.setup.robot, &events)?;
        self.arbiter
            .attach_base(devices.base.as_ref().map(BaseDriver::handle));
        let motion_thread = self.start_motion_thread(stop)?;
        status.print_line(&start_message(&self.robot.hardware, self.teleop));
        let mut state = RunState::new();
        while !stop.is_raised() && status.elapsed() < self.duration {
            if let Some(event) = events.pop_timeout(EVENT_TIMEOUT) {
                self.handle_event(event, &mut state, &mut status);
            }
            if let Some(image) = state.missing_image(hw::now()) {
                self.process_sample(Sample::Image(image), &mut state, &mut status);
            }
            status.update_status_line(state.last_cycle.as_deref(), || devices.health());
        }
        let wheels_stopped = self.arbiter.close(STOP_TIMEOUT);
        let commands = self.network.command_counts();
        stop.raise();
        let health = devices.health();
        drop(devices);
        if let Some(thread) = motion_thread {
            // A panic has been reported, and the wheels have stopped.
            let _ended = thread.join();
        }
        if let Some(error) = self.pose_writer.and_then(PoseWriter::finish) {
            status.report_log_change(&error);
        }
        let log = self.log.map(|log| {
            let finished = log.finish();
            if let Some(error) = finished.error {
                status.report_log_change(&error);
            }
            finished.summary
        });
        Ok(status.into_report(RunOutcome {
            dropped: events.drop_counts(),
            samples_refused: state.samples_refused,
            wheels_stopped,
            commands,
            devices: health,
            log,
        }))
    }

    fn start_motion_thread(&mut self, stop: &StopFlag) -> Result<Option<JoinHandle<()>>> {
        let (arbiter, stop) = (self.arbiter.clone(), stop.clone());
        let builder = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let started = match (self.patrol.take(), self.teleop) {
            (Some(patrol), _) => builder("patrol").spawn(move || patrol.drive(&arbiter, &stop)),
            (None, true) => builder("teleop").spawn(move || {
                if let Err(error) = teleop::drive(&arbiter, &stop) {
                    eprintln!("mirrorball: {error:#}");
                    stop.raise();
                }
            }),
            (None, false) => return Ok(None),
        };
        started
            .map(Some)
            .context("cannot start the thread of patrol or teleop")
    }

    fn handle_event(&mut self, event: DeviceEvent, state: &mut RunState, status: &mut RunStatus) {
        let sample = match event {
            DeviceEvent::Image(image) => Sample::Image(state.camera_image(image)),
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
                if let Some(text) = state.notices.update(&event) {
                    status.print_line(&text);
                    self.write_note(&text);
                }
                return;
            }
        };
        if is_finite(&sample) {
            self.process_sample(sample, state, status);
        } else {
            state.samples_refused += 1;
        }
    }

    fn process_sample(&mut self, sample: Sample, state: &mut RunState, status: &mut RunStatus) {
        let received = hw::now();
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
        status.count_cycle(&cycle, received, published);
        let cycle = Arc::new(cycle);
        self.feed.publish(&cycle);
        if let Some(poses) = &self.pose_writer {
            poses.write_cycle(&cycle);
        }
        if let Some(text) = self
            .log
            .as_mut()
            .and_then(|log| log.write_cycle(cycle.clone()))
        {
            status.report_log_change(&text);
        }
        state.last_cycle = Some(cycle);
    }

    fn write_note(&self, text: &str) {
        if let Some(log) = &self.log {
            log.write_note(hw::now(), text);
        }
    }
}

/// Header of log and stream: the run's configuration.
fn header(robot: &RobotFolder, config: &PipelineConfig) -> Result<Header> {
    let setup = &robot.setup;
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new(&format!("run {}", robot.folder.display()), None)
        .with_robot(&setup.robot, map, setup.colours.as_ref())?
        .with_file(PIPELINE_FILE, config.to_table()?.to_string())
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
    names.extend(hardware.inertial.iter().map(|sensor| sensor.port.as_str()));
    let help = if teleop {
        format!("\n{}", teleop::HELP)
    } else {
        String::new()
    };
    format!("running with {}{help}", names.join(", "))
}

/// State of the loop between events.
struct RunState {
    last_cycle: Option<Arc<Cycle>>,
    /// Time of the last image, or of the last cycle in place of one.
    last_image: Stamp,
    notices: OperatorNotices,
    /// Samples with values that are not finite.
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

    fn camera_image(&mut self, image: CapturedImage) -> CameraImage {
        self.last_image = hw::now();
        let stamp = image.stamp;
        // An old image does not show the current pose.
        let content = if image.repeated {
            ImageContent::Unreadable("the camera repeats its image".to_owned())
        } else {
            ImageContent::Pixels(SourceImage::Raw(raw_image(image)))
        };
        CameraImage { stamp, content }
    }

    /// An empty image in place of a missing one, so that odometry predicts the pose. None before the timeout.
    fn missing_image(&mut self, now: Stamp) -> Option<CameraImage> {
        if now - self.last_image < IMAGE_TIMEOUT {
            return None;
        }
        self.last_image = now;
        Some(CameraImage {
            stamp: now,
            content: ImageContent::Unreadable("no image from the camera".to_owned()),
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

/// Writes poses.csv in its own thread.
struct PoseWriter {
    queue: SyncSender<Arc<Cycle>>,
    thread: JoinHandle<Result<()>>,
}

impl PoseWriter {
    fn start(path: &Path) -> Result<Self> {
        let mut outputs = CsvOutputs::create(Some(path), None, None)?;
        let (queue, cycles): (_, Receiver<Arc<Cycle>>) = sync_channel(POSE_QUEUE_CAPACITY);
        let write = move || {
            for cycle in cycles {
                outputs.write(&cycle)?;
            }
            outputs.finish()
        };
        let thread = std::thread::Builder::new()
            .name("poses".to_owned())
            .spawn(write)?;
        Ok(PoseWriter { queue, thread })
    }

    fn write_cycle(&self, cycle: &Arc<Cycle>) {
        // If the disk is too slow, the row is lost.
        let _full = self.queue.try_send(Arc::clone(cycle));
    }

    fn finish(self) -> Option<String> {
        drop(self.queue);
        match self.thread.join() {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(format!("cannot write the poses: {error:#}")),
            Err(_) => Some("cannot write the poses: the writer thread panicked".to_owned()),
        }
    }
}
