//! The view's own simulation: a thread that plays a scenario at a set speed and handles requests between samples.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use localize::Pose;
use localize::frames::{At, FieldFrame};
use localize::omni::Twist;
use sim::Sector;
use sim::image_sensor::ImageSensorConfig;
use sim::scenario::FaultKind;

use super::decoded_cycle::DecodedCycle;
use super::inbox::CycleInbox;
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};

/// Longest wait for a request while paused.
const PAUSED_POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Queued requests at most: some seconds of manual driving at one request per drawn frame.
const REQUEST_CAPACITY: usize = 256;
/// Largest lag behind the set speed that is caught up, seconds.
const MAX_LAG: f64 = 0.1;

/// A request of the view to its simulation.
#[derive(Debug, Clone)]
pub(crate) enum SourceRequest {
    /// Pauses, or resumes.
    Pause(bool),
    /// Runs until the next cycle, then pauses.
    Step,
    /// Simulated seconds per second; infinite means as fast as possible.
    SetSpeed(f64),
    /// Moves the robot to a pose.
    Kidnap(Pose),
    /// Moves another robot, by its index, to a pose.
    PlaceOther(usize, Pose),
    /// Applies an impulse to the robot, N s, field frame.
    ApplyImpulse([f32; 2]),
    /// Places the ball with a velocity, m/s, field frame.
    PlaceBall(At<FieldFrame>, [f32; 2]),
    /// Light level; None restores the scenario's.
    SetLightLevel(Option<f32>),
    /// Black sector in the image: centre and width, degrees.
    SetOcclusion(Option<Sector>),
    /// Image sensor settings.
    SetImageSensor(ImageSensorConfig),
    /// Commanded velocity; None restores the scenario's motion.
    Drive(Option<Twist>),
    /// Starts or ends a sensor fault. The index selects the wheel.
    SetFault(FaultKind, usize, bool),
    /// Replaces the settings of vision and localization; the pose is kept.
    Configure(Box<PipelineConfig>),
    /// Restarts the scenario with this seed.
    Restart(u64),
}

/// State of the simulation.
#[derive(Debug, Clone)]
pub(crate) struct SimStatus {
    /// Simulated time, seconds.
    pub(crate) time: f64,
    /// Seed of the random generators.
    pub(crate) seed: u64,
    /// Duration of the scenario, seconds.
    pub(crate) duration: f64,
    /// The simulation is paused.
    pub(crate) paused: bool,
    /// Requested simulated seconds per second.
    pub(crate) speed: f64,
    /// Image sensor settings.
    pub(crate) image_sensor: ImageSensorConfig,
    /// Why the last request failed.
    pub(crate) error: Option<String>,
}

/// Handle of the simulation thread; dropping it stops the thread.
pub(crate) struct SimWorker {
    /// The scenario's path.
    pub(crate) scenario: PathBuf,
    requests: SyncSender<SourceRequest>,
    status: Arc<Mutex<SimStatus>>,
}

impl SimWorker {
    /// Loads the scenario and starts its thread.
    pub(crate) fn start(
        scenario: &Path,
        seed: Option<u64>,
        config: PipelineConfig,
        inbox: CycleInbox,
    ) -> Result<(Self, Setup)> {
        let simulation = Simulation::load(scenario, seed, None)?;
        let setup = simulation.setup()?;
        let pipeline = Pipeline::new(&setup, &config)?;
        let status = Arc::new(Mutex::new(SimStatus {
            time: 0.0,
            seed: simulation.sim().scenario().seed,
            duration: simulation.duration(),
            paused: false,
            speed: 1.0,
            image_sensor: *simulation.sim().image_sensor(),
            error: None,
        }));
        let (requests, receiver) = sync_channel(REQUEST_CAPACITY);
        let mut thread = SimThread {
            scenario: scenario.to_owned(),
            setup: simulation.setup()?,
            simulation,
            pipeline,
            config,
            inbox,
            status: status.clone(),
            paused: false,
            speed: 1.0,
            speed_reference: (Instant::now(), 0.0),
            pending_cycles: 0,
        };
        std::thread::Builder::new()
            .name("sim".to_owned())
            .spawn(move || thread.run(&receiver))?;
        let worker = SimWorker {
            scenario: scenario.to_owned(),
            requests,
            status,
        };
        Ok((worker, setup))
    }

    /// Sends a request; the thread handles it between two samples.
    pub(crate) fn request(&self, request: SourceRequest) {
        // The queue is full only if the thread hangs. The window must not wait for it.
        let _ = self.requests.try_send(request);
    }

