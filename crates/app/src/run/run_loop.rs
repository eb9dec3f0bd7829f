//! What happens between start and stop? Samples of devices go through the pipeline; the wheels stop before anything else ends.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use hw::camera::CapturedImage;
use hw::{BaseDriver, DeviceEvent, Devices, EventQueue, HardwareConfig};
use localize::Stamp;

use super::arguments::Args;
use super::command_arbiter::CommandArbiter;
use super::exposure_control::ExposureControl;
use super::log_rotation::{LogRotation, LogSummary};
use super::network::{self, RunNetwork};
use super::patrol::Patrol;
#[cfg(feature = "ros2")]
use super::pose_reset::PoseReset;
use super::pose_writer::PoseWriter;
use super::raw_image::raw_image;
use super::replay_start::ReplayStart;
use super::robot_folder::RobotFolder;
use super::setup_watch::SetupWatch;
use super::status::{CycleTimes, OperatorNotices, RunOutcome, RunReport, RunStatus};
use super::stop_flag::StopFlag;
use super::teleop;
use super::tuning::Tuning;
use super::unused_images::NO_IMAGE;
use super::wake_probe::WakeProbe;
use crate::memory::{self, RUN_RETAINED_BYTES};
#[cfg(feature = "ros2")]
use crate::ros2::{GivenPose, NodeContext, RosNode};
use crate::stream::{StreamConfig, StreamPreamble};
use pipeline::config::PIPELINE_FILE;
use pipeline::corrected_map;
use pipeline::datagram::TeamClock;
use pipeline::feed::Feed;
use pipeline::log::{Header, LogConfig};
use pipeline::recording::Table;
use pipeline::sample::{CameraImage, ImageContent, Sample, SettingsChange, SourceImage};
use pipeline::setup::Setup;
use pipeline::{Cycle, Pipeline, PipelineConfig};
use vision::exposure::ExposureCommand;

/// Capacity of the queue of device events: more than a second of every device.
const EVENT_QUEUE_CAPACITY: usize = 1024;
/// Real-time priority where the system permits one and none is given: the lowest. A busy machine delays the threads of a
/// usual priority by tens of milliseconds.
const DEFAULT_REALTIME_PRIORITY: i32 = 1;
/// Longest wait for an event: the latency of a stop.
const EVENT_TIMEOUT: Duration = Duration::from_millis(20);
/// Without an image for this time the pipeline runs a cycle without one, seconds: six images at 30 Hz.
const IMAGE_TIMEOUT: f64 = 0.2;
/// And then one each so many seconds: a command that needs a pose would stop and go by one that is too old.
const BLIND_PERIOD: f64 = 0.1;
/// Time between notes about the clocks of team-mates, seconds.
const CLOCK_NOTE_PERIOD: f64 = 30.0;
/// Smallest step of the wall clock that is reported, seconds.
const WALL_CLOCK_STEP_MIN: f64 = 0.1;
/// Time for the bus to take the last stop command.
const STOP_TIMEOUT: Duration = Duration::from_millis(300);

/// A run with everything that it needs.
pub(super) struct RunLoop {
    robot: RobotFolder,
    config: PipelineConfig,
    pipeline: Pipeline,
    log: Option<LogRotation>,
    pose_writer: Option<PoseWriter>,
    feed: Feed,
    arbiter: CommandArbiter,
    network: RunNetwork,
    tuning: Option<Tuning>,
    replay_start: ReplayStart,
    #[cfg(feature = "ros2")]
    pose_reset: PoseReset,
    patrol: Option<Patrol>,
    teleop: bool,
    realtime: Option<i32>,
    duration: f64,
    save_map: Option<PathBuf>,
}