    /// State of the simulation.
    pub(crate) fn status(&self) -> SimStatus {
        self.status
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

/// State of the simulation thread.
struct SimThread {
    scenario: PathBuf,
    setup: Setup,
    simulation: Simulation,
    pipeline: Pipeline,
    config: PipelineConfig,
    inbox: CycleInbox,
    status: Arc<Mutex<SimStatus>>,
    paused: bool,
    speed: f64,
    /// Reference of the speed: a wall-clock time and its simulated time, seconds.
    speed_reference: (Instant, f64),
    /// Cycles still to run while paused.
    pending_cycles: u32,
}

impl SimThread {
    fn run(&mut self, requests: &Receiver<SourceRequest>) {
        loop {
            let idle = self.paused && self.pending_cycles == 0;
            if idle {
                match requests.recv_timeout(PAUSED_POLL_INTERVAL) {
                    Ok(request) => self.handle_request(request),
                    Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
                    Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => return,
                }
            }
            loop {
                match requests.try_recv() {
                    Ok(request) => self.handle_request(request),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return,
                }
            }
            if self.paused && self.pending_cycles == 0 {
                continue;
            }
            match self.simulation.next() {
                Some(sample) => self.process_sample(sample),
                None => self.set_paused(true),
            }
        }
    }

    fn process_sample(&mut self, sample: pipeline::sample::Sample) {
        let Some(cycle) = self.pipeline.process_sample(sample) else {
            return;
        };
        if let Some(command) = cycle.camera_command() {
            self.simulation.command_camera(command);
        }
        let time = cycle.stamp.seconds();
        self.pending_cycles = self.pending_cycles.saturating_sub(1);
        self.wait_until(time);
        self.inbox.push(DecodedCycle {
            cycle: Arc::new(cycle),
            particles: self.pipeline.particles().to_vec(),
        });
        self.update_status(|status| status.time = time);
    }

    /// Sleeps until the wall clock reaches a simulated time at the set speed.
    fn wait_until(&mut self, time: f64) {
        let due = (time - self.speed_reference.1) / self.speed;
        let late = self.speed_reference.0.elapsed().as_secs_f64() - due;
        if late < 0.0 {
            std::thread::sleep(Duration::from_secs_f64((-late).min(1.0)));
        } else if late > MAX_LAG {
            self.speed_reference = (Instant::now(), time);
        }
    }

    fn set_paused(&mut self, paused: bool) {
        self.paused = paused;
        self.pending_cycles = 0;
        self.speed_reference = (Instant::now(), self.simulation.sim().time());
        self.update_status(|status| status.paused = paused);
    }

    fn handle_request(&mut self, request: SourceRequest) {
        self.update_status(|status| status.error = None);
        match request {
            SourceRequest::Pause(paused) => return self.set_paused(paused),
            SourceRequest::Step => {
                self.set_paused(true);
                self.pending_cycles = 1;
                return;
            }
            SourceRequest::SetSpeed(speed) => {
                self.speed = speed.max(0.01);
                self.speed_reference = (Instant::now(), self.simulation.sim().time());
                return self.update_status(|status| status.speed = speed);
            }
            SourceRequest::Configure(config) => return self.configure(*config),
            SourceRequest::Restart(seed) => return self.restart(seed),
            _ => {}
        }
        let sim = self.simulation.sim_mut();
        match request {
            SourceRequest::Kidnap(pose) => sim.kidnap(pose),
            SourceRequest::PlaceOther(number, pose) => sim.place_other(number, pose),
            SourceRequest::ApplyImpulse(impulse) => sim.apply_impulse(impulse),
            SourceRequest::PlaceBall(at, velocity) => sim.place_ball(at, velocity),
            SourceRequest::SetLightLevel(level) => sim.set_light_level(level),
            SourceRequest::SetOcclusion(sector) => sim.set_occlusion(sector),
            SourceRequest::Drive(twist) => sim.set_command(twist),
            SourceRequest::SetFault(kind, wheel, active) => sim.set_fault(kind, wheel, active),
            SourceRequest::SetImageSensor(config) => {
                sim.set_image_sensor(config);
                self.update_status(|status| status.image_sensor = config);
            }
            SourceRequest::Pause(_)
            | SourceRequest::Step
            | SourceRequest::SetSpeed(_)
            | SourceRequest::Configure(_)
            | SourceRequest::Restart(_) => {}
        }
    }

    fn configure(&mut self, config: PipelineConfig) {
        match Pipeline::new(&self.setup, &config) {
            Ok(mut pipeline) => {
                pipeline.warm_start_from(&self.pipeline);
                self.pipeline = pipeline;
                self.config = config;
            }
            Err(error) => self.update_status(|status| status.error = Some(format!("{error:#}"))),
        }
    }

    fn restart(&mut self, seed: u64) {
        let restarted = Simulation::load(&self.scenario, Some(seed), None)
            .and_then(|simulation| Ok((simulation, Pipeline::new(&self.setup, &self.config)?)));
        match restarted {
            Ok((simulation, pipeline)) => {
                let image_sensor = *simulation.sim().image_sensor();
                (self.simulation, self.pipeline) = (simulation, pipeline);
                self.set_paused(false);
                self.update_status(|status| {
                    (status.seed, status.image_sensor, status.time) = (seed, image_sensor, 0.0)
                });
            }
            Err(error) => self.update_status(|status| status.error = Some(format!("{error:#}"))),
        }
    }

    fn update_status(&self, change: impl FnOnce(&mut SimStatus)) {
        change(&mut self.status.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