impl RunLoop {
    /// Reads the configuration and starts network and log.
    pub(super) fn new(
        args: &Args,
        robot: RobotFolder,
        patrol: Option<Patrol>,
        feed: Feed,
    ) -> Result<Self> {
        let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
        let pipeline = Pipeline::new(&robot.setup, &config)?;
        let header = header(&robot, &config)?;
        let field = &robot.setup.field;
        let arbiter = CommandArbiter::new();
        let network_config = network::load_config(
            args.network.as_deref(),
            &robot.folder,
            args.live,
            config.team.number,
        )?;
        // Another program may be the camera and the base.
        ensure!(
            has_devices(&robot.hardware) || network_config.ros2.is_some(),
            "{}: names no device (expected [camera], [base] or [[inertial]], as in docs/hardware.toml)",
            robot.folder.join("hardware.toml").display()
        );
        let preamble = StreamPreamble {
            header: &header,
            field,
        };
        let start_tuning = |stream: &StreamConfig| {
            Tuning::start(robot.setup.clone(), &config, stream.key.as_deref())
        };
        let stream = network_config.stream.clone().unwrap_or_default();
        let is_tuned = stream.tuning || network_config.ros2.is_some();
        let tuning = is_tuned.then(|| start_tuning(&stream)).transpose()?;
        let desk = tuning.as_ref().map(Tuning::desk);
        let stream_desk = desk.clone().filter(|_| stream.tuning);
        #[cfg_attr(
            not(feature = "ros2"),
            expect(unused_mut, reason = "the node is added")
        )]
        let mut network =
            RunNetwork::start(&network_config, &feed, preamble, stream_desk, &arbiter)?;
        #[cfg(feature = "ros2")]
        network.start_node(
            &network_config,
            &feed,
            &NodeContext {
                field,
                filter: &config.localize.filter,
                camera_height: robot
                    .setup
                    .robot
                    .camera
                    .as_ref()
                    .and_then(|camera| camera.height),
                tuning: desk.map(|desk| desk.without_key()),
            },
            &arbiter,
        )?;
        let pose_writer = args.out.as_deref().map(PoseWriter::start).transpose()?;
        // Last, so that a run that cannot begin leaves no log.
        let log = start_log(args, &header, &robot.setup)?;
        Ok(RunLoop {
            robot,
            config,
            pipeline,
            log,
            pose_writer,
            feed,
            arbiter,
            network,
            tuning,
            replay_start: ReplayStart::default(),
            #[cfg(feature = "ros2")]
            pose_reset: PoseReset::default(),
            patrol,
            teleop: args.teleop,
            realtime: args.realtime,
            duration: args.duration.unwrap_or(f64::INFINITY),
            save_map: args.save_map.clone(),
        })
    }

    /// Runs until `stop` is raised or the duration has passed.
    pub(super) fn run(mut self, stop: &StopFlag) -> Result<RunReport> {
        let mut status = RunStatus::new();
        // A thread inherits the priority of the thread that starts it. Log and network threads are already running.
        hw::realtime::request_low_latency();
        memory::retain_freed_memory(RUN_RETAINED_BYTES);
        let realtime_priority = self.set_priority(&mut status);
        let events = EventQueue::new(EVENT_QUEUE_CAPACITY);
        let queued_images = self.log.as_ref().map_or(0, LogRotation::queue_images);
        let RobotFolder {
            hardware, setup, ..
        } = &self.robot;
        let devices = Devices::start(hardware, &setup.robot, queued_images, &events)?;
        self.arbiter
            .attach_base(devices.base.as_ref().map(BaseDriver::handle));
        #[cfg(feature = "ros2")]
        if let Some(node) = self.network.node() {
            node.attach_events(&events);
        }
        let motion_thread = self.start_motion_thread(stop)?;
        let wake_probe = WakeProbe::start()?;
        status.print_line(&start_message(&self.robot.hardware, self.teleop));
        let exposure = ExposureControl::start(&devices, self.robot.setup.robot.exposure);
        let mut state = RunState::new(&self.robot.setup, &self.config);
        while !stop.is_raised() && status.elapsed() < self.duration {
            if let Some(event) = events.pop_timeout(EVENT_TIMEOUT) {
                self.handle_event(event, &mut state, &mut status);
            }
            exposure.command_camera(state.camera_command.take());
            self.take_tuned_pipeline(&mut status);
            self.start_replayable_part(&mut status);
            #[cfg(feature = "ros2")]
            self.take_given_pose(&state, &mut status);
            self.watch_setup(&mut state, &mut status);
            if let Some(image) = state.missing_image(hw::now()) {
                self.process_sample(Sample::Image(image), &mut state, &mut status);
            }
            if let Some(step) = state.wall_clock_step() {
                let text = format!(
                    "the wall clock was set by {step:+.3} s: the times of the log go on by the clock of its start"
                );
                status.print_line(&text);
                self.write_note(&text);
            }
            if state.is_clock_note_due(hw::now()) {
                for clock in self.network.team_clocks().into_iter().flatten() {
                    self.write_note(&clock_note(clock));
                }
            }
            for text in self.network.take_notices() {
                status.print_line(&text);
                self.write_note(&text);
            }
            status.update_status_line(state.last_cycle.as_deref(), || devices.health());
        }
        let wheels_stopped = self.arbiter.close(STOP_TIMEOUT);
        let commands = self.network.command_counts(self.arbiter.program_tally());
        let team = self.network.team_clocks();
        let team_messages = self.network.team_counts();
        #[cfg(feature = "ros2")]
        let ros2 = self.network.node().map(RosNode::counts);
        stop.raise();
        let wake_up = wake_probe.summary();
        drop(wake_probe);
        let health = devices.health();
        drop(devices);
        if let Some(thread) = motion_thread {
            // A panic has been reported, and the wheels have stopped.
            let _ended = thread.join();
        }
        let (log, outputs_lost) = self.finish_outputs(&mut status);
        // The wheels have stopped: the trials of other set-ups take seconds, and nothing is urgent any more.
        hw::realtime::lower_priority();
        let mut warnings =
            state
                .setup_watch
                .finish(&self.robot.setup, &self.config, self.pipeline.visible_rim());
        warnings.extend(log.as_ref().and_then(LogSummary::gap));
        Ok(status.into_report(RunOutcome {
            warnings,
            dropped: events.drop_counts(),
            realtime_priority,
            wake_up,
            samples_refused: state.samples_refused,
            images_overtaken: state.images_overtaken,
            wheels_stopped,
            commands,
            team,
            team_messages,
            #[cfg(feature = "ros2")]
            ros2,
            devices: health,
            log,
            outputs_lost,
        }))
    }

    /// Sets the priority of this thread and those it starts. Returns the real-time priority, 0 for none.
    fn set_priority(&self, status: &mut RunStatus) -> i32 {
        let Some(priority) = self.realtime else {
            let permitted = hw::realtime::set_realtime_priority(DEFAULT_REALTIME_PRIORITY);
            return permitted.map_or(0, |()| DEFAULT_REALTIME_PRIORITY);
        };
        if priority == 0 {
            return 0;
        }
        let _reported = hw::realtime::lock_memory()
            .inspect_err(|error| status.print_line(&format!("cannot lock memory: {error}")));
        match hw::realtime::set_realtime_priority(priority) {
            Ok(()) => priority,
            Err(error) => {
                status.print_line(&format!("cannot set the real-time priority: {error}"));
                0
            }
        }
    }

    /// Completes map, table and log. Returns the log's summary, and why outputs do not exist.
    fn finish_outputs(&mut self, status: &mut RunStatus) -> (Option<LogSummary>, Vec<String>) {
        let mut outputs_lost = Vec::new();
        if let Some(path) = &self.save_map {
            match corrected_map::save(&self.robot.setup, &self.pipeline, path) {
                Ok(()) => status.print_line(&format!("corrected map: {}", path.display())),
                Err(error) => {
                    outputs_lost.push(format!("cannot save the corrected map: {error:#}"));
                }
            }
        }
        match self.pose_writer.take().map(PoseWriter::finish) {
            Some(Err(error)) => outputs_lost.push(format!("{error:#}")),
            Some(Ok(rows_lost @ 1..)) => status.report_log_change(&format!(
                "{rows_lost} poses are not in the table, because the disk was too slow"
            )),
            Some(Ok(0)) | None => {}
        }
        let log = self.log.take().map(|log| {
            let finished = log.finish();
            match (finished.loss(), finished.error) {
                (Some(loss), _) => outputs_lost.push(loss),
                (None, Some(error)) => status.report_log_change(&error),
                (None, None) => {}
            }
            finished.summary
        });
        (log, outputs_lost)
    }

    fn start_motion_thread(&mut self, stop: &StopFlag) -> Result<Option<JoinHandle<()>>> {
        let (arbiter, stop) = (self.arbiter.clone(), stop.clone());
        let builder = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let started = match (self.patrol.take(), self.teleop) {
            (Some(patrol), _) => builder("patrol").spawn(move || patrol.drive(&arbiter, &stop)),
            (None, true) => builder("teleop").spawn(move || {
                if let Err(error) = teleop::drive(&arbiter, &stop) {
                    stderr_line!("mirrorball: {error:#}");
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
            DeviceEvent::Image(image) if state.is_overtaken(&image) => {
                state.images_overtaken += 1;
                return;
            }
            DeviceEvent::Image(image) => Sample::Image(state.camera_image(image)),
            DeviceEvent::Odometry(odometry) => Sample::Odometry(odometry),
            DeviceEvent::Command(command) => Sample::Command(command),
            DeviceEvent::Imu(_) if state.dropped.contains(&Table::Imu) => return,
            DeviceEvent::Compass(_) if state.dropped.contains(&Table::Compass) => return,
            DeviceEvent::Imu(imu) => Sample::Imu(imu),
            DeviceEvent::Compass(compass) => Sample::Compass(compass),
            DeviceEvent::Health(health) => {
                #[cfg(feature = "ros2")]
                if let Some(node) = self.network.node() {
                    node.report_device(&health);
                }
                if let Some(text) = status.report_device(&health) {
                    self.write_note(&text);
                }
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
        // Commands in the field's frame need the pose alone, which is known before ball and robots.
        let arbiter = &self.arbiter;
        let mut located = received;
        let cycle = self.pipeline.process_sample_with(sample, |estimate| {
            arbiter.set_pose(estimate.stamp, estimate.pose);
            located = hw::now();
        });
        let Some(cycle) = cycle else {
            return;
        };
        state.camera_command = cycle.camera_command().or(state.camera_command.take());
        state.setup_watch.add_cycle(&cycle);
        let cycle = Arc::new(cycle);
        self.feed.publish(&cycle);
        let times = CycleTimes {
            received,
            located,
            published: hw::now(),
        };
        status.count_cycle(&cycle, &times);
        let pose_writer = self.pose_writer.as_mut();
        if let Some(text) = pose_writer.and_then(|poses| poses.write_cycle(&cycle)) {
            status.report_log_change(&text);
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

    /// Goes on with changed settings, if their pipeline is ready.
    fn take_tuned_pipeline(&mut self, status: &mut RunStatus) {
        let prepared = self.tuning.as_ref().and_then(Tuning::take_prepared);
        let Some(prepared) = prepared else { return };
        let change = SettingsChange {
            config_toml: prepared.settings.into(),
            warm_start: None,
        };
        self.pipeline.replace_by(prepared.pipeline, change);
        self.config = prepared.config;
        self.replay_start.cancel();
        #[cfg(feature = "ros2")]
        self.pose_reset.cancel();
        let text = format!("settings changed over the network: {}", prepared.changes);
        status.report_settings(&text);
        self.write_note(&text);
    }

    /// Goes on with a new pipeline, if the log needs a cycle from which it can be computed again.
    fn start_replayable_part(&mut self, status: &mut RunStatus) {
        if !self.log.as_ref().is_some_and(LogRotation::needs_state) {
            return;
        }
        self.replay_start
            .prepare(&self.robot.setup, &self.config, hw::now());
        let text = match self.replay_start.take(&self.pipeline) {
            Some(Ok((pipeline, change))) => {
                self.pipeline.replace_by(pipeline, change);
                "the log can be verified from the next cycle on: a new pipeline took over the pose"
                    .to_owned()
            }
            Some(Err(error)) => format!("the log cannot be verified after its gap: {error:#}"),
            None => return,
        };
        status.report_log_change(&text);
        self.write_note(&text);
    }

    /// Goes on from a pose that another program has given.
    #[cfg(feature = "ros2")]
    fn take_given_pose(&mut self, state: &RunState, status: &mut RunStatus) {
        if let Some(given) = self.network.node().and_then(RosNode::take_given_pose) {
            self.pose_reset
                .request(given, &self.robot.setup, &self.config);
        }
        let Some((built, GivenPose { pose, covariance })) = self.pose_reset.take() else {
            return;
        };
        let stamp = state
            .last_cycle
            .as_ref()
            .map_or_else(hw::now, |cycle| cycle.stamp);
        let text = match built {
            Ok((next, settings)) => {
                let change = SettingsChange {
                    config_toml: settings.into(),
                    warm_start: Some(self.pipeline.warm_start_at(stamp, pose, &covariance)),
                };
                self.pipeline.replace_by(next, change);
                self.replay_start.cancel();
                let degrees = pose.theta.to_degrees();
                format!(
                    "pose given: {:.2} m, {:.2} m, {degrees:.0}°",
                    pose.x, pose.y
                )
            }
            Err(error) => format!("the given pose is not used: {error:#}"),
        };
        status.report_settings(&text);
        self.write_note(&text);
    }

    /// Checks the set-up while the robot drives. Poses of one that another beats are marked.
    fn watch_setup(&mut self, state: &mut RunState, status: &mut RunStatus) {
        let (setup, config) = (&self.robot.setup, &self.config);
        let find_rim = || self.pipeline.visible_rim();
        let watch = &mut state.setup_watch;
        let Some(verdict) = watch.update(setup, config, find_rim, hw::now()) else {
            return;
        };
        self.pipeline.mark_setup_doubtful(verdict.covariance);
        if let Some(fit) = verdict.map_fit {
            self.pipeline.adopt_map_fit(fit);
        }
        state.dropped.extend(verdict.drops);
        status.print_line(&verdict.text);
        self.write_note(&verdict.text);
    }

    fn write_note(&self, text: &str) {
        if let Some(log) = &self.log {
            log.write_note(hw::now(), text);
        }
    }
}

/// Starts the log of `--record`, if there is one.
fn start_log(args: &Args, header: &Header, setup: &Setup) -> Result<Option<LogRotation>> {
    let Some(path) = &args.record else {
        return Ok(None);
    };
    let config = LogConfig {
        images: args.images,
        ..LogConfig::default()
    };
    let priority = log_priority(args.realtime);
    let log = LogRotation::start(path, header.clone(), &setup.field, (&config, priority))?;
    if let Some(first) = log.first_file().filter(|first| first != path) {
        let (path, first) = (path.display(), first.display());
        stderr_line!("note: {path} exists and stays: the log is written to {first}");
    }
    Ok(Some(log))
}

/// Sets the priority of the log's threads. They yield to those between camera and wheels, which on a busy machine costs images.
/// A real-time priority of the others is enough for that.
fn log_priority(realtime: Option<i32>) -> fn() {
    match realtime.unwrap_or(DEFAULT_REALTIME_PRIORITY) {
        priority @ 1.. if hw::realtime::is_realtime_permitted(priority) => {
            hw::realtime::usual_priority
        }
        _ => hw::realtime::lower_priority,
    }
}

fn clock_note(clock: TeamClock) -> String {
    let TeamClock {
        robot,
        clock_offset_ns,
        clock_uncertainty_ns,
    } = clock;
    let uncertainty = clock_uncertainty_ns.map_or("unknown".to_owned(), |bound| bound.to_string());
    format!(
        "clock of robot {robot}: own minus its {clock_offset_ns} ns, uncertainty {uncertainty} ns"
    )
}

/// Header of log and stream: the run's configuration.
fn header(robot: &RobotFolder, config: &PipelineConfig) -> Result<Header> {
    let setup = &robot.setup;
    let map = setup.camera.as_ref().map(|(_, map)| &**map);
    let header = Header::new(&format!("run {}", robot.folder.display()), None)
        .with_clock_offset_ns(hw::realtime_offset_ns())
        .with_robot(&setup.robot, map, setup.colours.as_ref())?
        .with_file(PIPELINE_FILE, config.to_table()?.to_string())
        .with_file("hardware.toml", toml::to_string(&robot.hardware)?);
    Ok(header)
}

fn has_devices(hardware: &HardwareConfig) -> bool {
    hardware.camera.is_some() || hardware.base.is_some() || !hardware.inertial.is_empty()
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
    /// Command for the camera that was not sent yet.
    camera_command: Option<ExposureCommand>,
    /// Time of the last image, or of the last cycle in place of one.
    last_image: Stamp,
    notices: OperatorNotices,
    /// Wall-clock time at the zero of the stamps, nanoseconds.
    clock_offset_ns: i64,
    next_clock_note: Stamp,
    /// Samples with values that are not finite.
    samples_refused: u64,
    /// Images that came after a cycle of a later time.
    images_overtaken: u64,
    setup_watch: SetupWatch,
    /// Sensors that were found to be useless.
    dropped: Vec<Table>,
}

impl RunState {
    fn new(setup: &Setup, config: &PipelineConfig) -> Self {
        RunState {
            last_cycle: None,
            camera_command: None,
            last_image: hw::now(),
            notices: OperatorNotices::default(),
            clock_offset_ns: hw::realtime_offset_ns(),
            next_clock_note: hw::now() + CLOCK_NOTE_PERIOD,
            samples_refused: 0,
            images_overtaken: 0,
            setup_watch: SetupWatch::new(setup, config),
            dropped: Vec::new(),
        }
    }

    fn is_clock_note_due(&mut self, now: Stamp) -> bool {
        let is_due = now > self.next_clock_note;
        if is_due {
            self.next_clock_note = now + CLOCK_NOTE_PERIOD;
        }
        is_due
    }

    /// Seconds by which the wall clock was set since the last call, if it was.
    fn wall_clock_step(&mut self) -> Option<f64> {
        let offset_ns = hw::realtime_offset_ns();
        let step = (offset_ns - self.clock_offset_ns) as f64 * 1e-9;
        // Slewing by NTP is followed silently.
        self.clock_offset_ns = offset_ns;
        (step.abs() > WALL_CLOCK_STEP_MIN).then_some(step)
    }

    /// Is an image no later than the last cycle? A cycle without an image may have been computed before a late one came. The stamps of
    /// cycles increase.
    fn is_overtaken(&self, image: &CapturedImage) -> bool {
        self.last_cycle
            .as_ref()
            .is_some_and(|cycle| image.stamp <= cycle.stamp)
    }

    fn camera_image(&mut self, image: CapturedImage) -> CameraImage {
        self.last_image = hw::now();
        let (stamp, setting) = (image.stamp, image.setting);
        // An old image does not show the current pose.
        let content = if image.repeated {
            ImageContent::Unreadable("the camera repeats its image".to_owned())
        } else {
            ImageContent::Pixels(SourceImage::Raw(raw_image(image)))
        };
        CameraImage {
            stamp,
            setting,
            content,
        }
    }

    /// An empty image in place of a missing one, so that odometry predicts the pose. None before the timeout.
    fn missing_image(&mut self, now: Stamp) -> Option<CameraImage> {
        if now - self.last_image < IMAGE_TIMEOUT {
            return None;
        }
        self.last_image = now + (BLIND_PERIOD - IMAGE_TIMEOUT);
        Some(CameraImage {
            stamp: now,
            setting: None,
            content: ImageContent::Unreadable(NO_IMAGE.to_owned()),
        })
    }
}

fn is_finite(sample: &Sample) -> bool {
    match sample {
        Sample::Odometry(odometry) => (odometry.dx + odometry.dy + odometry.dtheta).is_finite(),
        Sample::Compass(compass) => compass.heading.is_finite(),
        Sample::Imu(imu) => imu
            .specific_force
            .iter()
            .chain(&imu.angular_velocity)
            .all(|value| value.is_finite()),
        Sample::Command(_)
        | Sample::TeamReport(_)
        | Sample::GroundTruth(_)
        | Sample::Settings(_)
        | Sample::SetupDoubt(_)
        | Sample::MapFit(_)
        | Sample::Image(_) => true,
    }
}
